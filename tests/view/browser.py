"""A headless Chromium that opens a page, moves its slider, takes pictures and reports its network requests.

As a script it takes the pictures for the docs, of a replay at shares of its length and of ``trocar view``::

    PYTHONPATH=tests/view python -m browser out/demo/replay.html docs/images/replay 0.1 0.5 0.9
    trocar view out/demo --no-open &
    PYTHONPATH=tests/view python -m browser http://127.0.0.1:8080 docs/images/trial_view 0.42

and of ``trocar crtk serve ... --view`` likewise, while something moves there; or of a console, with keys that are
pressed before, each once the page waits for a yes::

    trocar run peg-transfer --method uncalibrated --transfers 2 --watch --confirm motions &
    PYTHONPATH=tests/view python -m browser http://127.0.0.1:8080 docs/images/console Y Y Y Y
"""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = shlex.split(
    "--headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader --no-first-run "
    "--no-default-browser-check --disable-background-networking --disable-component-update --disable-sync "
    "--disable-quic --remote-debugging-port=0 --proxy-server=127.0.0.1:9 "
    "'--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1'"
)
WAIT_S, LIVE_S = 120.0, 15.0  # a live page is never still
THUMB = "document.querySelector('.mantine-Slider-thumb')"


def find_chromium() -> str | None:
    """Return the path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """One tab.

    Attributes:
        requests: every address that it asked for, in order.
        errors: what it wrote on its console as an error, and what it did not catch.
        process: number of the browser's first process.
    """

    def __init__(self, socket: Connection, process: int) -> None:
        self._socket, self._numbers, self.process = socket, itertools.count(1), process
        self.requests: list[str] = []
        self.errors: list[str] = []
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **given: Any) -> dict[str, Any]:
        """Ask the browser for something and return its answer."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": given}))
        while True:
            message = json.loads(self._socket.recv(timeout=WAIT_S))
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._note(message)

    def open(self, address: str, fineness: float = 1) -> None:
        """Open a page of viser's, drawn so many times finer than its pixels, and wait until there is a scene."""
        self.call("Page.navigate", url=f"{address}?fixedDpr={fineness}")
        self.until("document.querySelector('canvas') !== null")

    def until(self, true: str, wait_s: float = WAIT_S) -> Any:
        """Wait until an expression is true and return it."""
        end = time.monotonic() + wait_s
        while time.monotonic() < end:
            value = None
            with suppress(RuntimeError):  # the page is just being left for another one
                value = self.evaluate(true)
            if value:
                return value
            time.sleep(0.2)
        raise TimeoutError(f"the page never came to: {true}; errors: {self.errors}")

    def evaluate(self, expression: str) -> Any:
        """Return what an expression of JavaScript is worth on the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        return answer["result"].get("value")

    def click(self, x: float, y: float) -> None:
        """Click somewhere, pixels from the top left."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, label: str) -> None:
        """Click the button whose text begins so, once it is there."""
        self._click_on(f"[...document.querySelectorAll('button')].find(b => b.innerText.startsWith({label!r}))")

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop all processes of the browser (SIGSTOP), which keep their connections, and let them go on."""
        processes = [self.process]
        for process in processes:  # grows as its children, and theirs, are found
            tasks = Path(f"/proc/{process}/task").glob("*/children")
            processes += [int(child) for task in tasks for child in task.read_text().split()]
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in processes:
                os.kill(process, signal.SIGCONT)

    def key(self, letter: str, repeats: int = 0, *, shift: bool = False) -> None:
        """Press the key of a letter, with Shift or not; it repeats so many times before it is let go."""
        text = letter if shift else letter.lower()
        key = {"key": text, "code": f"Key{letter}", "windowsVirtualKeyCode": ord(letter), "modifiers": 8 * shift}
        for repeat in range(repeats + 1):
            self.call("Input.dispatchKeyEvent", type="keyDown", text=text, autoRepeat=repeat > 0, **key)
        self.call("Input.dispatchKeyEvent", type="keyUp", **key)

    def choose(self, present: str, wanted: str) -> None:
        """Choose an entry of the menu that shows ``present``."""
        for found, text in (("input", present), ("[role=option]", wanted)):
            one = f"[...document.querySelectorAll({found!r})].find(e => (e.value ?? e.innerText) === {text!r})"
            self._click_on(one)

    def _click_on(self, found: str) -> None:
        """Click on the middle of an element, once it is there."""
        self.until(f"!!{found}")
        self.evaluate(f"{found}.scrollIntoView({{block: 'center'}})")
        self.click(
            *self.evaluate(f"(r => [r.left + r.width / 2, r.top + r.height / 2])({found}.getBoundingClientRect())")
        )

    def picture(self) -> NDArray[np.uint8]:
        """Return what is seen now (h, w, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def scene(self, wait_s: float = WAIT_S) -> NDArray[np.uint8]:
        """Return what is seen once nothing changes any more, or then, without viser's notes on slow browsers."""
        self.quiet()
        end = time.monotonic() + wait_s
        before = self._drawn()
        while time.monotonic() < end:
            now = self._drawn()
            if (now == before).all():
                break
            before = now
        return before

    def quiet(self) -> None:
        """Hide viser's notes on slow browsers, which lie over the scene."""
        self.evaluate(
            "document.querySelector('#quiet') || document.head.insertAdjacentHTML('beforeend',"
            " '<style id=quiet>.mantine-Notifications-root { display: none }</style>')"
        )

    def seek(self, share: float) -> float:
        """Move a replay's slider to a share of its length, which stops it; return the time in s that it comes to."""
        left, top, width, height = self.until(
            "(() => { const bar = document.querySelector('.mantine-Slider-track');"
            " const r = bar && bar.getBoundingClientRect();"
            " return r && r.width > 0 ? [r.left, r.top, r.width, r.height] : null; })()"
        )
        length_s = float(self.evaluate(f"{THUMB}.getAttribute('aria-valuemax')"))
        wanted_s, end = share * length_s, time.monotonic() + WAIT_S
        while time.monotonic() < end:
            # A page that still builds its scene misses a click, and one that is slow to draw may play a frame more.
            self.click(left + share * width, top + height / 2)
            self._frames(4)
            if abs(self.time_s() - wanted_s) < 2 * length_s / width + 0.01:
                return self.time_s()
        raise TimeoutError(f"the slider never stood at {wanted_s:.2f} s; errors: {self.errors}")

    def time_s(self) -> float:
        """Return the time in s at which a replay's slider stands."""
        return float(self.until(f"{THUMB}?.getAttribute('aria-valuenow') ?? null"))

    def _drawn(self) -> NDArray[np.uint8]:
        """Return what is seen after some more frames."""
        self._frames(3)
        time.sleep(0.4)
        return self.picture()

    def _frames(self, count: int) -> None:
        """Wait until the page has drawn so many more frames."""
        count_down = "const f = () => n-- ? requestAnimationFrame(f) : done(true); f()"
        self.evaluate(f"new Promise(done => {{let n = {count}; {count_down}}})")

    def _note(self, message: dict[str, Any]) -> None:
        given = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(given["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(given["url"])
            case "Runtime.exceptionThrown":
                self.errors.append(str(given["exceptionDetails"].get("exception", {}).get("description")))
            case "Runtime.consoleAPICalled" if given["type"] == "error":
                self.errors.append(" ".join(str(part.get("value")) for part in given["args"]))


@contextmanager
def browser(width: int = 1280, height: int = 800) -> Iterator[Page]:
    """Yield an empty tab of a new Chromium, which reaches this machine alone."""
    path = find_chromium()
    if path is None:
        raise RuntimeError(f"no Chromium found under the names {', '.join(NAMES)}")
    with tempfile.TemporaryDirectory(prefix="trocar-browser-", ignore_cleanup_errors=True) as folder:
        command = [path, *FLAGS, f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with connect(_first_tab(Path(folder)), max_size=None, proxy=None, ping_interval=None) as socket:
                page = Page(socket, process.pid)
                size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                page.call("Emulation.setDeviceMetricsOverride", **size)
                yield page
        finally:
            process.terminate()
            process.wait(timeout=20)


def _first_tab(folder: Path) -> str:
    """Return the address under which a starting browser's first tab is spoken to."""
    end = time.monotonic() + WAIT_S
    file = folder / "DevToolsActivePort"
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while time.monotonic() < end:
        if file.exists() and (lines := file.read_text().split()):
            with direct.open(f"http://127.0.0.1:{lines[0]}/json/list") as answer:
                tabs = [tab for tab in json.loads(answer.read()) if tab["type"] == "page"]
            if tabs:
                return tabs[0]["webSocketDebuggerUrl"]
        time.sleep(0.1)
    raise TimeoutError("Chromium did not start")


def take_pictures(address: str, stem: Path, shares: list[float], keys: str = "") -> list[Path]:
    """Take pictures of a replay at shares of its length, ``STEM_K.png``, or of a page as it is, ``STEM.png``."""
    files = []
    with browser(*((1280, 800) if shares else (1280, 900))) as page:
        page.open(address if "://" in address else Path(address).resolve().as_uri(), fineness=2)
        for number, share in enumerate(shares, 1):
            page.seek(share)
            name = f"{stem.name}_{number}.png" if len(shares) > 1 else f"{stem.name}.png"
            files.append(_save(page.scene(), stem.with_name(name)))
        if not shares:
            page.until("document.querySelectorAll('.uplot').length > 0")
            for key in keys:
                page.until("document.body.innerText.includes('Waits for your yes')")
                page.key(key)
                time.sleep(1.0)
            files.append(_save(page.scene(LIVE_S), stem.with_suffix(".png")))
    return files


def _save(picture: NDArray[np.uint8], file: Path) -> Path:
    Image.fromarray(picture).save(file, optimize=True)
    return file


if __name__ == "__main__":
    keys = [word for word in sys.argv[3:] if word.isalpha()]
    shares = [float(word) for word in sys.argv[3:] if not word.isalpha()]
    print(*take_pictures(sys.argv[1], Path(sys.argv[2]), shares, "".join(keys)), sep="\n")
