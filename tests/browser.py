"""A headless Chromium that a test drives as a person would, through Playwright."""

import shutil
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_browser():
    """Path of an installed Chromium, or None: Playwright's own builds are not packaged."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One page of a Chromium of its own, and every address that was asked for."""

    def __init__(self, path):
        from playwright.sync_api import sync_playwright

        self._playwright = sync_playwright().start()
        self._chromium = self._playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu"]
        )
        self.page = self._chromium.new_page(viewport={"width": 1280, "height": 900})
        self.requests, self.errors = [], []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._note)
        self._session = self.page.context.new_cdp_session(self.page)

    def _note(self, message):
        if message.type == "error":
            self.errors.append(message.text)

    def close(self):
        """End the browser and what it started."""
        self._chromium.close()
        self._playwright.stop()

    def send(self, method, **params):
        """A command of Chromium's own protocol, for what Playwright has no words for."""
        return self._session.send(method, params)

    def open(self, address):
        """Load an address anew and wait until its scripts ran."""
        self.page.goto("about:blank")
        self.requests.clear()
        self.errors.clear()
        self.page.goto(address)

    def do(self, script):
        """The value of an expression in the page."""
        return self.page.evaluate(script)

    def click(self, selector):
        """Press and release the mouse in the middle of an element."""
        self.page.locator(selector).first.click()

    def point(self, selector, across, down):
        """Move the mouse over an element, to shares of its width and height."""
        element = self.page.locator(selector).first
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        self.page.mouse.move(box["x"] + across * box["width"], box["y"] + down * box["height"])

    def type(self, text):
        """Type text where the focus is."""
        self.page.keyboard.type(text)

    def press(self, key):
        """Press a named key where the focus is."""
        self.page.keyboard.press(key)

    def screen(self, width, height, dark=False):
        """Size of the window in CSS pixels, and the colour scheme that is preferred."""
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.emulate_media(color_scheme="dark" if dark else "light")

    def picture(self, path, whole=True):
        """Write what is seen as PNG."""
        self.page.screenshot(path=path, full_page=whole)

    def obstacles(self):
        """What axe-core calls serious or critical for those who do not see or use no mouse."""
        package = pytest.importorskip("axe_core_python", reason="axe-core is not installed")
        script = (Path(package.__file__).parent / "axe.min.js").read_text("utf-8")
        self.page.evaluate(f"{script}; 0")  # each page anew
        found = self.page.evaluate(
            "axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations"
            ".filter((v) => ['serious', 'critical'].includes(v.impact))"
            ".map((v) => `${v.id}: ${v.nodes.length} x ${v.nodes[0].target.join(' ')}`))"
        )
        return sorted(found)
