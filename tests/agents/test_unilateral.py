"""What the script of one arm does when things go well, and when they do not."""

from dataclasses import replace

import numpy as np
import pytest
import trio

from simulated import ideal_session, scene_of, standing
from trocar.agents import Settings, Unilateral
from trocar.cell import Cell, Outcome
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.sim.cell import SimulatedCell
from trocar.sim.robot import TICK_S
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.tasks import PegTransfer
from trocar.tasks.peg_transfer import on_peg
from trocar.trials import TrialLog

FIRST, SECOND = PegTransfer().transfers[:2]
SETTINGS = Settings()


class Wrapped:
    """A device that does what another does, but for what a subclass changes."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


class StuckJaws(Wrapped):
    """The jaws never close."""

    async def jaw(self, arm, angle_rad):
        return await self.inner.jaw(arm, max(angle_rad, SETTINGS.jaw_open))


class Butterfingers(Wrapped):
    """The first block that is lifted is lost on its way."""

    lost = False
    closed = False

    async def jaw(self, arm, angle_rad):
        self.closed = angle_rad < 0
        return await self.inner.jaw(arm, angle_rad)

    async def move(self, arm, trajectory):
        if not self.closed or self.lost:
            return await self.inner.move(arm, trajectory)
        self.lost = True
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._lose, arm, trajectory.duration_s / 3)
            return await self.inner.move(arm, trajectory)

    async def _lose(self, arm, after_s):
        await trio.sleep(after_s)
        await self.inner.jaw(arm, 0.6)
        await self.inner.jaw(arm, SETTINGS.jaw_closed)


class Fault(Wrapped):
    """The controller of the arm gives up on its fifth motion."""

    moves = 0

    async def move(self, arm, trajectory):
        self.moves += 1
        if self.moves == 5:
            raise ConnectionError("the controller does not answer")
        return await self.inner.move(arm, trajectory)


class Dark(Wrapped):
    """The camera sees nothing."""

    async def capture(self):
        image = await self.inner.capture()
        return RgbdImage(np.zeros_like(image.color), np.full_like(image.depth_m, np.nan), image.intrinsics, 0.0)


def play(transfers, blocks=None, robot=Wrapped, camera=Wrapped, settings=SETTINGS, budget_s=60.0):
    """Let the agent do transfers in an ideal cell; return the cell, the log and the task's scores."""
    scene = scene_of(*(blocks or [standing(peg, (0.5e-3, 0.3e-3), 0.3 + peg) for peg in range(6)]))
    simulated = SimulatedCell(ideal_session(), scene, np.random.default_rng(0), SensorFlaws.none())
    log = TrialLog(trio.current_time)
    session = simulated.session
    cell = Cell(
        robot(simulated.robot),
        camera(simulated.camera),
        session.arms,
        session.T_world_base_found,
        simulated.T_world_camera,
        SE3.identity(),
        log,
    )
    agent = Unilateral(cell, settings)
    log.finished = simulated.run(lambda: agent.run(transfers), budget_s)
    return simulated, log, PegTransfer().score(log.events, simulated.referee.truth())


def named(log, name):
    return [event for event in log.events if event["name"] == name]


@pytest.fixture(scope="module")
def clean():
    return play([(10, 4), FIRST])


def test_a_transfer_ends_with_the_block_on_its_target(clean):
    simulated, log, (_, score) = clean
    assert log.finished
    assert score.attempted and score.succeeded
    assert named(log, "transfer")[1]["outcome"] == Outcome.DONE.name
    assert simulated.referee.truth().collisions == ()


def test_an_empty_peg_is_said_so_and_the_script_goes_on(clean):
    _, log, (empty, _) = clean
    assert named(log, "transfer")[0]["outcome"] == Outcome.NO_BLOCK.name
    assert not empty.attempted
    assert all("peg" in event and event["reason"] for event in named(log, "no grasp"))


def test_every_part_is_noted_and_computing_takes_its_declared_time(clean):
    _, log, (_, score) = clean
    spans = [span for span in log.spans if score.start_s <= span.start_s and span.end_s <= score.end_s]
    assert {span.name for span in spans} == {"capture", "perception", "planning", "motion", "jaw", "settling"}
    lasts = {span.name: span.end_s - span.start_s for span in spans}
    assert 0 <= lasts["perception"] - SETTINGS.perception_budget_s < TICK_S
    assert 0 <= lasts["planning"] - SETTINGS.planning_budget_s < TICK_S
    assert lasts["capture"] > 0.1
    assert all(computation.seconds > 0 for computation in log.computations)


def test_the_arm_leaves_the_board_at_the_end(clean):
    simulated, log, _ = clean
    start = SimulatedCell(ideal_session(), scene_of(standing(0)), np.random.default_rng(0)).robot.read("psm1").q
    assert np.abs(simulated.robot.read("psm1").q - start).max() < 1e-6
    assert [span.name for span in log.spans[-2:]] == ["capture", "perception"]


def test_a_last_look_says_which_blocks_lie_where_they_were_set_down(clean):
    simulated, log, (_, score) = clean
    (check,) = named(log, "check")
    assert score.target in check["pegs"] and not check["missing"]
    assert on_peg(simulated.referee.truth().T_board_blocks[-1], score.target) is not None


def test_a_pick_that_fails_is_tried_again_with_another_grasp_and_then_given_up():
    simulated, log, (score,) = play([FIRST], robot=StuckJaws)
    assert len(named(log, "pick failed")) == 1 + SETTINGS.retries
    assert named(log, "transfer")[0]["outcome"] == Outcome.NOT_GRASPED.name
    assert score.attempted and score.failure == "NOT_GRASPED"
    tip_m = simulated.referee.truth().p_board_tips["psm1"]
    low = tip_m[tip_m[:, 2] < 0.013]
    assert np.ptp(low, axis=0)[:2].max() > 1e-3


def test_a_block_lost_on_the_way_is_noticed_and_the_next_is_moved():
    _, log, (lost, following) = play([FIRST, SECOND], robot=Butterfingers)
    assert named(log, "transfer")[0]["outcome"] == Outcome.DROPPED.name
    assert lost.attempted and lost.failure == "DROPPED"
    assert following.succeeded, following.failure


def test_a_blind_camera_ends_the_trial_with_a_sentence():
    with pytest.raises(TrocarError, match="board was not found"):
        play([FIRST], camera=Dark)


def test_a_fault_of_the_robot_ends_the_trial_and_is_named():
    with pytest.raises(ConnectionError, match="does not answer"):
        play([FIRST], robot=Fault)


def test_a_spent_budget_ends_the_script_where_it_is():
    simulated, log, scores = play([FIRST, SECOND], budget_s=4.0)
    assert not log.finished
    assert simulated.referee.truth().times_s[-1] == pytest.approx(4.0, abs=0.06)
    assert scores == []


def test_an_arm_that_is_not_there_is_named():
    with pytest.raises(TrocarError, match=r"'psm3'.*psm1, psm2"):
        play([FIRST], settings=Settings(arm="psm3"))


def test_a_way_that_leaves_the_joints_ranges_is_an_outcome_and_not_the_end():
    _, log, (score, _) = play([FIRST, SECOND], settings=replace(SETTINGS, lift=0.5))
    assert [event["outcome"] for event in named(log, "transfer")] == [Outcome.OUT_OF_REACH.name] * 2
    assert named(log, "no motion")[0]["reason"]
    assert score.attempted and score.failure == "OUT_OF_REACH"
    assert log.finished
