"""Real trials that a headless Chromium drives from their page."""

import re
import threading
import time
from contextlib import contextmanager
from importlib.resources import files

import numpy as np
import pytest

pytest.importorskip("viser")
from bench_emergency import rest_and_brake_s
from bench_mouse import PROJECT
from browser import NAMES, browser, find_chromium
from live_scene import until

from trocar.console import Watch
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.wishes import Level, Said, Wish

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(find_chromium() is None, reason=f"no Chromium found ({', '.join(NAMES)})"),
]
ARM, SIZE = "psm1", (1000, 700)
COARSE = 0.15
"""Pixels drawn per pixel of the page, on each axis: drawing takes most of the time."""
SPEED = 0.25
"""Seconds of the cell's clock a second: a busy machine's browser takes a while to press a key while a motion runs."""
HANDLE = f"window.__viserMutable.nodePoseData['/handles/{ARM}']"


class Seat(Watch):
    """A console whose page a person drives, in a thread of its own.

    Attributes:
        said: wishes, each with the cell's time.
        page: that the person has open.
    """

    def __init__(self, level, person):
        super().__init__(level, SPEED, port=0, told=lambda address: self.thread.start())
        self.said, self.page, self._wrong = [], None, None
        self.thread = threading.Thread(target=self._sit, args=(person,))

    def _sit(self, person):
        try:
            person(self)
        except BaseException as error:  # else the trial would wait for ever
            self._wrong = error

    def _hear(self):
        heard = [Said(Wish.EMERGENCY, value="the test went wrong")] if self._wrong else super()._hear()
        self.said += [(one.wish, self.console.now_s) for one in heard]
        return heard

    @contextmanager
    def opened(self):
        """Open the page in a new browser, and close it."""
        with browser(*SIZE) as self.page:
            self.page.open(self.address, COARSE)
            self.page.quiet()
            self.sees("EMERGENCY STOP")
            yield self.page

    def sees(self, words):
        self.page.until(f"document.body.innerText.includes({words!r})")

    def play(self, folder):
        """Play a trial with cables that do not stretch, and return it."""
        text = (files("trocar.lab") / "stations/peg-transfer.toml").read_text(encoding="utf-8")
        station = folder / "stiff.toml"
        station.write_text(re.sub('transmission = "[^"]*"', 'transmission = "stiff"', text), encoding="utf-8")
        task = PegTransfer(transfers=1)
        config = RunConfig(task, method="uncalibrated", seed=3, difficulty="mild", station=str(station))
        with self:
            trial = run_trial(config, prepare(config, 0, folder), 0, attendant=self)
            self.thread.join()
        if self._wrong is not None:
            raise self._wrong
        return trial

    def moves(self):
        """Return whether a motion of the script has come some way."""
        robot = self.console._robot
        return any(robot.setpoint(arm).path_s > 0.1 for arm in [*robot.running])

    def rests_in_time(self, trial, wish):
        """Return whether the arms, one of which moved, came to rest at once after a wish was heard first."""
        first = next(number for number, (said, _) in enumerate(self.said) if said is wish)
        times_s = [at_s for _, at_s in self.said[first:]]
        rest_s, brake_s = rest_and_brake_s(trial, self.console.cell.limits, *times_s[:2])
        print(f"{wish.name}: at rest after {rest_s:.2f} s; their limits make them brake for {brake_s:.2f} s")
        return brake_s > 0.0 and rest_s <= brake_s + 0.1

    def tip(self):
        return self.console.hands[ARM].tip

    def steps(self, letter):
        """Press a key; return how far (3,) it moved the tip."""
        before, count = self.tip().translation_m, len(self.said)
        self.page.key(letter)
        until(lambda: len(self.said) > count and not self.console.hands[ARM].held)
        return self.tip().translation_m - before

    def takes_the_handle_and_lets_it_go(self):
        """Press the mouse on the handle, and release it there; return the wishes that came."""
        tip_m, count = self.tip().translation_m, len(self.said)
        until(lambda: np.abs(np.array(self.page.evaluate(f"[...{HANDLE}.position]")) - tip_m).max() < 1e-5)
        ((x, y),) = self.page.evaluate(f"{PROJECT}({[tip_m.tolist()]})")
        for kind in ("mouseMoved", "mouseMoved", "mousePressed", "mouseReleased"):
            held = {"button": "left", "clickCount": 1} if kind != "mouseMoved" else {}
            self.page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)
            time.sleep(0.3)
        until(lambda: self.said[count:] and self.said[-1][0] is Wish.RELEASE)
        return [wish for wish, _ in self.said[count:]]


def test_a_person_confirms_stops_takes_over_jogs_and_hands_back_and_the_transfer_succeeds(tmp_path):
    seen = {}

    def drive(seat):
        with seat.opened() as page:
            seat.sees("Waits for your yes")
            page.key("Y")
            until(seat.moves)
            page.key("S")
            seat.sees("Stopped: arms stay")
            until(lambda: not any(seat.console.cell.robot.setpoint(arm).moving for arm in ("psm1", "psm2")))
            page.key("G")
            seat.sees("Waits for your yes")  # for what is left of the motion
            page.press(f"Take over {ARM}")
            seat.sees(f"Keys move {ARM}")
            seen["up"], seen["down"] = seat.steps("U"), seat.steps("O")
            before = seat.tip().matrix
            seen["wishes"] = seat.takes_the_handle_and_lets_it_go()
            seen["taken"] = seat.tip().matrix - before
        until(lambda: seat.console.stopped)  # the page is gone
        seen["left"] = seat.console.standing.words
        with seat.opened() as page:
            page.press("Go on")
            page.press(f"Hand {ARM} back")
            seat.sees("Waits for your yes")
            page.choose("x 0.25", "as fast as it can")
            page.choose(Level.MOTIONS.value, Level.AUTONOMOUS.value)
            until(lambda: seat.console.level is Level.AUTONOMOUS)

    seat = Seat(Level.MOTIONS, drive)
    trial = seat.play(tmp_path)
    assert trial.ended == "done" and trial.scores[0]["succeeded"]
    assert max(trial.command_limit_use[ARM]) <= 1.001
    assert seat.rests_in_time(trial, Wish.STOP)
    assert "Stopped" in seen["left"], "a page that is closed while an arm is in hand stops all arms"
    for way, moved_mm in (("up", 1.0), ("down", -1.0)):
        np.testing.assert_allclose(1e3 * seen[way], [0.0, 0.0, moved_mm], atol=1e-3)
    assert seen["wishes"] == [Wish.HOLD, Wish.RELEASE]
    np.testing.assert_allclose(seen["taken"], 0.0, atol=1e-9)


def test_the_emergency_stop_on_the_page_ends_the_trial(tmp_path):
    def drive(seat):
        with seat.opened() as page:
            until(seat.moves)
            page.key("X")
            seat.sees("Ended: a person pressed")

    seat = Seat(Level.AUTONOMOUS, drive)
    trial = seat.play(tmp_path)
    assert (trial.ended, trial.reason) == ("FAULT", "a person pressed the emergency stop")
    assert max(trial.command_limit_use[ARM]) <= 1.001
    assert seat.rests_in_time(trial, Wish.EMERGENCY)
