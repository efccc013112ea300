"""What tests of several rooms share."""

import pytest

from tests.browser import NAMES, Browser, find_browser


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    """A browser, started once; without one its tests are skipped."""
    path = find_browser()
    if path is None:
        pytest.skip(f"no browser: looked for {', '.join(NAMES)}")
    driven = Browser(path, tmp_path_factory.mktemp("profile"))
    yield driven
    driven.close()


@pytest.fixture(scope="module")
def browser(chromium):
    """The browser with a light window of 1280 by 900, whatever other modules did to it."""
    chromium.screen(1280, 900)
    return chromium
