"""The planner 'sqp', and the programs over splines that it solves."""

import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import BSpline

from trocar.arms import MotionLimits, fk
from trocar.geometry import SO3
from trocar.motion import (
    ArmMotion,
    MotionProblem,
    TimedPath,
    duration_bound_s,
    limit_use,
    plan_motion,
    plan_through,
    vertical_deviation_m,
)
from trocar.motion.check import line_deviation
from trocar.motion.curve import Curve
from trocar.motion.qp import Program
from trocar.motion.sqp import HeldSpline, _Refinement
from trocar.trajectory import Trajectory
from waypoints import FOUR, PAPER, PSM

UPRIGHT = (True, False, True)
JERK = MotionLimits(PAPER.velocity, PAPER.acceleration, jerk=20 * np.asarray(PAPER.acceleration))


def asking(points=FOUR, limits=PAPER, straight=UPRIGHT, start=None, **asked):
    motion = ArmMotion(PSM, points, limits, straight=straight, start_velocity=np.zeros(6) if start is None else start)
    return MotionProblem({"it": motion}, **asked)


def test_recorded_transfers_are_no_longer_than_the_authors(recordings):
    """Hwang et al. 2022, section IV-D: `qp_samples` are the lengths that they recorded, in samples of 10 ms."""
    with np.load(recordings / "dvrk/motion/reference_waypoints.npz") as data:
        waypoints, recorded = data["waypoints"], data["qp_samples"]
    for four, samples in list(zip(waypoints, recorded, strict=True))[::3]:  # all: benchmarks/bench_planning.py
        problem = asking(four, range_slack=0.02)
        plan = plan_motion(problem, "sqp")
        assert plan.found, plan.reason
        assert plan.duration_s < 0.01 * samples
        assert plan.duration_s < 1.04 * plan.bound_s
        assert vertical_deviation_m(problem.arms["it"], plan.paths["it"]) < 1e-4


def test_a_limited_jerk_is_kept_and_costs_time():
    free, limited = (plan_motion(asking(limits=limits), "sqp") for limits in (PAPER, JERK))
    assert free.found and limited.found, limited.reason
    assert limited.duration_s > free.duration_s + 0.02
    motion = limited.trajectory
    np.testing.assert_allclose(motion(0.0, 2), 0, atol=1e-9)  # it starts and ends without acceleration
    times = np.linspace(0, limited.duration_s, 3000)
    jerks = np.diff(motion(times, 2), axis=0) / times[1]
    assert np.abs(jerks / JERK.jerk).max() == pytest.approx(1, abs=1e-3)  # at the limit somewhere, nowhere above
    assert limited.use["it"].jerk_ratio <= 1


def test_it_is_smoother_over_a_longer_horizon_and_there_is_none_below_the_bound():
    problem = asking()
    plan = plan_motion(problem, "sqp")
    refinement = _Refinement(problem.arms["it"], problem)
    pieces_s = np.diff(plan.waypoint_times_s["it"])
    longer = refinement.over(1.2 * pieces_s, plan.paths["it"])
    assert longer is not None

    def roughness(motion):
        pushes = motion(np.linspace(0, motion.duration_s, 2000), 2) / PAPER.acceleration
        return np.square(np.diff(pushes, axis=0)).sum() / motion.duration_s

    assert roughness(longer.trajectory) < 0.5 * roughness(plan.trajectory)
    assert refinement.over(0.9 * plan.bound_s / plan.duration_s * pieces_s, plan.paths["it"]) is None


def test_moving_starts_approaches_and_plain_moves():
    start = 0.2 * (FOUR[2] - FOUR[1]) / np.abs(FOUR[2] - FOUR[1]).max()
    for limits in (PAPER, JERK):
        for points, straight in ((FOUR[1:], (False, True)), (FOUR[:2], (False,))):
            going = plan_motion(asking(points, limits, straight, start if len(points) == 3 else None), "sqp")
            assert going.found, going.reason
    np.testing.assert_allclose(
        plan_motion(asking(FOUR[1:], PAPER, (False, True), start), "sqp").trajectory(0.0, 1), start, atol=1e-9
    )


def test_a_channel_that_no_programme_keeps_ends_with_the_spline():
    plan = plan_motion(asking(straight_tolerance_m=1e-9, straight_tolerance_rad=1e-9), "sqp")
    assert not plan.found and "strays" in plan.reason
    spline = plan_through(PSM, FOUR, PAPER)
    np.testing.assert_array_equal(plan.paths["it"].trajectory.coefficients, spline.trajectory.coefficients)


def test_the_middle_of_a_recorded_kind_does_not_sag():
    plan = plan_motion(asking(), "sqp")
    begin, end = plan.waypoint_times_s["it"][1:3]
    z = fk(PSM, plan.trajectory(np.linspace(begin, end, 300))).translation_m[:, 2]
    assert z.min() > min(z[0], z[-1]) - 1e-5


SHARES = np.array([0.0, 0.1, 0.35, 0.6, 0.8, 1.0])
AT = np.array([0.0, 0.05, 0.1, 0.4, 0.6, 0.99, 1.0])


def held_spline(first=2, last=1):
    """A spline of two joints whose first and last control points are held, and the curve of its control points."""
    rng = np.random.default_rng(0)
    spline = HeldSpline(Curve(SHARES), rng.normal(size=(first, 2)), rng.normal(size=(last, 2)))
    return spline, lambda control: BSpline(np.pad(SHARES, 3, mode="edge"), control, 3), rng


def test_free_control_points_lie_between_those_that_are_held():
    spline, _, rng = held_spline()
    assert spline.free == 5
    free = rng.normal(size=2 * spline.free)
    control, line = spline.control(free), spline.control(0 * free)
    np.testing.assert_array_equal(control[:2], spline.first)
    np.testing.assert_array_equal(control[-1:], spline.last)
    np.testing.assert_allclose((control - line)[2:-1], free.reshape(2, -1).T)
    spline, curve, _ = held_spline(first=1)  # without free parts it is the straight line
    along = curve(spline.control(np.zeros(2 * spline.free)))(AT)
    np.testing.assert_allclose(along, spline.first + AT[:, None] * (spline.last - spline.first), atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_rows_are_the_gradients_times_the_curve_and_the_slack(order):
    spline, curve, rng = held_spline()
    x, gradient = rng.normal(size=2 * spline.free + 1), rng.normal(size=(len(AT), 2))
    gradient[1] = 0.0
    values = curve(spline.control(x[:-1]))(AT, nu=order)
    for slack in (0.0, -2.0):
        matrix, rest = spline.rows(spline.curve.basis(AT, order), gradient, slack)
        assert np.all(matrix.data != 0)
        np.testing.assert_allclose(matrix @ x + rest, (gradient * values).sum(axis=1) + slack * x[-1], atol=1e-9)
    matrix, rest = spline.each_joint(spline.curve.basis(AT, order), np.array([2.0, 4.0]))
    np.testing.assert_allclose(matrix @ x + rest, (values / [2.0, 4.0]).T.ravel(), atol=1e-9)


def test_a_motion_is_the_curve_over_so_many_seconds():
    spline, curve, rng = held_spline()
    control = spline.control(rng.normal(size=2 * spline.free))
    motion = spline.trajectory(control, 2.5)
    assert motion.duration_s == 2.5 and len(motion.coefficients) == 4
    for order in range(3):
        np.testing.assert_allclose(motion(2.5 * AT, order), curve(control)(AT, nu=order) / 2.5**order)


TIMES_S = np.array([0.0, 0.5, 1.4, 2.0])


def curve_motion(limits=PAPER, **asked):
    """What is asked, the spline between the ends of its waypoints, what is free of it, and the motion that it makes."""
    problem = asking(limits=limits, **asked)
    refinement = _Refinement(problem.arms["it"], problem)
    curve = refinement._spline(TIMES_S)
    x = 0.02 * np.random.default_rng(0).normal(size=6 * curve.free)
    return refinement, curve, x, TimedPath(curve.trajectory(curve.control(x), 2.0), TIMES_S)


def bounded(bound, *asked):
    """The program to which a function adds its constraints."""
    program = Program("it", np.zeros((0, 0)), np.zeros(0))
    bound(program, *asked)
    return program


def room(program, x, slack=0.0):
    """What is left above the lower and below the upper bounds of a program's constraints."""
    rows, low, high = zip(*program.constraints.values(), strict=True)
    values = sparse.vstack(rows) @ np.append(x, slack)
    return values - np.concatenate(low), np.concatenate(high) - values


def test_its_spline_has_sixteen_pieces_a_piece_and_rests_at_both_ends():
    for limits, rest in ((PAPER, 2), (JERK, 3)):
        _, curve, _, path = curve_motion(limits)
        assert len(curve.curve.knots) == 49
        np.testing.assert_allclose(curve.curve.knots[::16], TIMES_S / 2.0)
        assert curve.free == 48 + 3 - 2 * rest
        for order in range(1, rest):
            for end in (0.0, np.nextafter(2.0, 0)):
                np.testing.assert_allclose(path.trajectory(end, order), 0, atol=1e-6)
    start = np.full(6, 0.02)
    motion = curve_motion(JERK, start=start)[3].trajectory
    np.testing.assert_allclose(motion(0.0, 1), start, atol=1e-9)
    np.testing.assert_allclose(motion(0.0), FOUR[0])
    assert np.abs(motion(0.0, 2)).max() > 1e-3  # under way, it may accelerate at once


@pytest.mark.parametrize("slack", [0.0, 0.02])
def test_ranges_velocities_accelerations_and_jerks_are_bounded(slack):
    for limits in (PAPER, JERK):
        refinement, curve, x, path = curve_motion(limits, range_slack=slack)
        below, above = room(bounded(refinement._bound_joints, curve, 2.0), x)
        at, motion = 2.0 * curve.curve.knots, path.trajectory
        count = 6 * 47
        q, extent = motion(at[1:-1]), PSM.upper - PSM.lower
        np.testing.assert_allclose(below[:count], ((q - PSM.lower) / extent + slack).T.ravel(), atol=1e-9)
        np.testing.assert_allclose(above[:count], ((PSM.upper - q) / extent + slack).T.ravel(), atol=1e-9)
        wanted = [(motion(at[1:-1], 1) / limits.velocity).T.ravel(), (motion(at, 2) / limits.acceleration).T.ravel()]
        wanted += [] if limits.jerk is None else [(motion(at[:-1], 3) / limits.jerk).T.ravel()]
        for sign, left in ((1, below), (-1, above)):
            np.testing.assert_allclose(left[count:], 1 + sign * np.concatenate(wanted), rtol=1e-5, atol=2e-6)
            assert np.all(left[count:] < 1 + sign * np.concatenate(wanted))  # a little is left


@pytest.mark.parametrize("piece", [0, 1, 2])
def test_a_channel_is_as_wide_as_the_tolerance_and_can_be_left_for_a_price(piece):
    refinement, curve, x, path = curve_motion(straight_tolerance_m=2e-3, straight_tolerance_rad=0.1)
    rows = bounded(refinement._bound_channel, curve, path, TIMES_S, piece)
    begin, end = TIMES_S[piece : piece + 2]
    inside = 2.0 * curve.curve.knots[(2.0 * curve.curve.knots > begin + 1e-9) & (2.0 * curve.curve.knots < end - 1e-9)]
    at = np.union1d(inside, inside - (end - begin) / 32)
    for slack in (0.0, 3.0):
        below, above = room(rows, x, slack)
        parts, along = above[: 10 * len(at)].reshape(5, 2, -1), above[10 * len(at) :]
        np.testing.assert_allclose(parts.mean(axis=1), 1 + slack)  # to either side
    values = (parts[:, 1] - parts[:, 0]) / 2
    assert below[: 10 * len(at)].min() > 1e30
    tips, ends = fk(PSM, path.trajectory(at)), fk(PSM, FOUR[piece : piece + 2])
    line, gone = np.diff(ends.translation_m, axis=0)[0], tips.translation_m - ends.translation_m[0]
    done = gone @ line / (line @ line)
    off = gone - done[:, None] * line
    width_m = 0.85 * 2e-3 / np.sqrt(2)
    np.testing.assert_allclose(np.linalg.norm(values[:2], axis=0), np.linalg.norm(off, axis=1) / width_m, atol=1e-6)
    turn = (ends.rotation[0].inverse() @ ends.rotation[1]).log()
    straight = ends.rotation[0] @ SO3.exp(np.clip(done, 0, 1)[:, None] * turn)
    turned = (tips.rotation @ straight.inverse()).log()
    np.testing.assert_allclose(values[2:].T, turned / (0.85 * 0.1 / np.sqrt(3)), atol=1e-6)
    np.testing.assert_allclose(below[10 * len(at) :], gone @ line, atol=1e-12)
    np.testing.assert_allclose(along, line @ line - gone @ line, atol=1e-12)
    step = 1e-6 * np.random.default_rng(1).normal(size=len(x))
    moved = fk(PSM, curve.trajectory(curve.control(x + step), 2.0)(at)).translation_m - tips.translation_m
    np.testing.assert_allclose(
        room(rows, x + step)[0][10 * len(at) :] - below[10 * len(at) :], moved @ line, atol=1e-10
    )


def test_what_is_kept_is_measured_at_1_khz():
    refinement = curve_motion(straight_tolerance_m=1.0, straight_tolerance_rad=3.0)[0]
    resting = TimedPath(Trajectory.hermite(3 * np.arange(4.0), FOUR, np.zeros((4, 6))), 3 * np.arange(4.0))
    assert refinement._kept(resting)
    used = limit_use(PSM, resting.trajectory, PAPER)
    strays = [line_deviation(refinement.arm, resting, piece) for piece in (0, 2)]
    off_m, off_rad = np.array(strays).max(axis=0)
    for share, kept in ((1.001, True), (0.999, False)):
        for tight in (
            {"straight_tolerance_m": share * off_m, "straight_tolerance_rad": 3.0},
            {"straight_tolerance_m": 1.0, "straight_tolerance_rad": share * off_rad},
        ):
            problem = asking(**tight)
            assert _Refinement(problem.arms["it"], problem)._kept(resting) == kept
        for name, ratio in (("velocity", used.velocity_ratio), ("acceleration", used.acceleration_ratio)):
            limits = MotionLimits(
                *(
                    share * ratio * getattr(PAPER, kind) if kind == name else 10 * getattr(PAPER, kind)
                    for kind in ("velocity", "acceleration")
                )
            )
            problem = asking(limits=limits, straight_tolerance_m=1.0, straight_tolerance_rad=3.0)
            assert _Refinement(problem.arms["it"], problem)._kept(resting) == kept
    jerky = MotionLimits(10 * PAPER.velocity, 10 * PAPER.acceleration, jerk=PAPER.acceleration)
    problem = asking(limits=jerky, straight_tolerance_m=1.0, straight_tolerance_rad=3.0)
    assert not _Refinement(problem.arms["it"], problem)._kept(resting)


def horizons(monkeypatch, enough):
    """A refinement whose programmes have an answer where the pieces' times (n,) are enough, and all times tried."""
    problem = asking()
    refinement, tried = _Refinement(problem.arms["it"], problem), []

    def over(self, pieces_s, path):
        tried.append(pieces_s)
        times = np.concatenate([[0.0], np.cumsum(pieces_s)])
        return TimedPath(Trajectory.hermite(times, FOUR, np.zeros((4, 6))), times) if enough(pieces_s) else None

    monkeypatch.setattr(_Refinement, "over", over)
    return refinement, tried


def test_the_horizon_is_halved_and_then_each_piece_down_to_a_sample(monkeypatch):
    least = np.array([0.45, 0.5, 0.44])
    refinement, tried = horizons(monkeypatch, lambda pieces_s: np.all(pieces_s >= least))
    spline_s = np.array([0.9, 0.9, 0.8])
    path = TimedPath(Trajectory.hermite(np.arange(4.0), FOUR, np.zeros((4, 6))), np.append(0, np.cumsum(spline_s)))
    found = np.diff(refinement.shortest(path).waypoint_times_s)
    np.testing.assert_array_equal(tried[0], spline_s)
    assert np.all(found >= least) and np.all(found - least <= 0.011)
    shortest = min(pieces.sum() for pieces in tried)
    assert shortest >= duration_bound_s(FOUR, PAPER) - 1e-9  # below that nothing is tried
    assert len(tried) < 30


def test_a_horizon_that_is_too_short_grows_by_a_fifth_twelve_times_at_most(monkeypatch):
    spline_s = np.array([0.3, 0.4, 0.3])
    path = TimedPath(Trajectory.hermite(np.arange(4.0), FOUR, np.zeros((4, 6))), np.append(0, np.cumsum(spline_s)))
    refinement, tried = horizons(monkeypatch, lambda pieces_s: False)
    assert refinement.shortest(path) is path
    np.testing.assert_allclose(tried, 1.2 ** np.arange(12)[:, None] * spline_s)
    refinement, tried = horizons(monkeypatch, lambda pieces_s: pieces_s.sum() >= 2.0)
    found = refinement.shortest(path)
    assert 2.0 <= found.waypoint_times_s[-1] <= 2.011
