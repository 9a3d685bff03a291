"""What the innermost wrapper passes on, changes, and refuses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trio

from driven import ARM, GOAL, HOME, PAPER, PlainArms, running
from trocar.arms import MotionLimits, capsules, fk, ik
from trocar.cell import MotionEnd
from trocar.errors import InvalidInput, OutOfReach, TooNear, TrocarError
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.lab import load_station
from trocar.motion import rest_to_rest, swept_clearance
from trocar.robots import ArmGuard, Guarded
from trocar.trajectory import Trajectory


def guarded(names=("a",), homes=None, bases=None, **kwargs):
    arms = PlainArms(names, homes)
    notes = []
    workspace = kwargs.pop("workspace_m", None)
    bases = bases or {}
    guards = {name: ArmGuard(ARM, PAPER, bases.get(name, SE3.identity()), workspace) for name in names}
    arms.robot = Guarded(arms.driver, guards, note=lambda name, **values: notes.append((name, values)), **kwargs)
    arms.each_tick.append(arms.robot.check)
    return arms, notes


def refused(arms, motions, match):
    """The robot says no in a sentence, and nothing moves; or, if there is nothing to match, it moves."""
    if match is None:
        assert all(end.done for end in arms.run(lambda: arms.robot.move(motions)).values())
        return

    async def script():
        with pytest.raises(TrocarError, match=match):
            await arms.robot.move(motions)
        await trio.sleep(0.1)

    arms.run(script)
    for rows in arms.sent.values():
        assert np.ptp(np.array(rows), axis=0).max() == 0.0


def test_what_keeps_the_limits_goes_through_as_it_is():
    arms, notes = guarded()
    motion = rest_to_rest(HOME, GOAL, PAPER)
    execution = arms.run(lambda: arms.robot.move({"a": motion}))["a"]
    assert execution.ended is MotionEnd.DONE
    assert notes == []
    times = execution.times_s - execution.times_s[0] + 0.01
    assert np.abs(execution.commanded[:, :6] - motion(times)).max() < 1e-9


@pytest.mark.parametrize("factor", [1.5, 7.0])
def test_what_is_too_fast_is_slowed_down_and_that_is_noted(factor):
    arms, notes = guarded()
    quick = rest_to_rest(HOME, GOAL, MotionLimits(50 * PAPER.velocity, factor * PAPER.acceleration))
    arms.run(lambda: arms.robot.move({"a": quick}))
    assert max(arms.use("a")) <= 1.0 + 1e-6
    ((name, values),) = notes
    assert name == "guard" and values["arm"] == "a"
    assert values["stretch"] == pytest.approx(np.sqrt(factor), rel=1e-3)
    assert np.abs(arms.robot.setpoint("a").q - GOAL).max() < 1e-9


def test_two_arms_of_one_motion_are_slowed_down_alike():
    """Else what was free of collisions as it was planned would not be so as it is driven."""
    arms, _ = guarded(("a", "b"))
    slow = rest_to_rest(HOME, GOAL, PAPER)
    quick = slow.stretched(0.5)
    longer = rest_to_rest(HOME, GOAL, PAPER).stretched(2.0)
    executions = arms.run(lambda: arms.robot.move({"a": quick, "b": longer}))
    assert len(executions["b"].times_s) == pytest.approx(4 * len(executions["a"].times_s), abs=5)
    a, b = (executions[name].commanded[:, :6] for name in "ab")
    share = len(b) / len(a)
    for row in range(10, len(a) - 10, 7):
        assert np.abs(a[row] - b[min(len(b) - 1, round((row + 1) * share) - 1)]).max() < 0.02


def test_the_time_along_the_path_is_that_of_the_motion_as_it_was_asked_for():
    arms, _ = guarded()
    quick = rest_to_rest(HOME, GOAL, PAPER).stretched(0.5)

    async def script():
        with trio.move_on_after(0.25):
            await arms.robot.move({"a": quick})
        return arms.robot.setpoint("a")

    at = arms.run(script)
    assert at.path_s < 0.25
    assert np.abs(at.q - quick(at.path_s)).max() < 1e-9

    async def again():
        async with running(arms.robot.move, {"a": rest_to_rest(at.q, HOME, PAPER).stretched(0.5)}):
            await trio.sleep(0.1)
            now = arms.robot.setpoint("a")
            assert now.path_rate == pytest.approx(0.5, rel=1e-3), "half as fast as it was asked for"
            assert now.path_s == pytest.approx(0.05, abs=0.006)

    arms.run(again)


PITCH = np.eye(6)[4]


def kicked(velocity):
    """A motion that starts with this velocity from rest."""
    return Trajectory.hermite([0.0, 0.5], [HOME, HOME + 0.25 * np.array(velocity)], [velocity, np.zeros(6)])


@pytest.mark.parametrize(
    ("motion", "match"),
    [
        (rest_to_rest(HOME, HOME + (ARM.upper[4] + 0.05 - HOME[4]) * PITCH, PAPER), "wrist_pitch.*out of its range"),
        (rest_to_rest(HOME + 0.7e-6 * PITCH, GOAL, PAPER), None),  # rounding is no leap
        (rest_to_rest(HOME + 1.6e-6 * PITCH, GOAL, PAPER), "starts 0.000002 rad"),
        (kicked(0.9 * 0.01 * PAPER.acceleration * PITCH), None),  # what the limits allow in one tick
        (kicked(1.1 * 0.01 * PAPER.acceleration * PITCH), "jump in the velocity of joint 'wrist_pitch'"),
        (kicked([0.3, 0, 0, 1.0, 0, 0]), "velocity of joint 'yaw'"),  # 5 ticks of its acceleration, 4 of roll's
    ],
)
def test_a_motion_keeps_the_ranges_and_starts_without_a_leap(motion, match):
    refused(guarded()[0], {"a": motion}, match)


@pytest.mark.parametrize(("factor", "noted"), [(1 + 0.6e-6, False), (1 + 1.6e-6, True), (2.0, True)])
def test_a_limit_of_velocity_counts_as_kept_within_rounding(factor, noted):
    arms, notes = guarded()
    end = HOME + np.array([0, 0, 0, 0.5, 0, 0])
    slow = MotionLimits(0.01 * PAPER.velocity, PAPER.acceleration)
    cruise = rest_to_rest(HOME, end, MotionLimits(slow.velocity * factor, PAPER.acceleration))
    arms.robot = Guarded(
        arms.driver, {"a": ArmGuard(ARM, slow)}, note=lambda name, **values: notes.append((name, values))
    )
    sent = arms.robot._allowed({"a": cruise}, replaces=False)["a"]
    assert sent.duration_s == pytest.approx(cruise.duration_s * (factor if noted else 1.0), rel=1e-7)
    assert len(notes) == noted
    if factor == 2.0:
        assert notes[0][1]["stretch"] == pytest.approx(2.0, rel=1e-3)


def test_a_motion_that_takes_over_too_fast_is_refused_and_the_old_one_goes_on():
    arms, _ = guarded()

    async def script():
        async with running(arms.robot.move, {"a": rest_to_rest(HOME, GOAL, PAPER)}) as ends:
            await trio.sleep(0.1)
            at = arms.robot.setpoint("a")
            abrupt = Trajectory.hermite([0.0, 0.004], [at.q, at.q], [at.velocity, np.zeros(6)])
            with pytest.raises(TrocarError, match="takes over from a moving arm"):
                await arms.robot.replace({"a": abrupt})
        return ends[0]["a"]

    assert arms.run(script).ended is MotionEnd.DONE
    assert np.abs(arms.robot.setpoint("a").q - GOAL).max() < 1e-9


def test_jaws_reach_the_ends_of_their_range_and_no_further():
    arms, _ = guarded()

    async def script():
        for angle in (ARM.jaw.upper, ARM.jaw.lower):
            assert (await arms.robot.jaw("a", angle)).done
        for angle, by in ((99.0, 99.0 - ARM.jaw.upper), (-2.0, ARM.jaw.lower + 2.0), (float("nan"), float("nan"))):
            with pytest.raises(OutOfReach, match=r"jaw angle .* is outside \[-0.6981, 1.3963\]") as refused:
                await arms.robot.jaw("a", angle)
            assert refused.value.by == pytest.approx(by, nan_ok=True) and refused.value.arm == "a"

    arms.run(script)


def test_a_tip_that_leaves_its_workspace_is_refused_with_the_place():
    T = SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.0, 0.3])
    tip = (T @ fk(ARM, HOME)).translation_m
    box = np.array([tip - 0.02, tip + 0.02])
    arms, _ = guarded(bases={"a": T}, workspace_m=box)
    refused(arms, {"a": rest_to_rest(HOME, GOAL, PAPER)}, r"takes its tip to [xyz] = .* mm, outside")
    near = HOME + 0.02 * (GOAL - HOME)
    assert arms.run(lambda: arms.robot.move({"a": rest_to_rest(HOME, near, PAPER)}))["a"].done


def test_an_arm_whose_readings_stop_comes_to_rest_as_a_fault():
    arms, notes = guarded(stale_s=0.05)

    async def script():
        async with running(arms.robot.move, {"a": rest_to_rest(HOME, GOAL, PAPER)}) as ends:
            await trio.sleep(0.1)
            arms.silent.add("a")
        return ends[0]["a"]

    execution = arms.run(script)
    assert execution.ended is MotionEnd.FAULT and "has not been read for 0.06 s" in execution.reason
    assert [values["arm"] for _, values in notes] == ["a"], "noted once, while it brakes it is known"
    assert max(arms.use("a")) <= 1.0 + 1e-6
    assert 0.005 < np.abs(arms.robot.setpoint("a").q - HOME).max() < 0.9 * np.abs(GOAL - HOME).max()


def test_unless_told_otherwise_a_reading_is_stale_after_a_tenth_of_a_second():
    arms, _ = guarded()
    arms.silent.add("a")
    execution = arms.run(lambda: arms.robot.move({"a": rest_to_rest(HOME, GOAL, PAPER)}))["a"]
    assert "has not been read for 0.11 s, more than 0.10 s" in execution.reason


def test_motions_with_too_few_joints_and_unknown_arms_are_named():
    arms, _ = guarded()
    short = Trajectory.hermite([0.0, 1.0], [HOME[:5], GOAL[:5]], np.zeros((2, 5)))
    refused(arms, {"a": short}, "has 5 joints; give 6")

    async def script():
        with pytest.raises(TrocarError, match="arm 'z' is unknown; choose one of a"):
            await arms.robot.move({"z": rest_to_rest(HOME, GOAL, PAPER)})

        with pytest.raises(InvalidInput, match="a motion names no arm; give a trajectory"):
            await arms.robot.move({})

    arms.run(script)


def test_any_robot_that_tells_what_it_does_can_be_guarded():
    arms, _ = pair(0.05, -0.05)
    guards = dict.fromkeys("ab", ArmGuard(ARM, PAPER))
    with pytest.raises(InvalidInput, match=r"type object has no braking, fault, .*widest_jaw_rad; a guard needs"):
        Guarded(object(), guards)
    verbs = ["read", "setpoint", "move", "replace", "prepare", "jaw", "hold", "rest"]
    verbs += ["remaining", "braking", "widest_jaw_rad", "fault"]
    arms.robot = Guarded(SimpleNamespace(**{verb: getattr(arms.driver, verb) for verb in verbs}), guards)
    assert arms.run(lambda: arms.robot.move(to("a", 0.05, 0.06)))["a"].done


STATION = load_station("peg-transfer")
BASES = {"a": STATION.arms["psm1"].T_world_base, "b": STATION.arms["psm2"].T_world_base}
"""Two arms that face each other over a table."""


def at(name, x_m, y_m=0.0):
    """Joints with which an arm's tip stands over this place of the table, the tool upright."""
    return ik(ARM, BASES[name].inverse() @ SE3.from_parts(translation_m=[x_m, y_m, 0.05]))


def pair(a_x_m, b_x_m, **kwargs):
    homes = {"a": at("a", a_x_m), "b": at("b", b_x_m)}
    return guarded(("a", "b"), homes=homes, bases=BASES, **{"min_distance_m": 1e-3, **kwargs})


def to(name, x_from_m, x_m):
    return {name: rest_to_rest(at(name, x_from_m), at(name, x_m), PAPER)}


def gap_m(arms):
    solids = [capsules(ARM, arms.robot.setpoint(name).q, 0.1).moved(BASES[name]) for name in "ab"]
    return capsule_distances_m(*solids).min()


def test_two_arms_that_would_meet_are_refused_with_what_meets_where():
    arms, _ = pair(0.05, -0.05)
    refused(arms, to("a", 0.05, -0.05), r"a .* comes within \d\.\d mm of b .* after \d\.\d\d s")


def test_without_a_distance_to_keep_nobody_looks():
    arms, _ = pair(0.05, -0.05, min_distance_m=0.0)
    assert arms.run(lambda: arms.robot.move(to("a", 0.05, 0.0)))["a"].done
    arms, _ = guarded(("a", "b"), homes={"a": at("a", 0.05), "b": at("b", -0.05)}, bases=BASES)
    assert arms.run(lambda: arms.robot.move(to("a", 0.05, -0.05)))["a"].done, "as a rule none is to be kept"
    arms, _ = pair(0.05, -0.05, min_distance_m=0.08)
    refused(arms, to("a", 0.05, 0.03), "80.0 mm are to be kept")


def test_the_faster_of_two_motions_is_named_and_one_that_takes_over_slows_none_down():
    arms, notes = guarded(("a", "b"))
    quick, slow = rest_to_rest(HOME, GOAL, PAPER).stretched(0.5), rest_to_rest(HOME, GOAL, PAPER)

    async def script():
        async with running(arms.robot.move, {"a": slow}):
            await trio.sleep(0.1)
            at = arms.robot.setpoint("a")
            on = Trajectory.hermite([0.0, 1.0], [at.q, at.q + 0.5 * at.velocity], [at.velocity, np.zeros(6)])
            with pytest.raises(TrocarError, match=r"'b' takes over from a moving arm and is 2\.000 times too fast"):
                await arms.robot.replace({"a": on, "b": quick})
        back = {"a": rest_to_rest(GOAL, HOME, PAPER), "b": quick}
        await arms.robot.move(back)

    arms.run(script)
    ((_, values),) = notes
    assert values["arm"] == "b" and values["stretch"] == pytest.approx(2.0, rel=1e-3)


def test_arms_known_to_be_apart_are_still_refused_when_they_would_meet():
    """The guard remembers where both arms were far apart; neither's later motion may make that proof stale."""
    arms, _ = pair(0.05, -0.05)

    async def script():
        assert (await arms.robot.move(to("a", 0.05, 0.045)))["a"].done
        with pytest.raises(TrocarError, match="comes within"):
            await arms.robot.move(to("a", 0.045, -0.05))
        assert (await arms.robot.move(to("b", -0.05, 0.01)))["b"].done
        with pytest.raises(TrocarError, match="comes within"):
            await arms.robot.move(to("a", 0.045, 0.005))
        assert (await arms.robot.move(to("a", 0.045, 0.05)))["a"].done

    arms.run(script)


def test_a_stream_of_short_motions_far_from_the_other_arm_measures_the_distance_once(monkeypatch):
    arms, _ = pair(0.05, -0.05)
    asked = []
    monkeypatch.setattr(
        "trocar.robots.guarded.swept_clearance", lambda *args, **more: asked.append(1) or swept_clearance(*args, **more)
    )

    async def script():
        for k in range(5):
            assert (await arms.robot.move(to("a", 0.05 + 1e-3 * k, 0.05 + 1e-3 * (k + 1))))["a"].done

    arms.run(script)
    assert len(asked) == 1


def test_a_motion_is_looked_at_beside_what_the_other_arm_is_doing():
    """The way is free while the other arm goes out of it, and not before."""
    arms, _ = pair(0.05, 0.0)

    async def script():
        with pytest.raises(TrocarError, match="comes within"):
            await arms.robot.move(to("a", 0.05, 0.0))
        async with running(arms.robot.move, to("b", 0.0, -0.06)):
            await trio.sleep(0.02)
            return (await arms.robot.move(to("a", 0.05, 0.0)))["a"]

    assert arms.run(script).ended is MotionEnd.DONE


def test_an_arm_that_follows_another_stops_when_that_one_stops():
    arms, notes = pair(0.05, 0.0)

    async def script():
        async with running(arms.robot.move, to("b", 0.0, -0.06)):
            await trio.sleep(0.02)
            async with running(arms.robot.move, to("a", 0.05, 0.0)) as ends:
                await trio.sleep(0.05)
                arms.robot.hold("b", reason="somebody pressed the button")
        return ends[0]["a"]

    end = arms.run(script)
    assert end.ended is MotionEnd.FAULT and isinstance(end.cause, TooNear)
    assert set(end.cause.arms) == {"a", "b"} and end.cause.required_m == 1e-3
    assert notes and notes[0][1]["arm"] == "a"
    assert gap_m(arms) > 1e-3
    assert max(arms.use("a")) <= 1.0 + 1e-6


@pytest.mark.parametrize(("to_m", "allowed"), [(0.06, True), (0.010, False), (0.01184, False), (0.01192, True)])
def test_arms_that_are_too_near_may_still_go_apart_and_by_rounding_closer(to_m, allowed):
    arms, _ = pair(0.012, 0.0, min_distance_m=0.02)
    assert gap_m(arms) < 0.012
    refused(arms, to("a", 0.012, to_m), None if allowed else "comes within")


class Believing:
    """Who knows that an arm's joints are elsewhere than where its commands are."""

    def __init__(self, robot, off, expected=None):
        self.robot, self.off, self.expects = robot, off, expected or {}

    def setpoint(self, arm):
        told = self.robot.setpoint(arm)
        return replace(told, q=told.q + self.off.get(arm, 0.0))

    def expected(self, arm):
        return self.expects.get(arm)


@pytest.mark.parametrize(
    ("told_m", "believed_m", "allowed"), [(0.0, 0.0, False), (0.0, -0.04, True), (-0.05, 0.0, False)]
)
def test_distances_are_watched_where_the_joints_are_believed_to_be(told_m, believed_m, allowed):
    """By its commands the other arm is in the way, and its compensation knows that it is not; or the other way."""
    arms, _ = pair(0.05, told_m)
    arms.robot.estimator = Believing(arms.robot, {"b": at("b", believed_m) - at("b", told_m)})
    refused(arms, to("a", 0.05, 0.0), None if allowed else "comes within")


def test_on_its_way_an_arm_is_where_its_joints_are_expected_on_the_time_of_its_commands():
    arms, _ = pair(0.05, 0.0)
    stays = Trajectory.hermite([0.0, 0.1], [at("a", 0.05)] * 2, np.zeros((2, 6)))
    arms.robot.estimator = Believing(arms.robot, {}, {"a": stays})
    assert arms.run(lambda: arms.robot.move(to("a", 0.05, 0.0)))["a"].done, "by its commands it would hit the other"
    arms, _ = pair(0.05, 0.0)
    there, commands = to("a", 0.05, 0.0)["a"], to("a", 0.05, 0.04)["a"]
    arms.robot.estimator = Believing(arms.robot, {}, {"a": there})
    refused(arms, {"a": commands}, "comes within")
    mover = arms.robot._mover("a", (commands, 3.0))
    assert (mover.start_s, mover.end_s) == (3.0, pytest.approx(3.0 + commands.duration_s))
    share = there(0.3 * there.duration_s)
    assert np.abs(mover.joints(3.0 + 0.3 * commands.duration_s) - share).max() < 1e-9


def test_an_arm_that_brakes_is_where_it_brakes_by_as_much_aside_as_it_is_believed_to_be():
    arms, _ = pair(0.05, -0.05)
    off = np.array([0.01, 0.02, 0.001, 0.1, 0.2, 0.3])
    motion = to("a", 0.05, 0.03)["a"]

    async def script():
        async with running(arms.robot.move, {"a": motion}):
            await trio.sleep(0.4 * motion.duration_s)
            arms.robot.hold("a")
            arms.robot.estimator = Believing(arms.robot, {"a": off, "b": -off}, {"a": motion})
            told = arms.robot.setpoint("a")
            mover = arms.robot._mover("a", arms.driver.remaining("a"))
            resting = arms.robot._mover("b", None)
            arms.robot.estimator = None
            await arms.robot.rest("a")
        return told, mover, resting

    told, mover, resting = arms.run(script)
    assert np.abs(mover.joints(told.time_s) - told.q - off).max() < 1e-9
    assert np.abs(mover.joints(mover.end_s) - arms.robot.setpoint("a").q - off).max() < 1e-9
    assert np.abs(resting.joints(0.0) - at("b", -0.05) + off).max() < 1e-12


@pytest.mark.parametrize(("axis", "side"), [(axis, side) for axis in range(3) for side in (0, 1)])
def test_every_side_of_the_workspace_holds(axis, side):
    tip = fk(ARM, HOME).translation_m
    box = np.array([tip - 0.2, tip + 0.2])
    outward = (1 if side else -1) * np.eye(3)[axis]
    box[side, axis] = tip[axis] + 0.4e-3 * (1 if side else -1)
    goal = ik(ARM, SE3.from_parts(fk(ARM, HOME).rotation, tip + 1e-3 * outward), HOME)
    arms, _ = guarded(workspace_m=box)
    refused(arms, {"a": rest_to_rest(HOME, goal, PAPER)}, f"takes its tip to {'xyz'[axis]} = .* mm, outside")
    arms.robot._require_workspace(
        "a", rest_to_rest(HOME, ik(ARM, SE3.from_parts(fk(ARM, HOME).rotation, tip - 1e-3 * outward), HOME), PAPER)
    )
