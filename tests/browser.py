"""A headless Chromium over its debugging pipe: open pages, look at pixels, move sliders."""

from __future__ import annotations

import atexit
import base64
import io
import itertools
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.image import imread

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-sync",
    "--no-first-run",
    "--remote-debugging-pipe",
)


def chromium() -> str | None:
    """Path of an installed Chromium or Chrome, or None."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next(filter(None, map(shutil.which, names)), None)


@dataclass
class Seen:
    """What a page did: addresses it asked for beyond itself, and errors."""

    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


class Chromium:
    """A process of Chromium, the pipe to it, and what came through the pipe so far."""

    def __init__(self) -> None:
        self.numbers = itertools.count(1)
        self.buffer = b""
        self._owner = os.getpid()
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self.out = os.pipe()
        self.incoming, from_browser = os.pipe()
        flags = [*FLAGS, f"--user-data-dir={self._profile.name}", "about:blank"]
        redirect = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        self.process = subprocess.Popen(
            ["bash", "-c", redirect, "bash", chromium(), *flags],
            pass_fds=(to_browser, from_browser),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        atexit.register(self._end)

    def _end(self) -> None:
        if os.getpid() != self._owner:
            return
        os.close(self.out)
        os.close(self.incoming)
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._profile.cleanup()


STARTED: list[Chromium] = []
"""A start takes a second: all tabs of a process of tests are of the last one that still runs."""


def running() -> Chromium:
    """The Chromium of this process."""
    if not STARTED or STARTED[-1].process.poll() is not None:
        STARTED.append(Chromium())
    return STARTED[-1]


class Browser:
    """One tab that shares nothing with others; use as a context manager."""

    def __init__(self, width: int = 700, height: int = 500) -> None:
        self.size = (width, height)
        self.seen = Seen()

    def __enter__(self) -> Browser:
        self._chromium = running()
        self._session, self._target = None, None
        self._context = self.call("Target.createBrowserContext")["browserContextId"]
        self._new_tab()
        return self

    def _new_tab(self) -> None:
        """A tab in place of the last one: a page that is busy when it is left may hang its tab."""
        old, self._session = self._target, None
        place = {"url": "about:blank", "browserContextId": self._context}
        self._target = self.call("Target.createTarget", **place)["targetId"]
        if old is not None:
            self.call("Target.closeTarget", targetId=old)
        attached = self.call(
            "Target.attachToTarget", targetId=self._target, flatten=True
        )
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        width, height = self.size
        size = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": False,
        }
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def __exit__(self, *_: object) -> None:
        self._session = None
        self.call("Target.disposeBrowserContext", browserContextId=self._context)

    def open(self, path: Path, fragment: str = "") -> Seen:
        """Load a file and wait until it has loaded and been drawn."""
        return self.visit(path.resolve().as_uri() + fragment)

    def visit(self, address: str) -> Seen:
        """Load an address, a file's or a local server's, and wait until it has been drawn."""
        self._new_tab()
        self.seen = Seen()
        self.call("Page.navigate", url=address)
        self.wait_for(
            "document.readyState === 'complete' && location.protocol !== 'about:'"
        )
        self.settle()
        return self.seen

    def drag(self, selector: str, ends: tuple[float, float], moves: int) -> None:
        """Drag the knob of a slider between two parts of its width with the mouse."""
        box = self.evaluate(
            f"(({{x, y, width, height}}) => [x, y, width, height])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        left, top, width, height = box
        places = [
            (
                left + width * (ends[0] + (ends[1] - ends[0]) * k / moves),
                top + height / 2,
            )
            for k in range(moves + 1)
        ]
        self._mouse("mousePressed", places[0])
        for place in places[1:]:
            self._mouse("mouseMoved", place)
            self.evaluate("new Promise(r => requestAnimationFrame(r))")
        self._mouse("mouseReleased", places[-1])

    def _mouse(self, kind: str, place: tuple[float, float]) -> None:
        event = {"type": kind, "x": place[0], "y": place[1], "button": "left"}
        self.call("Input.dispatchMouseEvent", **event, buttons=1, clickCount=1)

    def settle(self) -> None:
        """Wait for four frames of animation."""
        frames = "new Promise(r => { let n = 4; const f = () => --n ? requestAnimationFrame(f) "
        self.evaluate(frames + ": r(n); requestAnimationFrame(f); })")

    def evaluate(self, expression: str) -> object:
        """The value of a JavaScript expression, promises awaited."""
        answer = self.call(
            "Runtime.evaluate",
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, condition: str, seconds: float = 20.0) -> None:
        """Wait until a JavaScript condition holds."""
        end = time.monotonic() + seconds
        while not self.evaluate(condition):
            assert time.monotonic() < end, (
                f"{condition} did not come true in {seconds} s"
            )
            time.sleep(0.05)

    def pixels(self) -> np.ndarray:
        """The visible part of the page, shape (height, width, 3), values 0 to 1."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return imread(io.BytesIO(base64.b64decode(data)), format="png")[..., :3]

    def call(self, method: str, **parameters: object) -> dict:
        """A command of the DevTools protocol and its answer."""
        number = next(self._chromium.numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._chromium.out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]
            self._note(answer)

    def _read(self, seconds: float = 60.0) -> dict:
        source = self._chromium
        while b"\0" not in source.buffer:
            ready, _, _ = select.select([source.incoming], [], [], seconds)
            assert ready, f"Chromium was silent for {seconds} s"
            chunk = os.read(source.incoming, 1 << 20)
            assert chunk, "Chromium ended"
            source.buffer += chunk
        message, _, source.buffer = source.buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict) -> None:
        method, data = event.get("method"), event.get("params", {})
        if event.get("sessionId") != self._session:
            return  # of a tab that was left
        if method == "Network.requestWillBeSent":
            address = data["request"]["url"]
            if not address.startswith(("file:", "data:", "about:", "blob:")):
                self.seen.requests.append(address)
        elif method == "Runtime.exceptionThrown":
            self.seen.errors.append(str(data["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and data["type"] in (
            "error",
            "assert",
        ):
            self.seen.errors.append(str(data["args"]))
        elif method == "Log.entryAdded" and data["entry"]["level"] == "error":
            self.seen.errors.append(data["entry"]["text"])
