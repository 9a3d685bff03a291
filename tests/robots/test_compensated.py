"""Compensation, on arms that consist only of cables."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import trio

from cable_arms import GOALS, PLANT, CableArms, to
from driven import ARM, HOME, PAPER, SERVO_S, running
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.recording import Recording
from trocar.cell import MotionEnd
from trocar.errors import ArmMoving, TrocarError
from trocar.motion import move_to, rest_to_rest
from trocar.motion.following import step_towards
from trocar.robots import ArmGuard, Compensated, Guarded
from trocar.robots.compensated import _Prepared, _require_inside, _Start

EXACT = 1.0 + 1e-6


@pytest.fixture(scope="module")
def models():
    q = random_smooth_path(ARM, np.random.default_rng(0))
    recording = Recording(q, PLANT.run(q), np.ones(len(q), bool), np.arange(1, len(q) + 1) * 0.8, "of the plant")
    return {name: MODELS[name].fit(recording, np.random.default_rng(0)) for name in ("play", "ridge", "offset")}


def calibrated(model, names=("a",), slack=(0.0, 0.0, 0.0), **kwargs):
    arms = CableArms(names, slack)
    guarded = Guarded(arms.driver, {name: ArmGuard(ARM, PAPER) for name in names})
    limits = dict.fromkeys(names, PAPER)
    arms.robot = Compensated(
        guarded, dict.fromkeys(names, ARM), dict.fromkeys(names, model), limits, arms, arms.log, **kwargs
    )
    return arms


def after_each_move(arms, goals=GOALS):
    """Move to the goals one after the other; return how far the wrist's joints ended from each, rad (n, 3)."""
    missed = []

    async def script():
        for goal in goals:
            await arms.robot.move(to(arms, goal))
            missed.append(arms.joints["a"][-1][3:] - goal[3:])

    arms.run(script)
    return np.array(missed)


def test_without_compensation_the_joints_miss_by_a_tenth_of_a_radian():
    assert np.abs(after_each_move(CableArms())).max(axis=0).min() > 0.1


def test_with_the_play_model_they_arrive_motion_after_motion(models):
    arms = calibrated(models["play"])
    assert np.abs(after_each_move(arms, np.concatenate([GOALS, GOALS[::-1], GOALS]))).max() < 5e-3


def test_what_is_sent_keeps_the_limits_wherever_slack_is_crossed(models):
    """Once the correction leapt across the cables' slack with 12 times the acceleration that is allowed."""
    arms = calibrated(models["play"])
    after_each_move(arms, np.concatenate([GOALS, GOALS[::-1]]))
    velocity, acceleration = arms.use("a")
    assert velocity <= EXACT and acceleration <= EXACT
    assert acceleration > 0.9, "the limits are made use of"


def test_the_memory_recovers_from_an_unknown_slack_at_the_start(models):
    arms = calibrated(models["play"], slack=PLANT.radii)
    assert np.abs(after_each_move(arms, np.concatenate([GOALS, GOALS])))[-4:].max() < 5e-3


@pytest.mark.parametrize(("name", "share"), [("ridge", 0.5), ("offset", 0.7)])
def test_lesser_models_help_less_but_help(models, name, share):
    helped, unhelped = after_each_move(calibrated(models[name])), after_each_move(CableArms())
    assert np.sqrt(np.mean(helped**2)) < share * np.sqrt(np.mean(unhelped**2))


def test_the_joints_follow_the_path_and_not_only_its_end(models):
    arms = calibrated(models["play"])
    after_each_move(arms, GOALS[:3])
    motion = rest_to_rest(GOALS[2], GOALS[3], PAPER)
    execution = arms.run(lambda: arms.robot.move({"a": motion}))["a"]
    joints = np.array(arms.joints["a"])[np.rint(execution.times_s / SERVO_S).astype(int)]
    wanted = motion(np.linspace(0.01, 1.0, len(joints)) * motion.duration_s)
    last = 2 * len(wanted) // 3
    assert np.abs((joints - wanted)[last:, 3:]).max() < 0.03
    assert np.sqrt(np.mean((joints - wanted)[last:, 3:] ** 2)) < 0.01


def test_it_tells_the_joints_that_the_model_believes_in(models):
    arms = calibrated(models["play"])
    for told in (arms.robot.setpoint("a").q, arms.robot.read("a").q):
        assert np.abs(told - arms.joints["a"][-1]).max() < 5e-3
        assert np.abs(told - HOME).max() > 0.1


def test_while_a_motion_runs_it_tells_where_the_joints_are(models):
    arms = calibrated(models["play"])
    after_each_move(arms, GOALS[:1])
    off = []

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[1])):
            await trio.sleep(0.2)
            while arms.robot.setpoint("a").moving:
                at = arms.robot.setpoint("a")
                off.append((at.q - arms.joints["a"][-1])[:3])
                assert at.velocity.any() and 0 < at.path_s < 5 and at.path_rate == pytest.approx(1.0)
                await trio.sleep(0.05)

    arms.run(script)
    assert len(off) > 4 and np.abs(off).max() < 2e-3


def test_commands_stay_in_range_where_the_joints_go_to_their_ends(models):
    arms = calibrated(models["play"])
    near_the_end = GOALS[0].copy()
    near_the_end[4] = ARM.upper[4] - 0.01
    near_the_end[5] = ARM.lower[5] + 0.01
    after_each_move(arms, [GOALS[0], near_the_end, GOALS[1]])
    sent = np.array(arms.sent["a"])
    assert (sent >= ARM.lower + 4.9e-3).all() and (sent <= ARM.upper - 4.9e-3).all()
    assert np.abs(arms.joints["a"][-1][3:] - GOALS[1][3:]).max() < 5e-3


@pytest.mark.parametrize("after_s", [0.1, 0.15, 0.2])
@pytest.mark.parametrize("how", ["cancelled", "held"])
def test_after_a_stop_the_memory_goes_on_from_where_the_arm_stopped(models, after_s, how):
    """Not from the motion's end, and not from nothing: the next motion arrives as if nobody had stopped the first."""
    arms = calibrated(models["play"])

    async def script():
        await arms.robot.move(to(arms, GOALS[0]))
        if how == "cancelled":
            with trio.move_on_after(after_s):
                await arms.robot.move(to(arms, GOALS[1]))
        else:
            async with running(arms.robot.move, to(arms, GOALS[1])) as ends:
                await trio.sleep(after_s)
                arms.robot.hold("a")
            assert ends[0]["a"].ended is MotionEnd.HELD
        await arms.robot.rest()
        believed, true = arms.robot.setpoint("a").q, arms.joints["a"][-1]
        assert np.abs(believed - GOALS[1]).max() > 0.05, "it stopped on its way"
        assert np.abs(believed - true).max() < 0.03
        await arms.robot.move(to(arms, GOALS[2]))

    arms.run(script)
    assert np.abs(arms.joints["a"][-1] - GOALS[2])[3:].max() < 5e-3
    assert max(arms.use("a")) <= EXACT


def test_a_motion_that_is_held_while_its_commands_are_being_found_does_not_start(models):
    arms = calibrated(models["play"])

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[0])) as ends:
            await trio.sleep(0.02)
            arms.robot.hold(reason="somebody leant in")
        held = ends[0]["a"]
        assert (held.ended, held.reason, len(held.times_s)) == (MotionEnd.HELD, "somebody leant in", 0)
        assert held.commanded.shape == held.measured.shape == (0, 7)
        assert np.abs(np.array(arms.sent["a"]) - HOME).max() == 0.0
        await arms.robot.move(to(arms, GOALS[0]))

    arms.run(script)
    assert np.abs(arms.joints["a"][-1] - GOALS[0])[3:].max() < 5e-3


def test_a_motion_is_replaced_while_it_runs_without_a_leap_and_the_new_one_arrives(models):
    arms = calibrated(models["play"])

    async def script():
        await arms.robot.move(to(arms, GOALS[0]))
        async with running(arms.robot.move, to(arms, GOALS[1])) as ends:
            await trio.sleep(0.22)
            at = arms.robot.setpoint("a")
            assert np.abs(at.velocity).max() > 0.1
            ends.append(await arms.robot.replace({"a": move_to(at.q, at.velocity, GOALS[2], PAPER)}))
        return [end["a"].ended for end in ends]

    assert arms.run(script) == [MotionEnd.REPLACED, MotionEnd.DONE]
    assert np.abs(arms.joints["a"][-1] - GOALS[2])[3:].max() < 5e-3
    assert max(arms.use("a")) <= EXACT


def test_goals_can_be_streamed_and_the_memory_does_not_drift(models):
    """A new goal every 40 ms, each motion taking over from the last; then one to the end."""
    arms = calibrated(models["play"])
    rng = np.random.default_rng(3)

    async def script():
        await arms.robot.move(to(arms, GOALS[0]))
        async with trio.open_nursery() as nursery:
            for _ in range(20):
                at = arms.robot.setpoint("a")
                goal = GOALS[0] + rng.uniform(-0.2, 0.2, 6) * [0.3, 0.3, 0.02, 1, 1, 1]
                nursery.start_soon(arms.robot.replace, {"a": move_to(at.q, at.velocity, goal, PAPER)})
                await trio.sleep(0.04)
            at = arms.robot.setpoint("a")
            nursery.start_soon(arms.robot.replace, {"a": move_to(at.q, at.velocity, GOALS[3], PAPER)})

    arms.run(script)
    assert np.abs(arms.joints["a"][-1] - GOALS[3])[3:].max() < 5e-3
    assert max(arms.use("a")) <= EXACT


def test_commands_that_were_prepared_are_sent_at_once_and_are_the_same(models):
    sent = {}
    for prepared in (False, True):
        arms = calibrated(models["play"])
        motion = to(arms, GOALS[1])

        async def script(arms=arms, motion=motion, prepared=prepared):
            if prepared:
                arms.robot.prepare(motion)
            await arms.robot.move(motion)

        arms.run(script)
        rows = np.array(arms.sent["a"])
        sent[prepared] = rows[np.abs(rows - HOME).max(axis=1) > 0]
        assert [c.name for c in arms.log.computations] == ([] if prepared else ["compensation"])
    count = min(map(len, sent.values()))
    assert np.abs(sent[True][:count] - sent[False][:count]).max() < 1e-12


def test_commands_may_be_prepared_while_the_motion_before_them_runs(models):
    sent = {}
    for ahead in (False, True):
        arms = calibrated(models["play"])
        first = to(arms, GOALS[0])
        second = {"a": rest_to_rest(first["a"](first["a"].times_s[-1]), GOALS[1], PAPER)}

        async def script(arms=arms, first=first, second=second, ahead=ahead):
            arms.robot.prepare(first)
            async with running(arms.robot.move, first):
                await trio.sleep(first["a"].duration_s / 2)
                if ahead:
                    arms.robot.prepare(second)
            await arms.robot.move(second)

        arms.run(script)
        rows = np.array(arms.sent["a"])
        sent[ahead] = rows[np.abs(rows - rows[-1]).max(axis=1) > 0]
        assert [c.name for c in arms.log.computations] == ([] if ahead else ["compensation"])
    assert np.abs(sent[True][-30:] - sent[False][-30:]).max() < 1e-9


@pytest.mark.parametrize("stopped", [True, False])
def test_what_was_prepared_for_another_place_is_not_sent(models, stopped):
    """For the end of a motion that was stopped on its way; for where the arm was before another motion."""
    arms = calibrated(models["play"])

    async def script():
        first, second = to(arms, GOALS[0]), to(arms, GOALS[1])
        if stopped:
            second = {"a": rest_to_rest(first["a"](first["a"].times_s[-1]), GOALS[1], PAPER)}
        else:
            arms.robot.prepare(second)
        async with running(arms.robot.move, first):
            await trio.sleep(first["a"].duration_s / 2)
            if stopped:
                arms.robot.prepare(second)
                arms.robot.hold("a")
        with pytest.raises(TrocarError, match="away from its set-point"):
            await arms.robot.move(second)

    arms.run(script)


def test_a_refused_motion_leaves_the_memory_as_it_was(models):
    arms = calibrated(models["play"])

    async def script():
        await arms.robot.move(to(arms, GOALS[0]))
        before = arms.robot.setpoint("a")
        beyond = GOALS[0].copy()
        beyond[0] = ARM.upper[0] + 0.1
        with pytest.raises(TrocarError):
            await arms.robot.move(to(arms, beyond))
        assert np.array_equal(arms.robot.setpoint("a").q, before.q)
        await arms.robot.move(to(arms, GOALS[1]))

    arms.run(script)
    assert np.abs(arms.joints["a"][-1] - GOALS[1])[3:].max() < 5e-3


def test_it_can_be_told_to_refuse_what_cannot_be_corrected_within_the_range(models):
    arms = calibrated(models["play"], stop_at_limits=True)
    lenient = calibrated(models["play"])
    goal = GOALS[1].copy()
    goal[3] = ARM.lower[3] + 0.02  # roll errs by +.26 rad: the command would have to go beyond the range

    async def script():
        with pytest.raises(TrocarError, match=r"'roll' would need the command -\d+\.\d deg .* outside \[-260"):
            await arms.robot.move(to(arms, goal))
        assert not arms.robot.setpoint("a").moving
        await arms.robot.move(to(arms, GOALS[0]))

    arms.run(script)
    assert np.abs(arms.joints["a"][-1] - GOALS[0])[3:].max() < 5e-3
    lenient.run(lambda: lenient.robot.move(to(lenient, goal)))
    assert np.array(lenient.sent["a"])[:, 3].min() == pytest.approx(ARM.lower[3] + 5e-3, abs=1e-3), "as far as it may"
    assert lenient.robot.setpoint("a").q[3] > goal[3] + 0.1, "it tells what it believes, not what was wanted"


def test_arms_without_a_model_go_through_as_they_are(models):
    arms = CableArms(("a", "b"))
    arms.robot = Compensated(arms.driver, dict.fromkeys("ab", ARM), {"a": models["play"]}, {"a": PAPER}, arms, arms.log)
    execution = arms.run(lambda: arms.robot.move(to(arms, GOALS[0], "b")))["b"]
    assert np.abs(execution.commanded[-1, :6] - GOALS[0]).max() < 1e-12
    assert arms.log.computations == []


def test_jaws_pass_through(models):
    arms = calibrated(models["play"])
    assert arms.run(lambda: arms.robot.jaw("a", 0.5)).done
    assert arms.robot.read("a").jaw_rad == pytest.approx(0.5)


@pytest.mark.parametrize("rad", [4.5e-3, 6e-3])
def test_a_correction_may_fall_short_of_a_range_by_little(rad):
    path = SimpleNamespace(
        lacking=rad * np.array([0, 0, 0.1, 0.5, 1.0, -3.0]), farthest=np.array([0, 0, 0, 0, 1.5, 9.0])
    )
    if rad < 5e-3:
        return _require_inside(ARM, path)
    with pytest.raises(TrocarError, match=r"'wrist_pitch' would need the command 85\.9 deg .* outside \[-80"):
        _require_inside(ARM, path)


def test_what_was_prepared_suits_the_same_motions_from_the_same_rest_alone():
    motions, path = {"a": rest_to_rest(HOME, GOALS[0], PAPER), "b": rest_to_rest(HOME, GOALS[1], PAPER)}, object()
    starts = {"a": _Start(HOME, np.zeros(6), path), "b": _Start(HOME, np.zeros(6), None)}
    prepared = _Prepared(motions, starts, {})
    assert prepared.suits(dict(motions), dict(starts))

    def with_a(**change):
        return starts | {"a": starts["a"]._replace(**change)}

    one = np.eye(6)[4]
    assert prepared.suits(motions, with_a(q_cmd=HOME + 0.7e-9 * one))
    for aside in (1.6e-9 * one, -1.6e-9 * one):
        assert not prepared.suits(motions, with_a(q_cmd=HOME + aside))
    assert not prepared.suits(motions, with_a(velocity=1e-9 * one))
    assert not prepared.suits(motions, with_a(after=None))
    assert not prepared.suits({"a": motions["a"]}, starts)
    assert not prepared.suits(motions | {"a": rest_to_rest(HOME, GOALS[0], PAPER)}, starts), "another motion"


@pytest.mark.parametrize(("stretch", "noted"), [(1.0005, False), (1.0015, True), (1.5, True)])
def test_commands_that_take_longer_slow_the_other_arm_down_too_and_that_is_noted(models, stretch, noted):
    arms = calibrated(models["play"], names=("a", "b"))
    motion = rest_to_rest(HOME, GOALS[0], PAPER)
    path, sent = SimpleNamespace(stretch=stretch, commands=motion), {}

    async def verb(motions):
        sent.update(motions)
        return {}

    trio.run(arms.robot._sent, verb, {"a": motion, "b": motion}, {"a": path})
    assert sent["a"] is motion and sent["b"].duration_s == pytest.approx(stretch * motion.duration_s)
    quicker = SimpleNamespace(stretch=1.0, commands=motion)
    trio.run(arms.robot._sent, verb, {"a": motion, "b": motion, "c": motion}, {"b": quicker, "a": path})
    assert sent["c"].duration_s == pytest.approx(stretch * motion.duration_s), "the slowest of them sets the time"
    arms.log.events.pop() if noted else None
    trio.run(arms.robot._sent, verb, {"c": motion}, {})
    assert sent["c"].duration_s == motion.duration_s
    events = [(event["name"], event["arms"], event["stretch"]) for event in arms.log.events]
    assert events == [("compensation", ["a"], pytest.approx(stretch))] * noted


def test_at_rest_where_the_joints_are_is_estimated_once(models, monkeypatch):
    arms = calibrated(models["play"])
    np.testing.assert_array_equal(arms.robot.setpoint("a").velocity, np.zeros(6))
    after_each_move(arms, GOALS[:1])
    robot, memory, asked = arms.robot, arms.robot._memory, []
    monkeypatch.setattr(robot, "_memory", lambda arm, sent: (asked.append(sent), memory(arm, sent))[1])
    first = robot._estimated("a", arms.driver.setpoint("a"))
    again = robot._estimated("a", arms.driver.setpoint("a"))
    assert np.array_equal(first, again) and len(asked) <= 1
    asked.clear()
    moving = replace(arms.driver.setpoint("a"), moving=True, path_s=0.2, q=GOALS[1])
    for _ in range(2):
        robot._estimated("a", moving)
    assert len(asked) == 2, "not while it moves"
    robot._paths["a"] = replace(robot._paths["a"])
    robot._estimated("a", arms.driver.setpoint("a"))
    assert len(asked) == 3, "nor of another path that ended at the same place"


def test_off_its_path_the_cables_remember_the_straight_way_from_where_it_was_left(models):
    robot = calibrated(models["play"]).robot
    motion = rest_to_rest(HOME, GOALS[0], PAPER)
    asked = []
    memory = SimpleNamespace(after=lambda way, t_s: (way, t_s))
    path = SimpleNamespace(commands=motion, memory_at=lambda t_s: (asked.append(t_s), memory)[1])
    sent = robot.robot.setpoint("a")
    assert robot._memory("a", sent) is robot._rested["a"] and robot.expected("a") is None
    robot._paths["a"] = path
    for path_s in (0.3, motion.duration_s + 0.2):
        left = motion(min(path_s, motion.duration_s))
        on_path = replace(sent, path_s=path_s, q=left, on_path=True)
        assert robot._memory("a", on_path) is robot._memory("a", replace(on_path, on_path=False)) is memory
        aside = left + [0.1, 0, 0, 0.2, 0, 0]
        way, t_s = robot._memory("a", replace(on_path, q=aside, on_path=False))
        for share in (0.0, 0.25, 0.5, 1.0):
            assert np.abs(way(share * t_s) - left - share * (aside - left)).max() < 1e-12
        assert asked[-1] == path_s and t_s == way.duration_s


def test_a_first_motion_that_is_refused_leaves_no_path_and_a_hold_of_another_arm_stops_none(models):
    arms = calibrated(models["play"], names=("a", "b"))
    beyond = HOME.copy()
    beyond[0] = ARM.upper[0] + 0.1

    async def script():
        with pytest.raises(TrocarError):
            await arms.robot.move(to(arms, beyond))
        assert arms.robot._paths == {}
        async with running(arms.robot.move, to(arms, GOALS[0], "a")) as ends:
            await trio.sleep(0.02)
            arms.robot.hold("b")
            await trio.sleep(0.05)
            assert arms.robot.setpoint("a").moving
            assert arms.robot.expected("a") is arms.robot._paths["a"].desired and arms.robot.expected("b") is None
            async with running(arms.robot.move, to(arms, GOALS[0], "b")) as held:
                await trio.sleep(0.02)
                arms.robot.hold("b")
        return ends[0]["a"], held[0]["b"]

    done, held = arms.run(script)
    assert (held.ended, held.reason) == (MotionEnd.HELD, MotionEnd.HELD.value) and done.done


def test_where_the_joints_are_to_be_is_told_unless_they_will_not_come_there(models):
    """At rest after a motion: where it was to end, if its commands miss that by less than a mrad; else the estimate."""
    arms = calibrated(models["play"])
    after_each_move(arms, GOALS[:1])
    robot, path = arms.robot, arms.robot._paths["a"]
    assert path.missing.max() < 1e-3
    assert np.array_equal(robot.setpoint("a").q, path.desired(path.desired.times_s[-1]))
    for miss_rad, believed in ((0.9e-3, False), (1.3e-3, True)):
        robot._paths["a"] = replace(path, missing=np.array([0, 0, 0, 0, miss_rad, 0]))
        estimate = robot.read("a").q
        assert np.array_equal(robot.setpoint("a").q, estimate) == believed
        start = robot._next("a")
        assert not start.then and start.after is robot._paths["a"]
        assert np.array_equal(robot._joints("a", start._replace(then=True))[0], estimate) == believed


def test_a_second_motion_of_one_arm_is_refused_while_the_first_is_computed_and_while_it_runs(models):
    arms = calibrated(models["play"])

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[0])) as ends:
            for since_s in (0.02, 0.2):
                await trio.sleep(since_s)
                assert arms.robot.setpoint("a").moving == (since_s == 0.2)
                with pytest.raises(ArmMoving, match="'a'"):
                    await arms.robot.move(to(arms, GOALS[1]))
        return ends[0]["a"].done

    assert arms.run(script)


def streamed(arms, follow, goals, period_s=0.03):
    """Let the joints follow goals (n, 6), one a period; return how far the wrist was from where each led, rad."""
    off = []

    async def script():
        before, name = goals[0], "a"
        async with trio.open_nursery() as nursery:
            for goal in goals:
                now = arms.robot.setpoint(name)
                velocity = np.clip(now.velocity, -PAPER.velocity, PAPER.velocity)
                motion = step_towards(goal, (goal - before) / period_s, now.q, velocity, PAPER, period_s)
                nursery.start_soon(follow, {name: motion})
                await trio.sleep(period_s)
                off.append((arms.joints[name][-1] - motion(period_s))[3:])
                before = goal
        await arms.robot.rest()

    arms.run(script)
    return np.array(off)


def test_a_stream_is_followed_within_the_limits(models):
    """At 30 goals a second, each motion of which is too short to cross a slack."""
    parts = [rest_to_rest(a, b, PAPER) for a, b in pairwise([GOALS[0], *GOALS[1:4]])]
    path = np.concatenate(
        [part(np.arange(0.0, part.duration_s + 0.5, 0.03).clip(max=part.duration_s)) for part in parts]
    )
    arms = calibrated(models["play"])
    after_each_move(arms, GOALS[:1])
    off = streamed(arms, lambda motions: arms.robot.follow(motions, 0.03), path)
    velocity, acceleration = arms.use("a")
    assert velocity <= EXACT and acceleration <= EXACT
    raw = CableArms()
    after_each_move(raw, GOALS[:1])
    uncorrected = streamed(raw, raw.robot.replace, path)
    assert np.sqrt(np.mean(off**2)) < 0.35 * np.sqrt(np.mean(uncorrected**2))
    assert np.abs(arms.joints["a"][-1] - path[-1])[3:].max() < 5e-3, "at rest it is where it was sent"
