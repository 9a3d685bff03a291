"""The wrappers, on an arm that is nothing but cables."""

from types import SimpleNamespace

import numpy as np
import pytest
import trio

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.calibration.compensation import Compensator
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PLANTS
from trocar.calibration.recording import Recording
from trocar.cell import Execution, JointReading
from trocar.errors import TrocarError
from trocar.motion import rest_to_rest
from trocar.motion.limits import limit_use
from trocar.robots import Calibrated, Guarded, Recorded
from trocar.trajectory import Trajectory

ARM = ARMS["psm-classic"]
ARMS_OF_THE_CELL = {"psm1": ARM}
PAPER = MOTION_LIMITS["paper"]
PLANT = PLANTS["psm1_grey"]
HOME = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2])
GOALS = np.array(
    [
        [0.80, 0.10, 0.19, 0.40, 0.30, 0.30],
        [0.90, -0.10, 0.17, -0.90, -0.50, -0.60],
        [0.75, 0.05, 0.20, -0.20, 0.40, -0.90],
        [0.85, 0.00, 0.18, -0.30, -0.10, 0.20],
    ]
)
STEP_S = 0.002


class CableArm:
    """A robot without bodies: the joints follow the commands through a cable plant."""

    def __init__(self, q_cmd, slack=(0.0, 0.0, 0.0)):
        self.q_cmd, self.jaw_rad, self.held = np.array(q_cmd), 0.0, []
        self.state = tuple(np.array(PLANT.start(self.q_cmd)) + slack)
        self.moves: list[Trajectory] = []
        self.joints = [PLANT.step(self.state, self.q_cmd)[0]]

    def read(self, arm):
        assert arm == "psm1"
        return JointReading(0.0, self.q_cmd.copy(), self.jaw_rad)

    async def move(self, arm, trajectory):
        assert np.abs(trajectory(trajectory.times_s[0]) - self.q_cmd).max() < 1e-3, "a jump"
        self.moves.append(trajectory)
        times, commands = trajectory.sample(STEP_S)
        self.joints = []
        for q in commands:
            joints, self.state = PLANT.step(self.state, q)
            self.joints.append(joints)
        self.q_cmd = commands[-1].copy()
        rows = np.column_stack([commands, np.full(len(commands), self.jaw_rad)])
        return Execution(times, rows, rows)

    async def jaw(self, arm, angle_rad):
        self.jaw_rad = angle_rad
        return Execution(np.zeros(1), np.zeros((1, 7)), np.zeros((1, 7)))

    def hold(self, arm):
        self.held.append(arm)


@pytest.fixture(scope="module")
def recording():
    q = random_smooth_path(ARM, np.random.default_rng(0))
    return Recording(q, PLANT.run(q), np.ones(len(q), bool), np.arange(1, len(q) + 1) * 0.8, "of the plant")


@pytest.fixture(scope="module")
def models(recording):
    return {name: MODELS[name].fit(recording, np.random.default_rng(0)) for name in ("play", "ridge", "offset")}


def after_each_move(robot, arm, goals=GOALS):
    """Move to the goals one after the other; return how far the wrist's joints ended from each, rad (n, 3)."""
    missed = []

    async def script():
        at = robot.read("psm1").q
        for goal in goals:
            await robot.move("psm1", rest_to_rest(at, goal, PAPER))
            at = robot.read("psm1").q
            assert np.abs(at - goal).max() < 1e-12
            missed.append(arm.joints[-1][3:] - goal[3:])

    trio.run(script)
    return np.array(missed)


def calibrated(model, **kwargs):
    arm = CableArm(HOME, **kwargs)
    return Calibrated(arm, ARMS_OF_THE_CELL, {"psm1": Compensator(model)}), arm


def test_without_compensation_the_joints_miss_by_a_tenth_of_a_radian():
    arm = CableArm(HOME)
    assert np.abs(after_each_move(arm, arm)).max(axis=0).min() > 0.1


def test_with_the_play_model_they_arrive_motion_after_motion(models):
    robot, arm = calibrated(models["play"])
    missed = after_each_move(robot, arm, np.concatenate([GOALS, GOALS[::-1], GOALS]))
    assert np.abs(missed).max() < 5e-3


def test_the_memory_recovers_from_an_unknown_slack_at_the_start(models):
    robot, arm = calibrated(models["play"], slack=PLANT.radii)
    missed = np.abs(after_each_move(robot, arm, np.concatenate([GOALS, GOALS])))
    assert missed[-4:].max() < 5e-3


@pytest.mark.parametrize(("name", "share"), [("ridge", 0.5), ("offset", 0.7)])
def test_lesser_models_help_less_but_help(models, name, share):
    robot, arm = calibrated(models[name])
    bare = CableArm(HOME)
    helped, unhelped = after_each_move(robot, arm), after_each_move(bare, bare)
    assert np.sqrt(np.mean(helped**2)) < share * np.sqrt(np.mean(unhelped**2))


def test_the_joints_follow_the_path_and_not_only_its_end(models):
    robot, arm = calibrated(models["play"])
    after_each_move(robot, arm, GOALS[:3])
    motion = rest_to_rest(GOALS[2], GOALS[3], PAPER)
    trio.run(robot.move, "psm1", motion)
    command, joints = arm.moves[-1], np.array(arm.joints)
    wanted = motion(command.sample(STEP_S)[0] * motion.duration_s / command.duration_s)
    half = len(wanted) // 2
    assert np.abs((joints - wanted)[half:, 3:]).max() < 0.03
    assert np.sqrt(np.mean((joints - wanted)[half:, 3:] ** 2)) < 0.01


def test_reading_tells_the_joints_that_the_model_believes_in(models):
    robot, arm = calibrated(models["play"])
    assert np.abs(robot.read("psm1").q - arm.joints[-1]).max() < 5e-3
    assert np.abs(robot.read("psm1").q - HOME).max() > 0.1


def test_corrected_commands_take_as_long_begin_where_the_arm_is_and_stay_in_range(models):
    robot, arm = calibrated(models["play"])
    near_the_end = GOALS[0].copy()
    near_the_end[4] = ARM.upper[4] - 0.01
    near_the_end[5] = ARM.lower[5] + 0.01
    after_each_move(robot, arm, [GOALS[0], near_the_end, GOALS[1]])
    for command in arm.moves:
        times = np.linspace(command.times_s[0], command.times_s[-1], 2000)
        q = command(times)
        assert (q >= ARM.lower).all() and (q <= ARM.upper).all()
    durations = [rest_to_rest(a, b, PAPER).duration_s for a, b in ((GOALS[0], near_the_end), (near_the_end, GOALS[1]))]
    assert [m.duration_s for m in arm.moves[1:]] == pytest.approx(durations, rel=1e-6)


class HalfWay(CableArm):
    """An arm that is stopped in the middle of a motion: held, or by a fault."""

    fault = False

    async def move(self, arm, trajectory):
        times, commands = trajectory.sample(STEP_S)
        half = len(times) // 2
        await super().move(arm, Trajectory.hermite(times[:half], commands[:half], np.zeros((half, 6))))
        if self.fault:
            raise ConnectionError


@pytest.mark.parametrize("fault", [False, True], ids=["held", "fault"])
def test_after_a_stop_the_wrapper_knows_where_the_arm_is(models, fault):
    arm = HalfWay(HOME)
    robot = Calibrated(arm, ARMS_OF_THE_CELL, {"psm1": Compensator(models["play"])})
    arm.fault = fault
    motion = rest_to_rest(robot.read("psm1").q, GOALS[1], PAPER)
    if fault:
        with pytest.raises(ConnectionError):
            trio.run(robot.move, "psm1", motion)
    else:
        trio.run(robot.move, "psm1", motion)
        robot.hold("psm1")
    widest = np.abs(PLANT.C) @ PLANT.radii
    off = np.abs(robot.read("psm1").q - arm.joints[-1])
    assert off[:3].max() < 1e-3
    assert (off[3:] < widest + 0.01).all()
    assert np.abs(robot.read("psm1").q - GOALS[1]).max() > 0.2


def test_the_other_verbs_pass_through(models):
    robot, arm = calibrated(models["offset"])
    for wrapped in (robot, Guarded(arm, ARMS_OF_THE_CELL, {"psm1": PAPER}), Recorded(arm)):
        trio.run(wrapped.jaw, "psm1", 0.3)
        assert arm.jaw_rad == wrapped.read("psm1").jaw_rad == 0.3
        arm.jaw_rad, arm.held = 0.0, []
        wrapped.hold("psm1")
        assert arm.held == ["psm1"]


def test_an_arm_without_a_model_moves_as_it_is_told():
    arm = CableArm(HOME)
    robot = Calibrated(arm, ARMS_OF_THE_CELL, {})
    motion = rest_to_rest(HOME, GOALS[0], PAPER)
    trio.run(robot.move, "psm1", motion)
    assert arm.moves == [motion]


def guarded():
    arm = CableArm(HOME)
    return Guarded(arm, ARMS_OF_THE_CELL, {"psm1": PAPER}), arm


def test_the_guard_refuses_what_leaves_a_joints_range_and_nothing_moves():
    robot, arm = guarded()
    beyond = HOME.copy()
    beyond[2] = ARM.upper[2] + 0.002
    with pytest.raises(TrocarError, match=r"insertion.*0\.0020 m"):
        trio.run(robot.move, "psm1", rest_to_rest(HOME, beyond, PAPER))
    assert arm.moves == [] and np.array_equal(arm.q_cmd, HOME)


def test_the_guard_sees_what_happens_between_the_knots():
    robot, arm = guarded()
    fast = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    bulging = Trajectory.hermite([0.0, 0.2], [HOME, HOME], [fast, -fast])
    with pytest.raises(TrocarError, match="insertion"):
        trio.run(robot.move, "psm1", bulging)
    assert arm.moves == []


@pytest.mark.parametrize("times_too_fast", [1.7, 4.0])
def test_the_guard_slows_down_what_is_too_fast_along_the_same_path(times_too_fast):
    robot, arm = guarded()
    wanted = rest_to_rest(HOME, GOALS[0], PAPER)
    rushed = wanted.stretched(limit_use(ARM, wanted, PAPER).velocity_ratio / times_too_fast)
    trio.run(robot.move, "psm1", rushed)
    (sent,) = arm.moves
    assert limit_use(ARM, sent, PAPER).velocity_ratio <= 1.0 + 1e-6
    assert sent.duration_s == pytest.approx(rushed.duration_s * times_too_fast, rel=1e-3)
    share = np.linspace(0, 1, 50)
    assert np.allclose(sent(share * sent.duration_s), rushed(share * rushed.duration_s), atol=1e-9)


def test_the_guard_leaves_a_motion_within_its_limits_alone():
    robot, arm = guarded()
    motion = rest_to_rest(HOME, GOALS[0], PAPER)
    trio.run(robot.move, "psm1", motion)
    assert arm.moves[0].duration_s == pytest.approx(motion.duration_s, rel=1e-9)


def test_the_guard_names_the_arms_that_it_knows():
    robot, _ = guarded()
    with pytest.raises(TrocarError, match=r"'psm7'.*psm1"):
        trio.run(robot.move, "psm7", rest_to_rest(HOME, GOALS[0], PAPER))


def test_the_guard_sees_the_corrected_command(models):
    arm = CableArm(HOME)
    seen = []
    inner = SimpleNamespace(read=arm.read, move=lambda name, t: seen.append(t) or arm.move(name, t))
    robot = Calibrated(
        Guarded(inner, ARMS_OF_THE_CELL, {"psm1": PAPER}), ARMS_OF_THE_CELL, {"psm1": Compensator(models["play"])}
    )
    start = robot.read("psm1").q
    trio.run(robot.move, "psm1", rest_to_rest(start, GOALS[0], PAPER))
    assert limit_use(ARM, seen[0], PAPER).velocity_ratio <= 1.0 + 1e-6


def test_recorded_keeps_everything_in_order():
    arm = CableArm(HOME)
    robot = Recorded(arm)

    async def script():
        first = await robot.move("psm1", rest_to_rest(HOME, GOALS[0], PAPER))
        second = await robot.jaw("psm1", 0.4)
        third = await robot.move("psm1", rest_to_rest(GOALS[0], GOALS[1], PAPER))
        return [first, second, third]

    executions = trio.run(script)
    assert [name for name, _ in robot.executions] == ["psm1"] * 3
    assert all(kept is made for (_, kept), made in zip(robot.executions, executions, strict=True))


def test_recorded_keeps_what_was_asked_for_at_the_times_at_which_it_was_done():
    robot = Recorded(CableArm(HOME))
    motion = rest_to_rest(HOME, GOALS[0], PAPER)
    execution = trio.run(robot.move, "psm1", motion)
    ((name, times, q),) = robot.asked
    assert name == "psm1" and times is execution.times_s
    np.testing.assert_allclose(q[-1], GOALS[0], atol=1e-12)
    np.testing.assert_allclose(q, execution.commanded[:, :6], atol=STEP_S * PAPER.velocity.max())


@pytest.mark.parametrize("stops", [True, False])
def test_a_correction_beyond_a_range_is_refused_only_where_it_is_to_stop(models, stops):
    arm = CableArm(HOME)
    robot = Calibrated(arm, ARMS_OF_THE_CELL, {"psm1": Compensator(models["play"])}, stop_at_limits=stops)
    beyond = GOALS[0].copy()
    beyond[4] = ARM.upper[4] - 0.01  # these cables ask for .1 rad more
    motion = rest_to_rest(robot.read("psm1").q, beyond, PAPER)
    if not stops:
        trio.run(robot.move, "psm1", motion)
        return
    with pytest.raises(TrocarError, match=r"joint 'wrist_pitch' would need the command 8\d\.\d deg .* outside \[-80.0"):
        trio.run(robot.move, "psm1", motion)
    assert arm.moves == []
    inside = rest_to_rest(robot.read("psm1").q, GOALS[0], PAPER)
    trio.run(robot.move, "psm1", inside)  # and it knows where it is
    assert len(arm.moves) == 1
