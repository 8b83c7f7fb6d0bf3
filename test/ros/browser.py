# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium, controlled by the DevTools protocol over a pipe; needs no package."""

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import time

from waiting import PATIENCE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# No network but what a page asks for: nothing is to be left on the machine, nor fetched.
OPTIONS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    # A sandboxed frame belongs to the session of its page.
    "--disable-features=IsolateSandboxedIframes",
    "--hide-scrollbars",
    "--mute-audio",
)
START = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
)


class Browser:
    """A browser with one tab.

    errors   : what was written to the console as error or thrown
    requests : addresses that the tab asked for
    dialogs  : texts of dialogs that scripts opened
    """

    def __init__(self, folder):
        (to_read, write), (read, to_write) = os.pipe(), os.pipe()
        # Chromium reads from 3 and writes to 4, which may be something else in this process.
        high = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (to_read, to_write)]
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                START,
                *map(str, high),
                CHROMIUM,
                *OPTIONS,
                f"--user-data-dir={folder}",
                "about:blank",
            ],
            pass_fds=high,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for end in (to_read, to_write, *high):
            os.close(end)
        self._read, self._write = read, write
        self._left, self._count, self._session = b"", 0, None
        self._loaded = False
        self.errors, self.requests, self.dialogs = [], [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self):
        self._process.kill()
        self._process.wait()
        os.close(self._read)
        os.close(self._write)

    def call(self, method, **parameters):
        """The result of a command of the protocol; raises RuntimeError."""
        self._count += 1
        number = self._count
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        answer = {}
        while answer.get("id") != number:
            answer = self._next()
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def _next(self):
        until = time.monotonic() + PATIENCE
        while b"\0" not in self._left:
            if not select.select([self._read], [], [], max(0.0, until - time.monotonic()))[0]:
                raise RuntimeError(f"no answer of the browser within {PATIENCE:g} s")
            data = os.read(self._read, 1 << 20)
            if not data:
                raise RuntimeError(f"the browser ended with code {self._process.wait()}")
            self._left += data
        data, _, self._left = self._left.partition(b"\0")
        message = json.loads(data)
        self._take(message.get("method"), message.get("params", {}))
        return message

    def _take(self, event, found):
        if event == "Page.loadEventFired":
            self._loaded = True
        elif event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(found["exceptionDetails"])[:500])
        elif event == "Runtime.consoleAPICalled" and found["type"] in ("error", "assert"):
            self.errors.append(json.dumps(found["args"])[:500])
        elif event == "Log.entryAdded" and found["entry"]["level"] == "error":
            self.errors.append(found["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])
        elif event == "Page.javascriptDialogOpening":
            self.dialogs.append(found["message"])

    def open(self, path, width=1100, height=800, dark=False, phone=False):
        """Load a file, in a window of such a size and theme."""
        self.errors, self.requests, self.dialogs = [], [], []
        self.look(width, height, dark, phone)
        self._loaded = False
        self.call("Page.navigate", url=f"file://{path}")
        while not self._loaded:
            self._next()

    def look(self, width, height, dark=False, phone=False):
        """Another window and theme for the page that is open."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if phone else 1,
            mobile=phone,
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone)
        self.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}],
        )

    def drag(self, x, y, rise):
        """Put a finger on a point of the window, move it so many px down, and lift it."""
        self.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        for k in range(1, 16):
            self.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x, "y": y + rise * k / 15}])
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.run("new Promise(done => setTimeout(done, 200))")

    def run(self, code):
        """Value of a JavaScript expression; of a promise, what it brings."""
        found = self.call("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(json.dumps(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def picture(self, whole=True):
        """PNG of the page, whole or only what the window shows."""
        return base64.b64decode(self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"])
