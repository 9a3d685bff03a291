"""One transfer through an unmodified third-party stack: teleop's own page in a browser, its server, and our example.

The person of `bench_console.py` holds a simulated telephone: Chromium shows teleop's page with a WebXR device made up
here, whose pose is that of the hand, and the page's buttons are clicked. Page, teleop's server and
`examples/teleop_phone.py` are the real ones. A real telephone, its tracking and its network are not tested.

Run: .venv/bin/python benchmarks/bench_teleop.py --python PYTHON_WITH_TELEOP --seed 45
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from trocar.eval.config import RunConfig
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.wishes import Said, Wish

sys.path.append(str(Path(__file__).parents[1] / "tests" / "view"))
from bench_console import Person, Seat
from browser import Page, browser

EXAMPLE = Path(__file__).parents[1] / "examples" / "teleop_phone.py"
DEVICE = """
window.phone = {position: {x: 0, y: 1, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}
class Session extends EventTarget {
  inputSources = []
  updateRenderState() {}
  async requestReferenceSpace() { return {} }
  requestAnimationFrame(draw) { return requestAnimationFrame(time => draw(time, this)) }
  getViewerPose() { return {views: [{transform: structuredClone(window.phone)}]} }
}
window.XRWebGLLayer = class {}
Object.defineProperty(navigator, "xr", {value: {requestSession: async () => new Session()}})
"""
"""The part of a WebXR device that teleop's page uses: a handheld one, which has a pose and no controllers."""
BUTTON = "document.querySelector('#teleop-ui').shadowRoot.getElementById('{}')"
PRESS_S = 0.1
"""A button is pressed, or released, at least this long: the page polls it once per frame."""
START_S = 30.0
LATE_S, TREMOR_M = 0.2, 1e-3


class Telephone(Person):
    """A person who uses teleop's page instead of a device.

    Args:
        page: a tab on which nothing is open yet.
        given: arguments of ``Person``.

    Attributes:
        sent: when the hand was at each displacement, in tenths of a micrometre since it pressed *move*.
        delays_s: time from then until the console received that displacement, by the machine's clock.
    """

    def __init__(self, page: Page, *given: Any):
        super().__init__(*given)
        self.page, self.moves, self.closed = page, False, False
        self.sent: dict[tuple[int, ...], float] = {}
        self.hand_m = self.began = self.clutched = np.zeros(3)
        self.delays_s: list[float] = []

    def start_page(self, port: int) -> None:
        """Open teleop's page and start WebXR there."""
        self.page.call("Security.setIgnoreCertificateErrors", ignore=True)  # teleop signs its own
        self.page.call("Page.addScriptToEvaluateOnNewDocument", source=DEVICE)
        self.page.call("Page.navigate", url=f"https://127.0.0.1:{port}/")
        self.page.until("document.querySelector('.connected') !== null", START_S)
        self.page.click(*self.middle("document.querySelector('#start-button')"))
        self.page.until("document.querySelector('#app').style.display === 'block'", START_S)
        self.places = {name: self.middle(BUTTON.format(name)) for name in ("motionButton", "gripperButton")}

    def middle(self, what: str) -> tuple[float, float]:
        """Return the middle of an element on the page, in pixels."""
        box = f"(() => {{ const b = {what}.getBoundingClientRect(); return [b.x, b.y, b.width, b.height] }})()"
        x, y, width, height = self.page.evaluate(box)
        return x + width / 2, y + height / 2

    def say(self, **line: Any) -> None:
        """Do on the page what a device's line says; send wishes to the console."""
        if "wish" in line:
            super().say(**line)
            return
        if "jaw" in line and (line["jaw"] == 0) != self.closed:  # the other thumb; on this page it ends a move
            self.hold(False)
            self.page.click(*self.places["gripperButton"])
            self.closed = not self.closed
        if line["held"]:
            self.place(np.array(line["position"]), np.array(line["quaternion"]))
        self.hold(line["held"])

    def hold(self, pressed: bool) -> None:
        """Press *move*, or let it go."""
        if pressed == self.moves:
            return
        kind = "mousePressed" if pressed else "mouseReleased"
        x, y = self.places["motionButton"]
        self.page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        self.moves, self.began = pressed, self.hand_m
        self.sleep(PRESS_S)

    def place(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Bring the telephone somewhere: WebXR's axes point right, up and back, the board's right, forward and up."""
        self.hand_m = position
        (x, y, z), (i, j, k, w) = position, quaternion
        pose = {"position": dict(x=x, y=1 + z, z=-y), "orientation": dict(x=i, y=k, z=-j, w=w)}
        self.sent.setdefault(key(position - self.began), time.monotonic())
        self.page.evaluate(f"window.phone = {json.dumps(pose)}; 0")

    def note(self, said: Said) -> None:
        """Note how long a pose took to reach the console."""
        if said.wish is Wish.RELEASE:
            self.clutched = np.full(3, np.nan)
        if said.wish is not Wish.HOLD:
            return
        self.clutched = np.where(np.isnan(self.clutched), said.value.position_m, self.clutched)
        began_s = self.sent.pop(key(said.value.position_m - self.clutched), None)
        self.delays_s += [said.at_s - began_s] if began_s is not None else []


def key(displacement_m: np.ndarray) -> tuple[int, ...]:
    return tuple(np.rint(1e7 * displacement_m).astype(int).tolist())


def main() -> None:
    """Run one trial."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", required=True, help="A Python that has teleop (0.1.5).")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=float, default=1.0, help="Seconds of the cell's clock a second.")
    parser.add_argument("--out", type=Path, help="Folder of the run; default: it is not kept.")
    given = parser.parse_args()
    config = RunConfig(PegTransfer(transfers=1), method="person", seed=given.seed)
    with browser() as page:
        person = Telephone(page, 0, LATE_S, TREMOR_M, np.random.default_rng(given.seed))
        with Seat(person, speed=given.speed, port=None, inputs=0) as seat, example(given.python, person.port) as port:
            person.start_page(port)
            hear = seat._inputs.said
            seat._inputs.said = lambda: [person.note(said) or said for said in hear()]
            seat.play(config, given.out)
    for way, delays_s in (("telephone to console", person.delays_s), ("console to set-point", seat.latencies_s)):
        p50, p95 = 1e3 * np.percentile(delays_s, (50, 95))
        print(f"{way}: p50 {p50:.0f} ms, p95 {p95:.0f} ms ({len(delays_s)} poses)")


@contextmanager
def example(python: str, console: int) -> Iterator[int]:
    """Run the example beside a console, and yield the port of teleop's server once that answers."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [python, EXAMPLE, "--console", str(console), "--port", str(port)]
    process = subprocess.Popen(words)
    try:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            if process.poll() is not None:
                raise SystemExit("the example has ended")
            time.sleep(0.1)
        yield port
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
