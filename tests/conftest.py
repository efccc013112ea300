"""What tests of several rooms share."""

import hashlib
import os
import platform
import time

# Before NumPy is loaded: OpenBLAS then sums in the same order with AVX-512 and with AVX2 alone,
# so that a search ends at the same bits on either, as the stored answers need.
if platform.machine() == "x86_64":
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import pytest

from tests.browser import NAMES, Browser, find_browser

# Set by .ci/run: every package of the system that tests need has been installed.
COMPLETE = os.environ.get("VES_GYM_TESTS_COMPLETE") == "1"


_BEGUN = pytest.StashKey[float]()


def pytest_addoption(parser):
    """The share of the slow ring that every CI run draws."""
    parser.addoption(
        "--share",
        type=float,
        metavar="SECONDS",
        help="run tests in an order drawn by --draw, and begin none after so many seconds",
    )
    parser.addoption("--draw", default="", help="text that draws the order, as a commit")


def pytest_collection_modifyitems(config, items):
    """Shuffle by the text, so that every commit looks at other tests first."""
    if config.getoption("--share"):
        text = config.getoption("--draw")
        items.sort(key=lambda k: hashlib.sha256(f"{text} {k.nodeid}".encode()).digest())


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item):
    """Pass over a test once the share's time is up: it is not reported at all."""
    share = item.config.getoption("--share")
    begun = item.config.stash.setdefault(_BEGUN, time.monotonic())
    return True if share and time.monotonic() - begun > share else None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Where every program is there, a test that is skipped for want of one has failed."""
    report = yield
    skipped = report.skipped and not hasattr(report, "wasxfail")
    if COMPLETE and skipped and "needs " in str(report.longrepr):
        report.outcome = "failed"
    return report


@pytest.fixture(scope="session")
def chromium():
    """A browser, started once; without one its tests are skipped."""
    path = find_browser()
    if path is None:
        pytest.skip(f"needs a browser: looked for {', '.join(NAMES)}")
    driven = Browser(path)
    yield driven
    driven.close()


@pytest.fixture(scope="module")
def browser(chromium):
    """The browser with a light window of 1280 by 900, whatever other modules did to it."""
    chromium.screen(1280, 900)
    return chromium


@pytest.fixture
def empty_store(tmp_path, monkeypatch):
    """A folder for compiled functions, and a process that has compiled none yet."""
    from ves_gym.engine.kernel import build

    monkeypatch.setenv("VES_GYM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "_functions", {})
    return tmp_path / "cache"


@pytest.fixture
def no_compiler(empty_store, monkeypatch):
    """A machine on which nothing can be compiled."""
    from ves_gym.engine.kernel import build

    def refuse(text):
        raise RuntimeError("no code for this machine")

    monkeypatch.setattr(build, "compile_text", refuse)
