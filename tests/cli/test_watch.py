"""``trocar run --watch``: what it refuses, and that a person beside a run changes nothing by being there."""

import json
import socket
from types import SimpleNamespace

import pytest

from trocar.cell import SEAT
from trocar.cli.console import opened_console
from trocar.console import Watch
from trocar.console.watch import FROZEN_S
from trocar.errors import EmergencyStop
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.wishes import Level, Said, Wish

SHORT, POLICY = ("--transfers", "1"), "builtins:repr"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--confirm", "motions"), "give --watch"),
        (("--speed", "2"), "give --watch"),
        (("--devices", "0"), "give --watch"),
        (("--watch", "--jobs", "2"), "one person"),
        (("--watch", "--speed", "-1"), "above 0"),
        (("--watch", "--confirm", "everything"), "goals, motions"),
        (("--method", "person-calibrated"), "give --watch"),
        (("--watch", "--confirm", "motions", "--method", "policy", "--policy", POLICY), "a policy streams"),
        (("--watch", "--speed", "2", "--robot", "crtk:peg-transfer", "--method", "uncalibrated"), "simulated cell"),
    ],
)
def test_what_needs_a_console_says_so(trocar, tmp_path, words, said):
    code, out, err = trocar("run", "peg-transfer", *SHORT, *words, "--out", tmp_path / "run")
    assert code == 2 and said in " ".join((out + err).split())
    assert not (tmp_path / "run").exists()


class Agreeable(Watch):
    """A console without a page, whose person says yes to everything, a little later."""

    def attend(self, config, laboratory):
        super().attend(config, laboratory)
        self.seated = laboratory.cell.assistants[SEAT]
        self.asked = 0

    def _hear(self):
        if not self.console.standing.asks:
            return []
        self.asked += 1
        return [Said(Wish.YES)] if self.asked % 2 == 0 else []


@pytest.mark.slow
def test_a_trial_of_which_each_motion_was_confirmed_is_that_of_the_script_alone(tmp_path):
    config = RunConfig(PegTransfer(transfers=1), method="uncalibrated", seed=3)
    prepared = prepare(config, 0, tmp_path)
    alone = run_trial(config, prepared, 0)
    with Agreeable(Level.MOTIONS, 0.0, port=None) as watch:
        beside = run_trial(config, prepared, 0, attendant=watch)
    assert watch.asked > 10 and watch.seated is watch.console
    for trial, name in ((alone, "alone"), (beside, "beside")):
        trial.events[:] = [event for event in trial.events if event["name"] != "person"]
        trial.save(tmp_path / f"{name}.npz")
    assert (tmp_path / "alone.npz").read_bytes() == (tmp_path / "beside.npz").read_bytes()


@pytest.mark.slow
def test_an_emergency_stop_keeps_the_trial_with_its_reason(tmp_path):
    config = RunConfig(PegTransfer(transfers=1), method="uncalibrated", seed=3)

    class Frightened(Watch):
        def _hear(self):
            cell = self.console.cell
            return [Said(Wish.EMERGENCY)] if cell is not None and cell.clock.now_s() > 1.0 else []

    with Frightened(speed=0.0, port=None) as watch:
        prepared = prepare(config, 0, tmp_path)
        trial = run_trial(config, prepared, 0, attendant=watch)
        with pytest.raises(EmergencyStop, match="the run ends here"):
            run_trial(config, prepared, 1, attendant=watch)
    assert (trial.ended, trial.reason) == ("FAULT", "a person pressed the emergency stop")
    assert trial.duration_s < 2.0 and not trial.scores[0]["succeeded"]


@pytest.mark.slow
def test_a_person_moves_an_arm_through_a_device(tmp_path):
    config = RunConfig(PegTransfer(transfers=1), method="person", seed=3)
    told = []

    class Scripted(Watch):
        def _show(self):
            super()._show()
            now_s = self.console.cell.clock.now_s()
            line = {"arm": "psm1", "held": True, "position": [0.0, 0.0, min(0.01, 0.02 * now_s)]}
            self.stream.write(json.dumps(line if now_s < 1.0 else {"wish": "done"}).encode() + b"\n")
            self.stream.flush()
            told.append(json.loads(self.stream.readline()))

    with (
        Scripted(speed=1.0, port=None, inputs=0) as watch,
        socket.create_connection(("127.0.0.1", watch._inputs.port)) as connection,
        connection.makefile("rwb") as watch.stream,
    ):
        trial = run_trial(config, prepare(config, 0, tmp_path), 0, attendant=watch)
    assert trial.ended == "done" and len(watch.latencies_s) > 20 and all("error" not in answer for answer in told)
    rose_m = told[-1]["arms"]["psm1"]["position"][2] - told[1]["arms"]["psm1"]["position"][2]
    assert abs(rose_m - 0.01) < 5e-4


@pytest.mark.slow
def test_a_trial_that_was_watched_has_the_bytes_of_one_that_nobody_saw(tmp_path):
    pytest.importorskip("viser")
    config = RunConfig(PegTransfer(transfers=1), method="uncalibrated", seed=3)
    prepared = prepare(config, 0, tmp_path)
    run_trial(config, prepared, 0).save(tmp_path / "alone.npz")
    with Watch(speed=0.0, port=0) as watch:
        run_trial(config, prepared, 0, attendant=watch).save(tmp_path / "watched.npz")
        assert watch._page is not None and watch._shown is not None, "it was shown"
    assert (tmp_path / "alone.npz").read_bytes() == (tmp_path / "watched.npz").read_bytes()


def test_a_page_whose_process_hangs_counts_as_left_once_each_time():
    watch, page = Watch(port=None), SimpleNamespace(ended=False, unanswered_s=FROZEN_S + 1.0, said=list)
    watch._page = page
    assert not watch._hear(), "nobody needs it"
    watch.console.level = Level.MOTIONS
    assert [one.wish for one in watch._hear()] == [Wish.LEFT]
    assert not watch._hear()
    page.unanswered_s = 0.0
    assert not watch._hear()
    page.unanswered_s = FROZEN_S + 1.0
    assert [one.wish for one in watch._hear()] == [Wish.LEFT]


@pytest.mark.parametrize("how", ["stopped", "paused"])
def test_a_run_that_stands_ends_with_the_process_of_its_page(how):
    """Nobody could let it go on."""
    watch = Watch(port=None)
    watch._page = SimpleNamespace(ended=True, unanswered_s=0.0, said=list)
    assert not watch._hear(), "a run that needs nobody goes on"
    setattr(watch.console, how, True)
    assert [one.wish for one in watch._hear()] == [Wish.EMERGENCY]


def test_latencies_are_printed_though_an_emergency_stop_ends_the_run(capsys):
    with pytest.raises(EmergencyStop), opened_console("nothing", 1.0, None) as console:
        console.latencies_s += [0.010, 0.030]
        raise EmergencyStop("pressed")
    assert "p50 20 ms" in "".join(capsys.readouterr())


@pytest.mark.slow
def test_a_page_whose_process_has_ended_ends_a_trial_that_waits_for_somebody(tmp_path):
    pytest.importorskip("viser")
    config = RunConfig(PegTransfer(transfers=1), method="uncalibrated", seed=3)

    class Killed(Watch):
        def _show(self):
            super()._show()
            if self._page is not None and self.console.standing.asks:
                self._page._process.kill()

    with Killed(Level.MOTIONS, 0.0, port=0) as watch:
        trial = run_trial(config, prepare(config, 0, tmp_path), 0, attendant=watch)
    assert (trial.ended, trial.reason) == ("FAULT", "the process that shows the page has ended")
