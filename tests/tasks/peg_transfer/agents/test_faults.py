"""Faults of every kind with method `best`: each has a name, the arms come to rest, the trial is saved.

Each kind is tested in every variant whose own script handles it; faults handled by shared code are tested in one or two
variants. All of them run as ordinary trials in a cell without cable errors, and are read back from the trial's file.
"""

from dataclasses import replace

import numpy as np
import pytest
import trio

from simulated import STATION, coarse, ideal_session, scene_of, standing
from trocar.calibration.models import OffsetModel
from trocar.calibration.models.base import TrainingMotion
from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.eval.prepare import Prepared
from trocar.eval.run import run_trial
from trocar.eval.trial import Trial
from trocar.motion import PLANNERS
from trocar.perception.image import RgbdImage
from trocar.robots import TICK_S
from trocar.tasks.peg_transfer.agents import agent_of, quick
from trocar.tasks.peg_transfer.goals import GOALS, TransferOutcome
from trocar.tasks.peg_transfer.shapes import Block
from trocar.tasks.peg_transfer.task import PegTransfer
from two_armed import Wrapped, silent, stuck

BEST = PegTransfer.methods["best"]
SETTINGS = quick()
VARIANTS = tuple(GOALS)
PEGS = range(6)
STILL_S = 0.2
MIDWAY = 1 / 3
NOTHING = "this planner finds nothing"

ARM_STOPPED, BLOCKED = TransferOutcome.ARM_STOPPED.name, TransferOutcome.BLOCKED.name
BOARD_NOT_FOUND, NO_BLOCK = TransferOutcome.BOARD_NOT_FOUND.name, TransferOutcome.NO_BLOCK.name
DONE, DROPPED = TransferOutcome.DONE.name, TransferOutcome.DROPPED.name
NOT_GRASPED, OUT_OF_REACH = TransferOutcome.NOT_GRASPED.name, TransferOutcome.OUT_OF_REACH.name


def dark(*frames, onwards=False):
    """Return a camera of whose images those with these numbers are empty; onwards: all later ones too."""

    class Dark(Wrapped):
        taken = 0

        async def capture(self):
            number, self.taken = self.taken, self.taken + 1
            image = await self.inner.capture()
            if number not in frames and not (onwards and number > max(frames)):
                return image
            nothing = np.zeros_like(image.color), np.full_like(image.depth_m, np.nan)
            return RgbdImage(*nothing, image.intrinsics, image.time_s)

    return Dark


def clumsy(arm, share):
    """Return a robot one of whose arms loses the first block that it carries, after this share of the way.

    Where that is 0, the block has fallen before the arm moves.
    """

    class Clumsy(Wrapped):
        opened = closed = lost = False

        async def jaw(self, name, angle_rad):
            if name == arm:
                self.opened |= angle_rad > 0.1
                self.closed = self.opened and angle_rad < 0.1
            return await self.inner.jaw(name, angle_rad)

        async def move(self, motions):
            if arm not in motions or not self.closed or self.lost:
                return await self.inner.move(motions)
            self.lost = True
            if share == 0.0:
                await self.lose(2 * TICK_S)  # jaws that still press go on first
                return await self.inner.move(motions)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self.lose, share * motions[arm].duration_s)
                return await self.inner.move(motions)

        async def lose(self, after_s):
            await trio.sleep(after_s)
            await self.inner.jaw(arm, 0.6)

    return Clumsy


def cut_off(arm, motion):
    """Return a robot that raises an error in the midst of one arm's motion of this number."""

    class CutOff(Wrapped):
        count = 0

        async def move(self, motions):
            self.count += arm in motions
            if self.count != motion or arm not in motions:
                return await self.inner.move(motions)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self.fail, motions[arm].duration_s / 3)
                return await self.inner.move(motions)

        async def fail(self, after_s):
            await trio.sleep(after_s)
            raise ConnectionError("the controller does not answer")

    return CutOff


def no_way(*calls):
    """Return a planner that finds nothing when it is asked for these times, counted from 0; no number: ever."""
    asked = []

    def plan(problem, *args, **kwargs):
        asked.append(problem)
        if not calls or len(asked) - 1 in calls:
            raise TrocarError(NOTHING)
        return PLANNERS["optimal"](problem, *args, **kwargs)

    return plan


class Watched:
    """An agent that notes which arms still move when its script has ended, and watches them for a while."""

    def __init__(self, agent, cell):
        self.agent, self.cell = agent, cell

    async def run(self):
        await self.agent.run()
        moving = [name for name in self.cell.arms if self.cell.robot.setpoint(name).moving]
        self.cell.log.event("script ended", moving=moving)
        await self.cell.clock.sleep(STILL_S)


def block_on(peg, height_m=0.0):
    return standing(peg, (0.5e-3, 0.3e-3), 0.3 + peg, height_m)


def without_cables(station):
    """Return a session of exact joints, whose arms wear a compensation that has nothing to do."""
    session = ideal_session(station)
    models = {
        name: OffsetModel(np.zeros(6), TrainingMotion(np.full(6, 1e-3), model.lower, model.upper, rows=30))
        for name, model in session.station.models.items()
    }
    return Prepared(0, session, models)


def faulty(variant, transfers, blocks, robot, camera, planner):
    """Return a peg transfer with these blocks, whose method `best` gets these devices and this planner."""

    def made(context):
        cameras = {name: camera(device) for name, device in context.cell.cameras.items()}
        cell = replace(context.cell, robot=robot(context.cell.robot), cameras=cameras)
        return Watched(agent_of(replace(context, cell=cell, planner=planner or context.planner)), context.cell)

    class Faulty(PegTransfer):
        methods = {"best": replace(BEST, agent=made)}  # noqa: RUF012

        def scene(self, rng, station):
            return scene_of(*blocks)

    return Faulty(variant, transfers, budget_s=60.0)


@pytest.fixture
def kept(tmp_path):
    """Return what plays a trial with faults, keeps it, and reads it back."""

    def play(variant, transfers=2, *, blocks=None, robot=Wrapped, camera=Wrapped, planner=None, fine=False):
        blocks = [block_on(peg) for peg in PEGS] if blocks is None else blocks
        task = faulty(variant, transfers, blocks, robot, camera, planner)
        config = RunConfig(task, method="best", model="offset", calibration="joints", flawless_camera=True)
        station = config.laboratory if fine else coarse(config.laboratory)
        return Trial.load(run_trial(config, without_cables(station), 0).save(tmp_path / "trial.npz"))

    return play


def named(trial, name):
    return [event for event in trial.events if event["name"] == name]


def scored(trial):
    return [score["failure"] or DONE for score in trial.scores]


def noted(trial):
    outcomes = {(event["source"], event["target"]): event["outcome"] for event in named(trial, "transfer")}
    return [outcomes[score["source"], score["target"]] for score in trial.scores]


def came_to_an_end(trial):
    """Return whether the script ended by itself, in time, and the arms held still from then on."""
    (end,) = named(trial, "script ended")
    after = trial.times_s > end["time_s"]
    still = [np.ptp(trial.arrays[f"commanded_{arm}"][after, :6], axis=0).max() == 0.0 for arm in trial.arms]
    return trial.ended == "done" and end["moving"] == [] and after.sum() > 10 and all(still)


def ended_with(trial, outcomes):
    """Assert that the script ended by itself, and noted these outcomes, which the referee gives as well."""
    assert came_to_an_end(trial)
    assert noted(trial) == scored(trial) == outcomes


def at_home(trial, arm):
    told = trial.arrays[f"commanded_{arm}"][:, :6]
    return bool(np.abs(told[-1] - told[0]).max() < 1e-5)


def moved_m(trial, block):
    """Return how far a block came from where it lay."""
    place = trial.arrays[f"body_block{block}"][:, :3]
    return float(np.linalg.norm(place[-1] - place[0]))


# A camera that returns an empty frame.


@pytest.mark.parametrize("variant", ["unilateral", "handover"])
def test_where_frames_are_empty_one_looks_again(kept, variant):
    """The first look at a block, then those at the next one from the moving arm."""
    trial = kept(variant, camera=dark(1, 3, 4, 5))
    ended_with(trial, [DONE, DONE])
    assert named(trial, "no grasp")


@pytest.mark.parametrize(
    ("variant", "outcomes", "frame"),
    [("unilateral", [DONE, NO_BLOCK], 2), ("bilateral", [DONE, DONE, NO_BLOCK, NO_BLOCK], 3)],
)
def test_a_camera_that_goes_dark_shows_no_more_blocks(kept, variant, outcomes, frame):
    trial = kept(variant, len(outcomes), camera=dark(frame, onwards=True))
    ended_with(trial, outcomes)
    assert all(at_home(trial, arm) for arm in trial.arms)


def test_a_block_whose_taking_nobody_can_see_is_put_back(kept):
    trial = kept("handover", 1, camera=dark(2, onwards=True))
    assert came_to_an_end(trial)
    assert noted(trial) == scored(trial) == [NO_BLOCK], "it was seen once, and not at the second try"
    assert named(trial, "offer") and moved_m(trial, block=1) < 3e-3


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_camera_that_is_dark_from_the_start_ends_it_all(kept, variant):
    trial = kept(variant, camera=dark(0, onwards=True))
    assert came_to_an_end(trial) and named(trial, "transfer") == []
    assert scored(trial) == [BOARD_NOT_FOUND] * 2
    assert all(at_home(trial, arm) for arm in trial.arms)


# Blocks that are not there, and blocks on blocks.


def test_a_block_that_is_not_there_is_passed_over(kept):
    """By one arm alone: test_unilateral.py."""
    missing = GOALS["bilateral"][0].source
    trial = kept("bilateral", blocks=[block_on(peg) for peg in PEGS if peg != missing])
    ended_with(trial, [NO_BLOCK, DONE])
    assert not trial.scores[0]["available"]


@pytest.mark.parametrize("variant", ["unilateral", "handover"])
def test_two_blocks_on_one_peg_are_left_alone(kept, variant):
    """The upper one hides the lower one, and is not where a block would be."""
    peg = GOALS[variant][0].source
    trial = kept(variant, blocks=[*map(block_on, PEGS), block_on(peg, Block().height_m)])
    ended_with(trial, [NO_BLOCK, DONE])
    assert max(moved_m(trial, peg), moved_m(trial, len(PEGS))) < 1.5e-3
    assert trial.collisions == []


@pytest.mark.slow
def test_a_lower_block_that_is_seen_past_the_upper_one_is_not_grasped(kept):
    """The two are turned against each other: between the corners of one, those of the other show."""
    upper = standing(0, (0.5e-3, 0.3e-3), 0.3 + np.radians(60.0), Block().height_m)
    trial = kept("bilateral", blocks=[*map(block_on, PEGS), upper], fine=True)
    # what the jaws come down on is shifted: a second look finds no block on the peg, or an edge is held, and lost
    assert noted(trial)[0] in (NOT_GRASPED, NO_BLOCK, DROPPED)
    ended_with(trial, [noted(trial)[0], DONE])


@pytest.mark.parametrize(("variant", "transfers"), [("unilateral", 1), ("bilateral", 2)])
def test_a_block_does_not_go_on_a_peg_that_is_taken(kept, variant, transfers):
    goal = GOALS[variant][0]
    trial = kept(variant, transfers, blocks=[*map(block_on, PEGS), block_on(goal.target)])
    ended_with(trial, [DROPPED, DONE][:transfers])
    assert moved_m(trial, len(PEGS)) < 1e-3, "what stands there stays"


# Jaws.


@pytest.mark.parametrize(
    ("variant", "arm", "outcomes"), [("bilateral", "psm2", [NOT_GRASPED, DONE]), ("handover", "psm2", [NOT_GRASPED])]
)
def test_jaws_that_do_not_close_grasp_nothing(kept, variant, arm, outcomes):
    trial = kept(variant, len(outcomes), robot=stuck(arm))
    ended_with(trial, outcomes)
    left = [score["source"] for score in trial.scores if not score["succeeded"]]
    assert max(moved_m(trial, block) for block in left) < 3e-3, "it stands where it stood, or was put back there"


@pytest.mark.parametrize(("variant", "arm"), [("unilateral", "psm1"), ("bilateral", "psm2")])
def test_jaws_that_do_not_close_once_try_again(kept, variant, arm):
    trial = kept(variant, robot=stuck(arm, closings=1))
    ended_with(trial, [DONE, DONE])
    assert len(named(trial, "pick failed")) == 1


@pytest.mark.parametrize(("variant", "arm", "share"), [("unilateral", "psm1", 1 / 3), ("handover", "psm2", 2 / 3)])
def test_a_block_lost_on_its_way_is_noticed_and_the_next_one_is_moved(kept, variant, arm, share):
    trial = kept(variant, robot=clumsy(arm, share))
    ended_with(trial, [DROPPED, DONE])


def test_a_block_lost_after_the_handover_is_noticed_and_both_arms_go_on(kept):
    """It lies in the middle of the board then, where the next one may hit it."""
    trial = kept("handover", robot=clumsy("psm1", 0.0), fine=True)
    assert came_to_an_end(trial) and noted(trial)[0] == scored(trial)[0] == DROPPED
    assert len(named(trial, "transfer")) == len(named(trial, "offer")) == 2


def test_a_block_that_falls_back_on_its_peg_is_handed_over_after_all(kept):
    trial = kept("handover", robot=clumsy("psm2", 1 / 4))
    ended_with(trial, [DONE, DONE])
    assert len(named(trial, "offer")) == 3


def test_a_block_that_slips_back_on_its_peg_is_picked_again(kept):
    trial = kept("unilateral", robot=clumsy("psm1", 0.0))
    ended_with(trial, [DONE, DONE])
    assert sum(span.name == "jaw" for span in trial.spans) == 7, "the jaws closed and opened once more"


# Planners.


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_planner_that_finds_nothing_leaves_all_blocks_where_they_are(kept, variant):
    trial = kept(variant, planner=no_way())
    ended_with(trial, [OUT_OF_REACH, OUT_OF_REACH])
    assert {e["reason"] for e in named(trial, "no motion")} == {"planner 'plan' found no motion: " + NOTHING}
    assert max(moved_m(trial, block) for block in PEGS) < 1e-4


@pytest.mark.parametrize(("variant", "call"), [("unilateral", 1), ("bilateral", 2)])
def test_a_motion_that_was_not_found_ahead_is_planned_when_it_is_due(kept, variant, call):
    """The call is the first one that is made while the arm moves: how to carry the block, or to offer it."""
    trial = kept(variant, planner=no_way(call))
    ended_with(trial, [DONE, DONE])
    (event,) = named(trial, "no motion")
    motions = [span for span in trial.spans if span.name == "motion" and span.arm == event["arm"]]
    assert any(span.start_s <= event["time_s"] < span.end_s for span in motions)


# Arms.


def test_an_arm_alone_that_stops_answering_ends_its_transfers(kept):
    trial = kept("unilateral", robot=silent("psm1", 5, MIDWAY))
    assert came_to_an_end(trial)
    assert scored(trial) == [ARM_STOPPED, ARM_STOPPED]
    assert trial.scores[0]["reason"] == "psm1 is silent" and not at_home(trial, "psm1")


@pytest.mark.parametrize(
    ("arm", "other", "outcomes"), [("psm2", "psm1", [ARM_STOPPED, DONE]), ("psm1", "psm2", [DONE, ARM_STOPPED])]
)
def test_an_arm_that_stops_answering_does_not_keep_the_other_from_its_work(kept, arm, other, outcomes):
    trial = kept("bilateral", robot=silent(arm, 4, MIDWAY))
    ended_with(trial, outcomes)
    assert at_home(trial, other) and not at_home(trial, arm)


@pytest.mark.slow
def test_an_arm_whose_way_leads_past_one_that_stopped_gives_up_and_goes_home(kept):
    """That one has closed its jaws on its block, and stays there."""
    trial = kept("bilateral", robot=silent("psm1", 5))
    ended_with(trial, [BLOCKED, ARM_STOPPED])
    assert at_home(trial, "psm2") and not at_home(trial, "psm1")


@pytest.mark.parametrize("arm", ["psm1", "psm2"])
def test_an_arm_of_a_handover_that_stops_answering_ends_all_transfers(kept, arm):
    trial = kept("handover", robot=silent(arm, 5, MIDWAY))
    ended_with(trial, [ARM_STOPPED, ARM_STOPPED])
    assert trial.scores[0]["reason"] == f"{arm} is silent"


@pytest.mark.parametrize(("variant", "arm", "motion"), [("unilateral", "psm1", 8), ("bilateral", "psm1", 6)])
def test_an_arm_that_stops_on_its_way_home_has_done_its_transfers(kept, variant, arm, motion):
    trial = kept(variant, robot=silent(arm, motion, MIDWAY))
    assert came_to_an_end(trial) and not at_home(trial, arm)
    assert noted(trial) == scored(trial) == [DONE, DONE]
    assert [event["arm"] for event in named(trial, "stayed")] == [arm]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_controller_that_is_cut_off_brings_all_arms_to_rest(kept, variant):
    trial = kept(variant, robot=cut_off("psm1", 5))
    assert (trial.ended, trial.reason) == ("FAULT", "the controller does not answer")
    assert scored(trial) == ["FAULT", "FAULT"]
    for arm, model in STATION.arms.items():
        last = np.diff(trial.arrays[f"commanded_{arm}"][-2:, :6], axis=0)
        assert (np.abs(last) < model.limits.acceleration * TICK_S**2).all(), "no more than braking ends with"
    assert not at_home(trial, "psm1")
