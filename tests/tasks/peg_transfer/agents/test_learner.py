"""An arm that learns its cables from looks at its wrist: a scripted robot, and a whole trial in the cell `recorded`."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

from simulated import STATION, coarse, ideal_laboratory, standing
from trocar.errors import InvalidInput
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.robots import Adaptive
from trocar.tasks.peg_transfer.agents import Settings, learner
from trocar.tasks.peg_transfer.agents.peg_arm import OVER_PEGS_M
from trocar.tasks.peg_transfer.agents.unilateral import Unilateral
from trocar.tasks.peg_transfer.goals import Transfer
from trocar.tasks.peg_transfer.shapes import Pegboard
from trocar.tasks.peg_transfer.task import PegTransfer
from two_armed import briefed

ARM = "psm1"
GOALS = (Transfer(1, 7), Transfer(0, 6))


class Pupil(Adaptive):
    """A robot that finds what a test tells it to find, and notes what its agent asks of it."""

    move, jaw, read, setpoint, hold, prepare, rest = (
        property(attrgetter(f"inner.{verb}")) for verb in ("move", "jaw", "read", "setpoint", "hold", "prepare", "rest")
    )

    def __init__(self, inner, finds):
        self.inner, self.finds, self.noted = inner, list(finds), []

    def note(self, what, value=None):
        self.noted.append((what, value))
        return True

    def moment(self, arm):
        return len(self.noted), self.inner.setpoint(arm).q

    def saw(self, arm, row, sighting):
        self.note("saw", sighting)

    def learned(self, arm):
        return self.finds.pop(0)

    def adopt(self, arm, knowledge):
        assert not self.inner.setpoint(arm).moving
        self.note("adopt", knowledge)

    def correct(self, arm, sighting):
        return self.note("correct", sighting)

    def spread(self, arm):
        return None


def taught(monkeypatch, finds, unseen=(), robot=Pupil):
    """Let an arm with three teaching looks do two transfers; return what its robot was told, and the laboratory."""
    looks = []

    def sight(image, T_base_camera, arm, q, jaw_rad, T_base_floor):
        looks.append((lab.agent.arm.height_m, T_base_floor is not None))
        return None if len(looks) - 1 in unseen else len(looks) - 1

    monkeypatch.setattr(learner, "sight", sight)
    lab = ideal_laboratory(*(standing(goal.source) for goal in GOALS), station=coarse(STATION))
    lab.cell = replace(lab.cell, robot=robot(lab.cell.robot, finds))
    settings = Settings(teaching_looks=3, fixed_wrist=True)
    lab.agent = Unilateral(briefed(lab, goals=GOALS, settings=settings))
    assert lab.run(lambda cell: lab.agent.run(), 90.0)
    return lab.cell.robot.noted, looks, lab.log.events


def test_what_is_learned_is_used_from_the_next_rest_on_and_never_unlearned(monkeypatch):
    """The second look shows no wrist; the fit after the first block finds more, that after the second nothing."""
    noted, looks, events = taught(monkeypatch, ["first", "better", None], unseen=[1])
    assert noted == [
        *(("saw", 0), ("saw", 2), ("adopt", "first")),
        *(("saw", 3), ("correct", 3), ("adopt", "better")),
        *(("saw", 4), ("correct", 4)),
    ]
    assert [over_a_block for _, over_a_block in looks] == [False] * 3 + [True] * 2
    over_pegs_m = Pegboard().peg_height_m + OVER_PEGS_M
    assert [height_m for height_m, _ in looks[3:]] == pytest.approx([over_pegs_m] * 2, abs=0.5e-3)
    assert min(height_m for height_m, _ in looks[:3]) > 2 * Pegboard().peg_height_m
    names = [event["name"] for event in events]
    assert names.count("wrist not seen") == 1 and names.count("wrist seen") == 2
    assert "cables not learned" not in names
    assert [event["outcome"] for event in events if event["name"] == "transfer"] == ["DONE", "DONE"]


def test_an_arm_whose_looks_show_too_little_says_so_and_goes_on(monkeypatch):
    noted, _, events = taught(monkeypatch, [None, "late"], unseen=[0, 1, 2, 3])
    assert noted == [("saw", 4), ("correct", 4), ("adopt", "late")]
    assert [event["name"] for event in events].count("cables not learned") == 1
    assert [event["outcome"] for event in events if event["name"] == "transfer"] == ["DONE", "DONE"]


def test_a_robot_that_does_not_learn_is_refused(monkeypatch):
    with pytest.raises(InvalidInput, match="does not learn its cables; make Adaptive the outermost wrapper"):
        taught(monkeypatch, [], robot=lambda inner, finds: inner)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    run = RunConfig(PegTransfer(transfers=2), method="adaptive", difficulty="recorded", seed=5)
    return run_trial(run, prepare(run, 0, tmp_path_factory.mktemp("adaptive")), 0)


def errors_at(trial, time_s):
    at = round(time_s / trial.scenery.tick_s)
    return (trial.arrays[f"true_{ARM}"] - trial.arrays[f"desired_{ARM}"])[at, 3:6]


@pytest.mark.slow
def test_without_a_recording_blocks_are_moved(trial):
    assert [score["succeeded"] for score in trial.scores] == [True, True]
    assert trial.about["prior"] == "fleet" and trial.about["calibration"] is None


@pytest.mark.slow
def test_looks_before_the_first_transfer_leave_a_fraction_of_the_errors(trial):
    (first, *_) = [event["start_s"] for event in trial.events if event["name"] == "transfer"]
    assert 15.0 < first < 40.0, "the looks count"
    assert np.abs(errors_at(trial, 0.5)).max() > 0.1
    assert np.abs(errors_at(trial, first)).max() < 0.1


@pytest.mark.slow
def test_it_knows_how_far_off_it_may_be(trial):
    looks = [event for event in trial.events if event["name"] == "wrist seen"]
    assert len(looks) >= 2 and any(event["accepted"] for event in looks)
    for event in looks:
        before = errors_at(trial, event["time_s"] - 2 * trial.scenery.tick_s)
        assert (np.abs(before) < 3.5 * np.array(event["spread_rad"])).all()
