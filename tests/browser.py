"""A headless Chromium that a test drives as a person would: over a pipe, no port, no library.

The protocol is Chromium's remote debugging (`--remote-debugging-pipe`): JSON messages ended
by a zero byte, commands on descriptor 3, answers on 4.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
KEYS = {"Enter": 13, "ArrowLeft": 37, "ArrowRight": 39, "Home": 36, "End": 35, "Tab": 9}
_PATIENCE = 60.0  # s for one answer


def find_browser():
    """Path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One page of a Chromium of its own, and every address that was asked for."""

    def __init__(self, path, profile):
        down, self._to = os.pipe()
        self._from, up = os.pipe()

        def connect():
            a, b = os.dup(down), os.dup(up)  # out of the way of 3 and 4
            os.dup2(a, 3)
            os.dup2(b, 4)

        self._process = subprocess.Popen(
            [path, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
             "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions",
             "--disable-background-networking", "--disable-component-update", "--disable-sync",
             f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, close_fds=False,
            preexec_fn=connect, start_new_session=True,
        )  # fmt: skip
        os.close(down)
        os.close(up)
        self._buffer, self._last, self._session = b"", 0, None
        self.requests, self.errors = [], []
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def close(self):
        """End the browser and what it started."""
        try:
            self._session = None
            self.send("Browser.close")
        except OSError:
            pass
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, 9)
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    # ------------------------------------------------------------------------ protocol

    def send(self, method, **params):
        """A command and its answer."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _receive(self):
        deadline = time.monotonic() + _PATIENCE
        while b"\0" not in self._buffer:
            if not select.select([self._from], [], [], max(0, deadline - time.monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            data = os.read(self._from, 1 << 16)
            if not data:
                raise ConnectionError("the browser ended")
            self._buffer += data
        text, _, self._buffer = self._buffer.partition(b"\0")
        message = json.loads(text)
        method, params = message.get("method"), message.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        elif method == "Log.entryAdded":
            self.errors.append(params["entry"]["text"])
        return message

    # ---------------------------------------------------------------------- what one does

    def open(self, address):
        """Load an address anew and wait until its scripts ran."""
        self.send("Page.navigate", url="about:blank")
        self._settle("about:blank")
        self.requests.clear()
        self.errors.clear()
        self.send("Page.navigate", url=address)
        self._settle(address)

    def _settle(self, address):
        deadline = time.monotonic() + _PATIENCE
        start = json.dumps(address.partition("#")[0])
        there = f"location.href.startsWith({start}) && document.readyState === 'complete'"
        while time.monotonic() < deadline:
            try:
                if self.do(there):
                    return
            except RuntimeError:  # between two documents there is none to ask
                pass
            time.sleep(0.02)
        raise TimeoutError(f"{address} does not load")

    def do(self, script):
        """The value of an expression in the page."""
        found = self.send(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(json.dumps(found["exceptionDetails"]))
        return found["result"].get("value")

    def click(self, selector):
        """Press and release the mouse in the middle of an element."""
        x, y = self.do(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            " e.scrollIntoView({block: 'center', inline: 'center'});"
            " const r = e.getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.send(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1
            )

    def point(self, selector, across, down):
        """Move the mouse over an element, to shares of its width and height."""
        x, y, w, h = self.do(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            " e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            " return [r.x, r.y, r.width, r.height]; })()"
        )
        self.send(
            "Input.dispatchMouseEvent", type="mouseMoved", x=x + across * w, y=y + down * h
        )

    def type(self, text):
        """Type text where the focus is."""
        for letter in text:
            self.send("Input.dispatchKeyEvent", type="keyDown", text=letter, key=letter)
            self.send("Input.dispatchKeyEvent", type="keyUp", key=letter)

    def press(self, key):
        """Press a named key where the focus is."""
        more = {"key": key, "code": key, "windowsVirtualKeyCode": KEYS[key]}
        text = {"text": "\r"} if key == "Enter" else {}
        self.send("Input.dispatchKeyEvent", type="keyDown", **more, **text)
        self.send("Input.dispatchKeyEvent", type="keyUp", **more)

    def screen(self, width, height, dark=False):
        """Size of the window in CSS pixels, and the colour scheme that is preferred."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, path, whole=True):
        """Write what is seen as PNG."""
        data = self.send("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def obstacles(self):
        """What axe-core calls serious or critical for those who do not see or use no mouse."""
        package = pytest.importorskip("axe_core_python", reason="axe-core is not installed")
        script = (Path(package.__file__).parent / "axe.min.js").read_text("utf-8")
        self.do(f"{script}; 0")  # each page anew
        found = self.do(
            "axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations"
            ".filter((v) => ['serious', 'critical'].includes(v.impact))"
            ".map((v) => `${v.id}: ${v.nodes.length} x ${v.nodes[0].target.join(' ')}`))"
        )
        return sorted(found)
