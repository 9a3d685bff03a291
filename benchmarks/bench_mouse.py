"""One transfer by the mouse alone: a headless Chromium drags the handle's axes and arcs, and presses the jaws' buttons.

The scripted person of `bench_console.py` sees the true poses of tip and blocks, and acts in the browser: it projects
the handle's axes into the picture with the page's camera, presses the mouse on one, drags it by the visible error along
it, waits until the arm has followed, lets go, and looks again. At first it brings the board into the middle with the
right button, and nearer with the wheel, since the handle is small.

Run: .venv/bin/python benchmarks/bench_mouse.py --seed 31
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bench_console import ARM, Person, Seat

from trocar.eval.config import RunConfig
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.console_view import HANDLE_M
from trocar.view.wishes import Wish

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "view"))
from browser import browser

SIZE = (1300, 900)
FINENESS = 0.15
"""Pixels drawn per pixel of the page, on each axis: without a graphics card, drawing is slow."""
MIDDLE, WIDE, WHEELS = (0.5, 0.6), 0.4, 40
"""Where in the picture the board is brought, and how wide: shares of the picture; turns of the wheel at most."""
ARROW, ARC = 0.85 * HANDLE_M, 0.65 * HANDLE_M
"""Where an axis is grasped, from the handle's middle, and the radius of its arcs."""
STEPS = 2
"""Steps of the mouse in one drag."""
TURN_RAD = 0.6
"""Largest turn in one drag."""
NEAR_STEP_M, FAR_M = 8e-3, 0.05
"""Largest drag along an axis when the goal is nearer than ``FAR_M``: the arm does not follow in a straight line."""
LOOKS = 20
"""Rounds of looking and dragging on the way to one goal, at most."""
NEAR_M, NEAR_RAD = 1.0e-3, 0.12
BESIDE_M = 1.2e-3
"""Near a goal, the tip goes down only where it is at most this far beside the way."""
WORSE = 1.3
"""If the wrist does not turn any further, its orientation is accepted until it is off by this many times as much."""
SENT_S = 0.3
STILL_M, STILL_S, PATIENCE_S, LATE_S = 5e-4, 0.5, 8.0, 60.0
HANDLE = f"window.__viserMutable.nodePoseData['/handles/{ARM}']"
DRAWN = f"""
new Promise(done => {{
  let frames = 3;
  const pose = () => ({{p: [...{HANDLE}.position], q: [...{HANDLE}.wxyz]}});
  const next = () => frames-- ? requestAnimationFrame(next) : done(pose());
  next();
}})
"""
PROJECT = """
(points => {
  const page = window.__viserMutable, camera = page.camera, canvas = document.querySelector('canvas');
  const box = canvas.getBoundingClientRect(), root = page.nodeRefFromName[''].matrixWorld;
  return points.map(p => {
    const seen = camera.position.clone().set(...p).applyMatrix4(root).project(camera);
    return [box.left + (seen.x + 1) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
  });
})
"""
"""Returns where points of the world are in the picture, in pixels of the page."""


class Mouse(Person):
    """Moves the arm by the handle on the page.

    Args:
        watch: the console whose page it uses.
    """

    def __init__(self, watch: Seat):
        super().__init__(0, 0.0, 0.0, np.random.default_rng(0))  # sees at once, and does not tremble
        self.watch, self.jaws, self.drags = watch, -1.0, 0
        self.wrong: BaseException | None = None

    def run(self) -> None:
        """Do the task, then press the button that ends it, after an error too."""
        with browser(*SIZE) as page:
            self.page = page
            try:
                page.call("Page.navigate", url=f"{self.watch.address}?fixedDpr={FINENESS}")
                page.until(f"!!window.__viserMutable?.camera && !!{HANDLE}")
                page.quiet()
                self.find()
                self.come_near()
                for source, target in self.goals:
                    self.transfer(source, target)
            except BaseException as error:
                self.wrong = error
            page.press("Task done")
            while not self.watch.console._done.is_set():
                time.sleep(0.1)

    def come_near(self) -> None:
        """Drag the picture and turn the wheel until the board fills it."""
        size = np.array(self.page.evaluate("(c => [c.clientWidth, c.clientHeight])(document.querySelector('canvas'))"))
        pegs_m = self.scene.T_world_board.apply(self.scene.board.pegs_m)
        for _ in range(WHEELS):
            pegs = np.array(self.page.evaluate(f"{PROJECT}({pegs_m.tolist()})"))
            if np.ptp(pegs[:, 0]) > WIDE * size[0]:
                return
            self.pull(size / 2 + np.linspace(0.0, 1.0, STEPS + 1)[:, None] * (MIDDLE * size - pegs.mean(0)), "right", 2)
            x, y = size / 2
            self.page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
            self.page.evaluate(DRAWN)

    def go(self, goal: SE3, jaw: float, of: str = "tip") -> None:
        """Drag axes and arcs until the tip, or the block that it holds, is seen at its goal."""
        self.press(jaw)
        refused_rad = 0.0
        for _ in range(LOOKS):
            turn_rad = np.linalg.norm(self.twist(goal, of))
            if turn_rad > max(NEAR_RAD, WORSE * refused_rad):
                self.turn(self.twist(goal, of))
                refused_rad = turn_rad if np.linalg.norm(self.twist(goal, of)) > 0.9 * turn_rad else 0.0
            self.shift(goal, of)
            off_m, turn_rad = np.linalg.norm(self.off(goal, of)), np.linalg.norm(self.twist(goal, of))
            if off_m < NEAR_M and turn_rad < max(NEAR_RAD, WORSE * refused_rad):
                break
        off_mm = np.round(1e3 * self.off(goal, of), 1)
        where = f"{off_mm} mm and {turn_rad:.2f} rad from its goal after {self.drags} drags"
        print(f"{self.now_s():.0f} s: the {of.replace('_', ' ')} is {where}", flush=True)

    def shift(self, goal: SE3, of: str) -> None:
        """Drag each axis by the error along it: the largest first, or near the goal those along the board first."""
        near = np.linalg.norm(self.off(goal, of)) < FAR_M
        errors_m = np.abs(self.handle.rotation.matrix.T @ self.off(goal, of))
        upright = np.abs(self.handle.rotation.matrix[2])
        for axis in np.argsort(upright if near else -errors_m):
            step, off = self.handle.rotation.matrix[:, axis], self.off(goal, of)
            away_m = step @ off
            beside_m = np.linalg.norm(off - away_m * step)
            down = near and axis == upright.argmax() and off[2] < 0.0
            if abs(away_m) < NEAR_M / 2 or (down and beside_m > BESIDE_M):
                continue
            if near:
                away_m = np.clip(away_m, -NEAR_STEP_M, NEAR_STEP_M)
            start = self.handle.translation_m + ARROW * step
            self.drag(start + away_m * np.linspace(0.0, 1.0, STEPS + 1)[:, None] * step)

    def twist(self, goal: SE3, of: str) -> np.ndarray:
        """Return the rotation vector (3,) from the orientation that is seen to the goal's."""
        return (goal.rotation @ self.seen()[of].rotation.inverse()).log()

    def off(self, goal: SE3, of: str) -> np.ndarray:
        """Return the displacement (3,) from the position that is seen to the goal's."""
        return goal.translation_m - self.seen()[of].translation_m

    def turn(self, turn: np.ndarray) -> None:
        """Drag one arc, that nearest to a rotation vector (3,) in the world, by at most ``TURN_RAD``."""
        held = self.handle.rotation
        own = (held.inverse() @ SO3.exp(turn) @ held).log()
        axis = int(np.abs(own).argmax())
        angle = float(np.clip(own[axis], -TURN_RAD, TURN_RAD))
        first, second = held.matrix[:, (axis + 1) % 3], held.matrix[:, (axis + 2) % 3]
        angles = np.pi / 4 + angle * np.linspace(0.0, 1.0, STEPS + 1)[:, None]
        self.drag(self.handle.translation_m + ARC * (np.cos(angles) * first + np.sin(angles) * second))

    def drag(self, points_m: np.ndarray) -> None:
        """Press the mouse on the first of some points (n, 3) of the world, drag it over them, wait, and let go."""
        if self.watch.console.standing.stopped:  # as when a busy browser lost its connection and found it again
            self.page.press("Go on")
        self.pull(self.page.evaluate(f"{PROJECT}({points_m.tolist()})"), "left", 1, self.rest)
        self.drags += 1
        self.rest()
        self.find()

    def pull(self, pixels: Any, button: str, number: int, before_end: Callable[[], None] = lambda: None) -> None:
        """Press a button of the mouse, of this number, at the first of some pixels, drag it over them, and let go."""
        for count, (x, y) in enumerate([pixels[0], pixels[0], *pixels]):
            kind = "mousePressed" if count == 1 else "mouseMoved"
            held = {"button": button, "buttons": number, "clickCount": 1} if count else {}
            self.page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)
            time.sleep(0.06)
        self.page.evaluate(DRAWN)  # all of that has come to the page, and goes to the console
        time.sleep(SENT_S)
        before_end()
        self.page.call("Input.dispatchMouseEvent", type="mouseReleased", button=button, clickCount=1, x=x, y=y)

    def rest(self) -> None:
        """Wait until the tip stands still, for ``PATIENCE_S`` at most."""
        began, since, before = self.now_s(), self.now_s(), self.seen()["tip"]
        while self.now_s() - since < STILL_S and self.now_s() - began < PATIENCE_S:
            self.sleep(0.05)
            now = self.seen()["tip"]
            if np.abs(now.translation_m - before.translation_m).max() > STILL_M:
                since, before = self.now_s(), now

    def find(self) -> None:
        """Wait until the page has drawn the handle where the console has it: a busy browser is late."""
        end = time.monotonic() + LATE_S
        while time.monotonic() < end:
            pose: Any = self.page.evaluate(DRAWN)
            self.handle = SE3.from_parts(SO3.from_quaternion(np.array(pose["q"])), np.array(pose["p"]))
            where = self.watch.console.standing.hands[ARM]
            if where is not None and np.abs(self.handle.translation_m - where[0]).max() < 1e-4:
                return
        raise TimeoutError("the page does not show the handle where the arm is")

    def wait(self, seconds: float, jaw: float) -> None:
        """Press what the jaws should do, and wait."""
        self.press(jaw)
        self.sleep(seconds)

    def press(self, jaw: float) -> None:
        """Have the jaws open or close."""
        if jaw != self.jaws:
            self.jaws = jaw
            self.page.press("a third" if jaw > 0 else "close")
            self.sleep(1.0)


class MouseSeat(Seat):
    """A console with a page, at which the person sits."""

    def __init__(self, speed: float):
        super().__init__(Mouse(self), speed=speed, port=0)
        self.said: list[Wish] = []

    def _hear(self) -> list:
        heard = super()._hear()
        self.said += [one.wish for one in heard]
        return heard


def main() -> None:
    """Run one trial."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--transfers", type=int, default=1)
    parser.add_argument("--speed", type=float, default=1.0, help="Seconds of the cell's clock a second.")
    parser.add_argument("--method", default="person", help="person, or person-calibrated.")
    parser.add_argument("--out", type=Path, help="Folder of the run; default: it is not kept.")
    given = parser.parse_args()
    config = RunConfig(PegTransfer(transfers=given.transfers, budget_s=1800.0), method=given.method, seed=given.seed)
    with MouseSeat(given.speed) as seat:
        seat.play(config, given.out)
        seat.person.thread.join()
    print(f"{seat.person.drags} drags, in which the page told {seat.said.count(Wish.HOLD)} places")
    if seat.person.wrong is not None:
        raise seat.person.wrong


if __name__ == "__main__":
    main()
