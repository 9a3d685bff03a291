"""A robot that learns its cables, on arms that consist only of cables."""

from copy import deepcopy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cable_arms import GOALS, CableArms, to
from driven import ARM, HOME, PAPER, running
from trocar.arms import PSM_CLASSIC, frames
from trocar.calibration.excitation import PSM1_BOX
from trocar.calibration.fleet import expected, load_prior
from trocar.calibration.models.base import MIN_ROWS
from trocar.cell import SetPoint
from trocar.errors import ArmMoving
from trocar.perception.instrument import Sighting
from trocar.robots import Adaptive, ArmGuard, Guarded
from trocar.robots.adaptive import THINNED, Observation, _Past, _thinned, combine
from trocar.trajectory import Trajectory

PRIOR = load_prior("fleet").without("psm1_grey")
SURE = np.diag(np.repeat([1.0 / 0.03**2, 1.0 / 0.1e-3**2], 3))
LOOKS = 36


def adaptive():
    arms = CableArms(("a",))
    model = expected(PRIOR, PSM1_BOX)
    guarded = Guarded(arms.driver, {"a": ArmGuard(ARM, PAPER)})
    arms.robot = Adaptive(guarded, {"a": ARM}, {"a": model}, {"a": PAPER}, arms, arms.log, priors={"a": PRIOR})
    return arms


def seen_now(arms, rng=None, off=(0.0, 0.0, 0.0)):
    """Return what a camera says of where the wrist is in truth."""
    row, q = arms.robot.moment("a")
    q[3:] = arms.joints["a"][-1][3:] + off + (0.0 if rng is None else rng.normal(0.0, 0.03, 3))
    return row, Sighting(q, np.zeros(3), SURE, np.zeros(6), 500, 0.2e-3)


async def taught(arms):
    """Turn the wrist to and fro, look, and use what that teaches."""
    rng = np.random.default_rng(0)
    for goal in rng.uniform(PSM1_BOX.lower[3:], PSM1_BOX.upper[3:], (LOOKS, 3)):
        await arms.robot.move(to(arms, np.append(HOME[:3], goal)))
        arms.robot.saw("a", *seen_now(arms, rng))
    known = arms.robot.learned("a")
    assert known is not None
    arms.robot.adopt("a", known)
    return known


@pytest.fixture(scope="module")
def learner():
    """Arms that have been taught, and what they know: not to be used but copied."""
    arms = adaptive()
    return arms, arms.run(lambda: taught(arms))


@pytest.fixture
def expert(learner):
    return deepcopy(learner)


def missed(arms, goals=GOALS):
    async def script():
        found = []
        for goal in goals:
            await arms.robot.move(to(arms, goal))
            found.append(arms.joints["a"][-1][3:] - goal[3:])
        return np.sqrt(np.mean(np.square(found)))

    return script


def test_looks_are_worth_a_calibration(expert):
    new, (arms, _) = adaptive(), expert
    before, after = new.run(missed(new)), arms.run(missed(arms))
    assert before > 0.08 and after < 0.03


def test_it_says_how_far_off_it_may_be(expert):
    (arms, _), scores = expert, []

    async def script():
        for goal in np.concatenate([GOALS, GOALS[::-1] + [0.0, 0.0, 0.0, 0.2, -0.1, 0.1]]):
            await arms.robot.move(to(arms, goal))
            scores.append((arms.joints["a"][-1] - arms.robot.read("a").q)[3:] / arms.robot.spread("a"))

    arms.run(script)
    assert 0.1 < np.sqrt(np.mean(np.square(scores))) < 1.3
    assert (np.abs(scores) < 2.5).all()


def test_a_correction_goes_as_far_as_the_evidence_bears(expert):
    arms, _ = expert
    spread, before = arms.robot.spread("a"), arms.robot.read("a").q
    _, seen = seen_now(arms)
    assert arms.robot.correct("a", seen)
    off, corrected = seen.q[3:] - before[3:], (arms.robot.read("a").q - before)[3:]
    assert_allclose(corrected, off * spread**2 / (spread**2 + 0.03**2), atol=2e-3)
    assert_allclose(arms.robot.setpoint("a").q, arms.robot.read("a").q)


def test_a_bad_detection_moves_nothing(expert):
    arms, _ = expert
    before = arms.robot.read("a").q
    _, far = seen_now(arms, off=(0.5, 0.0, 0.0))
    _, near = seen_now(arms)
    bad = Sighting(near.q, near.shift_m, near.information, near.pull, near.points, 0.9e-3)
    assert not arms.robot.correct("a", far) and not arms.robot.correct("a", bad)
    assert_allclose(arms.robot.read("a").q, before)
    # in units of what image and model explain together, one look of a thousand is off by more than 4.03
    scatter = np.sqrt(arms.robot.spread("a")[1] ** 2 + 1 / (1 / 0.03**2 + 1))
    for units, accepted in ((4.15, False), (3.9, True)):
        q = before + units * scatter * np.eye(6)[4]
        seen = Sighting(q, near.shift_m, near.information, near.pull, near.points, near.left_m)
        assert arms.robot.correct("a", seen) == accepted


def test_before_anything_is_learned_nothing_is_corrected():
    arms = adaptive()
    _, seen = seen_now(arms)
    assert arms.robot.spread("a") is None and not arms.robot.correct("a", seen)


def test_all_that_was_sent_is_kept_once_as_far_as_it_was_sent():
    """Half-way through a motion, again at the same place, and after its end: no command twice, none to come."""
    arms = adaptive()

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[0])):
            await arms.sleep(0.2)
            row, q = arms.robot.moment("a")
            sent = arms.driver.setpoint("a").q
            kept = np.concatenate(arms.robot._pasts["a"].commands)
            assert len(kept) == row + 1 and np.array_equal(kept[0], HOME)
            assert_allclose(kept[-1], sent, atol=1e-12)
            assert_allclose(q[:3], sent[:3])
            assert_allclose(q[3:], arms.robot.read("a").q[3:])
            assert arms.robot.moment("a")[0] == row, "nothing was sent since"
        return row, kept

    row, kept = arms.run(script)
    last, _ = arms.robot.moment("a")
    whole = np.concatenate(arms.robot._pasts["a"].commands)
    assert last == len(whole) - 1 > row
    assert_allclose(whole[: len(kept)], kept)
    assert_allclose(whole[-1], arms.driver.setpoint("a").q, atol=1e-12)
    sent = np.array(arms.sent["a"])
    off = [np.abs(whole - row).max(axis=1).min() for row in sent[::10]]
    assert np.max(off) < 0.2, "pieces lie along what was sent"
    steps = np.linalg.norm(np.diff(whole, axis=0), axis=1)
    assert (steps > 1e-9).all(), "no command is kept twice"


def test_what_was_sent_is_kept_though_nobody_asked_until_the_next_motion_had_begun():
    """There and back: without the place where it turned round, the cables' slack would be on the other side."""
    arms = adaptive()

    async def script():
        turned = []
        for goal in GOALS[:2]:
            await arms.robot.move(to(arms, goal))
            turned.append(arms.driver.setpoint("a").q)
        arms.robot.moment("a")
        return turned

    turned = arms.run(script)
    kept = np.concatenate(arms.robot._pasts["a"].commands)
    assert all(np.abs(kept - place).max(axis=1).min() < 1e-9 for place in turned)


def test_what_was_prepared_with_other_cables_is_dropped_and_of_other_arms_stays(expert):
    arms, _ = expert
    motion = to(arms, GOALS[0])
    arms.robot._prepared[frozenset({"b"})] = None
    arms.robot.prepare(motion)
    assert set(arms.robot._prepared) == {frozenset({"a"}), frozenset({"b"})}
    _, seen = seen_now(arms)
    assert arms.robot.correct("a", seen)
    assert set(arms.robot._prepared) == {frozenset({"b"})}


def test_what_was_sent_is_remembered_whatever_happens_to_a_motion(expert):
    """Stopped, replaced, gone on: with the same cables adopted again, the joints are believed where they were."""
    arms, known = expert

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[0])):
            await arms.sleep(0.15)
            arms.robot.moment("a")
            await arms.sleep(0.1)
            arms.robot.hold("a")
        await arms.robot.rest("a")
        await arms.robot.move(to(arms, GOALS[1]))
        before = arms.robot.read("a").q
        arms.robot.adopt("a", known)
        return before, arms.robot.read("a").q

    before, after = arms.run(script)
    assert_allclose(after, before, atol=3 * THINNED)


def test_an_arm_that_moves_keeps_its_cables(expert):
    arms, known = expert

    async def script():
        async with running(arms.robot.move, to(arms, GOALS[0])):
            await arms.sleep(0.1)
            with pytest.raises(ArmMoving, match="cable model"):
                arms.robot.adopt("a", known)

    arms.run(script)


def test_thinned_commands_lie_where_all_of_them_lie():
    t = np.linspace(0.0, 1.0, 400)
    path = np.column_stack([np.sin(6 * t), t, 0 * t, np.abs(t - 0.5), t**2, np.cos(9 * t)])
    few = _thinned(path)
    assert len(few) < 150 and (few[[0, -1]] == path[[0, -1]]).all()
    kept = np.flatnonzero((path[:, None] == few).all(axis=2).any(axis=1))
    again = np.column_stack([np.interp(np.arange(len(path)), kept, column) for column in few.T])
    assert np.abs(again - path).max() <= THINNED


def test_lines_and_corners_of_three_points_are_thinned_to_what_they_are():
    line = np.outer([0.0, 0.5, 1.0], np.ones(6))
    assert _thinned(line).tolist() == line[[0, -1]].tolist() and _thinned(line[:2]).tolist() == line[:2].tolist()
    for bulge, kept in ((0.9e-3, 2), (1.1e-3, 3), (-1.1e-3, 3)):
        assert len(_thinned(line + bulge * np.outer([0, 1, 0], np.eye(6)[2]))) == kept
    uneven = np.outer([0.0, 0.1, 1.0], np.ones(6))  # along a straight line, but not at its middle
    assert len(_thinned(uneven)) == 3


def along(kept, path, until_s):
    """Return how far kept commands are from a path up to a time, taken as a line through them."""
    times = np.linspace(0.0, until_s, 400)
    ways = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=1)))
    wanted = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path(times), axis=0), axis=1)))
    line = np.column_stack([np.interp(wanted * ways[-1] / wanted[-1], ways, column) for column in kept.T])
    return np.abs(line - path(times)).max()


def test_of_a_path_what_was_sent_up_to_now_is_kept_piece_by_piece():
    """A path that turns sharply; one that is left on the way; the next one from its beginning."""
    t = np.linspace(0.0, 0.8, 41)
    curve = np.column_stack([np.sin(7 * t), np.cos(7 * t), 0.1 * t, t, 0 * t, t**2]) * 0.2
    path = SimpleNamespace(commands=Trajectory.hermite(t, curve, np.gradient(curve, t, axis=0)))
    past = _Past([curve[:1]])
    sent = SetPoint(0.0, curve[0], np.zeros(6), False)
    past.keep(None, sent)
    assert past.rows == 1
    rows = []
    for path_s in (0.0, 0.13, 0.13, 0.5, 0.8, 0.9):
        now = replace(sent, q=path.commands(min(path_s, 0.8)), path_s=path_s)
        past.keep(path, now)
        kept = np.concatenate(past.commands)
        rows.append(past.rows)
        assert past.rows == len(kept) and np.abs(kept[-1] - now.q).max() < 1e-12
        if path_s:
            assert along(kept, path.commands, min(path_s, 0.8)) < 5e-3
    assert rows[0] == 1 < rows[1] == rows[2] < rows[3] < rows[4]
    steps = np.linalg.norm(np.diff(np.concatenate(past.commands[:-1]), axis=0), axis=1)
    assert steps.min() > 1e-6, "none twice"
    aside = replace(now, q=now.q + [0, 0, 0, 0.3, 0, 0])
    past.keep(path, aside)
    assert np.array_equal(past.commands[-1], aside.q[None])
    before = past.rows
    past.keep(SimpleNamespace(commands=path.commands), replace(sent, q=path.commands(0.4), path_s=0.4))
    again = np.concatenate(past.commands)[before:]
    assert np.abs(again[-1] - path.commands(0.4)).max() < 1e-12
    assert along(np.concatenate([curve[:1], again]), path.commands, 0.4) < 5e-3


def test_so_many_looks_as_a_fit_needs_and_no_fewer_teach(expert):
    arms, _ = expert
    observations = arms.robot._pasts["a"].observations
    for count, taught_something in ((MIN_ROWS - 1, False), (MIN_ROWS, True)):
        arms.robot._pasts["a"].observations = observations[:count]
        assert (arms.robot.learned("a") is not None) == taught_something


def test_cables_that_were_learned_are_followed_from_the_last_command(expert):
    arms, _ = expert
    assert_allclose(arms.robot._rested["a"].q_cmd, arms.driver.setpoint("a").q, atol=1e-12)


# What images of the wrist say together: the shift of the instrument is common to all.

SHIFT_M = np.array([0.6e-3, -0.3e-3, 0.2e-3])
START = np.array([0.8, 0.0, 0.18, 0.0, 0.0, -0.5])


def observations_of(wrists, rng, left_m=0.2e-3):
    """Return observations at wrists (n, 3) by images each of which leaves one turn and the shift in doubt together."""
    observations = []
    for row, wrist in enumerate(wrists):
        slopes = rng.normal(size=(12, 6)) * np.repeat([1.0, 100.0], 3) / 0.02
        slopes[:, 0] = slopes[:, 3 + row % 3] * 8e-3  # in one image this turn observations like that shift
        information = slopes.T @ slopes
        truth = np.append(wrist, SHIFT_M)
        expected = np.append(wrist + rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.3e-3, 3))
        q = np.append(START[:3], expected[:3])
        pull = information @ (truth - expected)
        observations.append(Observation(row, Sighting(q, expected[3:], information, pull, 500, left_m)))
    return observations


@pytest.fixture
def wrists():
    return np.random.default_rng(0).uniform([-1.0, -0.7, -0.9], [1.0, 0.7, -0.2], (20, 3))


def test_a_common_shift_is_found_and_the_wrists_with_it(wrists):
    q_cmd = np.tile(START, (len(wrists), 1))
    seen = combine(PSM_CLASSIC, "observations", q_cmd, observations_of(wrists, np.random.default_rng(1)))
    assert_allclose(seen.shift_m, SHIFT_M, atol=0.03e-3)
    assert_allclose(seen.recording.q_phy[:, 3:], wrists, atol=0.01)
    assert seen.recording.valid.all() and (seen.sd_rad < 0.5).all()


def test_the_outer_joints_take_the_instrument_to_where_it_is_seen(wrists):
    q_cmd = np.tile(START, (len(wrists), 1))
    seen = combine(PSM_CLASSIC, "observations", q_cmd, observations_of(wrists, np.random.default_rng(1)))
    for q in seen.recording.q_phy:
        asked = np.append(START[:3], q[3:])
        moved = frames(PSM_CLASSIC, q)[6].translation_m - frames(PSM_CLASSIC, asked)[6].translation_m
        assert_allclose(moved, seen.shift_m, atol=0.03e-3)


def test_images_of_something_else_do_not_count(wrists):
    rng, q_cmd = np.random.default_rng(1), np.tile(START, (len(wrists), 1))
    good = observations_of(wrists[:15], rng)
    foreign = [
        Observation(15 + observation.row, observation.sighting)
        for observation in observations_of(wrists[15:] + 0.4, rng, left_m=1e-3)
    ]
    seen = combine(PSM_CLASSIC, "observations", q_cmd, [*good, *foreign])
    assert seen.recording.valid.tolist() == [True] * 15 + [False] * 5


def test_without_looks_nothing_is_said(wrists):
    seen = combine(PSM_CLASSIC, "observations", np.tile(START, (len(wrists), 1)), [])
    assert not seen.shift_m.any() and not seen.recording.valid.any()


def test_what_one_image_tells_of_the_shift_is_weighed_against_how_instruments_usually_lie():
    """As sure as that, it is believed by half; twice by two thirds. A wrist it tells nothing of stays."""
    sure = np.diag([0, 0, 0, *[1 / 0.5e-3**2] * 3])
    q_cmd = np.tile(START, (3, 1))
    observation = Observation(1, Sighting(START, SHIFT_M, sure, np.zeros(6), 500, 0.59e-3))
    once = combine(PSM_CLASSIC, "once", q_cmd, [observation])
    assert_allclose(once.shift_m, SHIFT_M / 2)
    assert_allclose(combine(PSM_CLASSIC, "twice", q_cmd, [observation, observation]).shift_m, SHIFT_M * 2 / 3)
    assert_allclose(once.recording.q_phy[1, 3:], START[3:])
    assert_allclose(once.sd_rad, 1.0)  # a radian where nothing is known
    assert once.recording.valid.tolist() == [False, True, False]
    assert_allclose(once.recording.t_s, [0, 1, 2])


def test_a_sure_image_gives_the_wrist_and_its_uncertainty():
    pull, information = np.array([3.0, -4.0, 5.0, 0, 0, 0]), np.diag([99.0, 399.0, 24.0, 1e12, 1e12, 1e12])
    observation = Observation(0, Sighting(START, np.zeros(3), information, pull, 500, 0.1e-3))
    seen = combine(PSM_CLASSIC, "sure", np.tile(START, (2, 1)), [observation])
    assert_allclose(seen.recording.q_phy[0, 3:] - START[3:], [0.03, -0.01, 0.2])
    assert_allclose(seen.sd_rad, [[0.1, 0.05, 0.2], [1, 1, 1]])
