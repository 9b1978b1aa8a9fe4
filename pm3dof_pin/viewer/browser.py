"""A headless browser, to take pictures of a page and to inspect it.

Chromium or Chrome runs with the DevTools protocol on two pipes: no port is opened and no driver needed.
"""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Self

from pm3dof_pin.exceptions import BrowserError
from pm3dof_pin.viewer.scene import Json

VARIABLE = "PM3DOF_BROWSER"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
_FLAGS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--use-angle=swiftshader",  # pictures without a graphics card, identical everywhere
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-quic",
    "--disable-sync",
    "--no-default-browser-check",
    "--no-first-run",
    "--no-pings",
)
# The browser reads commands on descriptor 3 and answers on 4. Both pipes are moved out of the way first: they may be 4
# and 3 themselves.
_LAUNCHER = """
import fcntl, os, sys
commands, messages = (fcntl.fcntl(int(text), fcntl.F_DUPFD, 10) for text in sys.argv[1:3])
os.dup2(commands, 3)
os.dup2(messages, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
_TIMEOUT = 60.0  # per answer [s]


def find_browser() -> Path:
    """Return Chromium, Chrome or Edge, from PM3DOF_BROWSER or the search path; BrowserError if there is none."""
    if named := os.environ.get(VARIABLE):
        path = shutil.which(named)
        if path is None:
            raise BrowserError(f"{VARIABLE}={named}: expected the path of Chromium or Chrome")
        return Path(path)
    found = next((path for name in _NAMES if (path := shutil.which(name))), None)
    if found is None:
        raise BrowserError(f"no browser found (looked for {', '.join(_NAMES)}); set {VARIABLE} to the path of one")
    return Path(found)


class Browser:
    """A headless browser with one page; ends with its `with` block. BrowserError if none starts."""

    def __init__(self, width: int = 1200, height: int = 900) -> None:
        self._size = {"width": width, "height": height}
        self._numbers = itertools.count(1)
        self._answers: queue.Queue[Json] = queue.Queue()
        self._events: list[Json] = []
        self._session: str | None = None
        executable = find_browser()
        self._folder = tempfile.TemporaryDirectory(prefix="pm3dof-browser-")
        self._start(executable)
        try:
            target = self.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
            attached = self.ask("Target.attachToTarget", {"targetId": target, "flatten": True})
            self._session = attached["sessionId"]
            self.ask("Page.enable")
            self.resize(width, height)
        except BaseException:
            self.close()
            raise

    @classmethod
    def pictures_of(
        cls, html: str, width: int, height: int, *, bare: bool = False, steps: Sequence[str] = ()
    ) -> list[bytes]:
        """Return pictures (PNG) of a page of this package, size in pixels; BrowserError if it cannot be drawn.

        With `bare`, the machine alone. There is one picture, or one after each of the steps, which are JavaScript.
        """
        with tempfile.TemporaryDirectory(prefix="pm3dof-") as folder, cls(width, height) as browser:
            file = Path(folder) / "page.html"
            file.write_text(html, encoding="utf-8")
            browser.open(file.as_uri())
            if bare:
                browser.evaluate("pm3dof.bare()")
            pictures = []
            for step in steps or ("null",):
                browser.evaluate(step)
                pictures.append(browser.picture())
            return pictures

    def resize(self, width: int, height: int) -> None:
        """Resize the page [pixels]."""
        size = {"width": width, "height": height}
        self.ask("Emulation.setDeviceMetricsOverride", {**size, "deviceScaleFactor": 1, "mobile": False})

    def open(self, url: str) -> None:
        """Open a page and wait until it has loaded and drawn; BrowserError if it does not load."""
        self._events.clear()
        error = self.ask("Page.navigate", {"url": url}).get("errorText")
        if error:
            raise BrowserError(f"{url}: {error}")
        self._wait_for_event("Page.loadEventFired")
        self.settle()

    def settle(self) -> None:
        """Wait until the page has drawn all changes."""
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page, awaiting promises; BrowserError if it throws."""
        parameters = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.ask("Runtime.evaluate", parameters)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise BrowserError(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def picture(self) -> bytes:
        """Return a picture (PNG) of the page in its current state."""
        self.settle()
        return base64.b64decode(self.ask("Page.captureScreenshot", {"format": "png"})["data"])

    def close(self) -> None:
        """End the browser; a second call does nothing."""
        if self._process.poll() is None:
            with contextlib.suppress(BrowserError, OSError):
                self._session = None
                self.ask("Browser.close")
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(10.0)
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
        self._reader.join()
        for pipe in (self._commands, self._messages):
            with contextlib.suppress(OSError):
                pipe.close()
        _remove(self._folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self, executable: Path) -> None:
        command = [str(executable), *_FLAGS, f"--user-data-dir={self._folder.name}"]
        command += [f"--window-size={self._size['width']},{self._size['height']}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # as root it does not start with a sandbox
        read_commands, write_commands = os.pipe()
        read_messages, write_messages = os.pipe()
        pipes = [str(read_commands), str(write_messages)]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _LAUNCHER, *pipes, *command],
            pass_fds=(read_commands, write_messages),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for this process, which then closes the browser properly
        )
        os.close(read_commands)
        os.close(write_messages)
        self._commands: BinaryIO = os.fdopen(write_commands, "wb", buffering=0)
        self._messages: BinaryIO = os.fdopen(read_messages, "rb", buffering=0)
        self._reader = threading.Thread(target=self._read, name="browser", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        """Receive messages, each ended by a zero byte, until the browser ends."""
        rest = b""
        while data := self._messages.read(65536):
            *whole, rest = (rest + data).split(b"\0")
            for text in whole:
                message = json.loads(text)
                if "id" in message:
                    self._answers.put(message)
                else:
                    self.on_message(message)
        self._answers.put({"gone": True})

    def on_message(self, event: Json) -> None:
        """Record an event from the page."""
        self._events.append(event)

    def ask(self, method: str, parameters: Json | None = None) -> Json:
        """Return the answer to a command of the DevTools protocol; BrowserError if it is an error or missing."""
        number = next(self._numbers)
        message: Json = {"id": number, "method": method, "params": parameters or {}}
        if self._session:
            message["sessionId"] = self._session
        try:
            self._commands.write(json.dumps(message).encode() + b"\0")
        except OSError as error:
            raise BrowserError(f"the browser has ended ({error.strerror})") from error
        while True:
            try:
                message = self._answers.get(timeout=_TIMEOUT)
            except queue.Empty as error:
                raise BrowserError(f"the browser did not answer {method} within {_TIMEOUT:g} s") from error
            if "gone" in message:
                self._answers.put(message)
                raise BrowserError("the browser has ended: it may be unable to run on this machine")
            if message["id"] == number:
                if "error" in message:
                    raise BrowserError(f"{method}: {message['error']['message']}")
                result: Json = message["result"]
                return result

    def _wait_for_event(self, method: str) -> None:
        end = time.monotonic() + _TIMEOUT
        while not any(event["method"] == method for event in list(self._events)):
            if time.monotonic() > end:
                raise BrowserError(f"the page did not load within {_TIMEOUT:g} s")
            time.sleep(0.02)


def _remove(folder: tempfile.TemporaryDirectory[str]) -> None:
    """Remove the browser's folder, to which its last processes may still write for a moment."""
    for _ in range(50):
        try:
            folder.cleanup()
        except OSError:
            time.sleep(0.1)
        else:
            return
    folder.cleanup()
