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
    line_deviation,
    plan_motion,
    plan_through,
    vertical_deviation_m,
)
from trocar.motion.spline_program import FREE, JointSpline, Rows
from trocar.motion.sqp import _Refinement
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


@pytest.mark.parametrize("degree", [2, 3])
def test_rows_of_a_spline_say_what_its_trajectory_does(degree):
    rng = np.random.default_rng(0)
    shares = np.concatenate([[0], np.sort(rng.uniform(0.1, 0.9, 6)), [1]])
    first, last = rng.normal(size=(2, 2, 3))
    spline = JointSpline(shares, degree, first, last)
    x = rng.normal(size=3 * spline.free)
    control = spline.control(x)
    at = rng.uniform(0, 1, 9)
    for order in range(degree):
        told = BSpline(np.pad(shares, degree, mode="edge"), control, degree)(at, nu=order)
        block = spline.each_joint(spline.basis(at, order), np.array([1.0, 2.0, 4.0]))
        np.testing.assert_allclose(
            (block.matrix(len(x)) @ x + block.rest).reshape(3, -1).T, told / [1, 2, 4], rtol=1e-9, atol=1e-9
        )
        motion = spline.trajectory(control, 2.0)
        np.testing.assert_allclose(motion(2 * at, order), told / 2.0**order, rtol=1e-9, atol=1e-9)
    gradient = rng.normal(size=(9, 3))
    block = spline.rows(spline.basis(at), gradient)
    places = BSpline(np.pad(shares, degree, mode="edge"), control, degree)(at)
    np.testing.assert_allclose(block.matrix(len(x)) @ x + block.rest, (gradient * places).sum(axis=1), atol=1e-9)


def test_a_programme_is_solved_whatever_the_order_of_its_entries():
    """The least of |x - goal|^2 with x_0 + x_1 <= 1 and x_2 = 2, its Hessian's entries out of order."""
    spline = JointSpline(np.linspace(0, 1, 6), 2, np.zeros((2, 1)), np.zeros((2, 1)))
    rows = Rows(spline.free, 1)
    assert rows.free == 3
    block = spline.rows(spline.basis(np.array([0.5])), np.ones((1, 1)))
    rows.add(block, -FREE, 1.0, weight=1.0)
    mixing = np.array([[2.0, 1, 0, 0], [0, 1, 0, 1], [1, 0, 3, 0], [0, 0, 1, 1]])
    hessian = mixing.T @ mixing
    mixed = sparse.csc_matrix(hessian)
    for column in range(4):  # the same matrix, each column's entries backwards
        part = slice(mixed.indptr[column], mixed.indptr[column + 1])
        mixed.indices[part], mixed.data[part] = mixed.indices[part][::-1].copy(), mixed.data[part][::-1].copy()
    mixed.has_sorted_indices = False
    cost = -hessian @ np.array([1.0, 2.0, 3.0, 4.0])
    x = rows.least(mixed, cost)
    slope = np.append(block.matrix(3).toarray()[0], 1.0)
    price = (slope @ [1.0, 2.0, 3.0, 4.0] + block.rest[0] - 1.0) / (slope @ np.linalg.solve(hessian, slope))
    np.testing.assert_allclose(x, [1, 2, 3, 4] - price * np.linalg.solve(hessian, slope), atol=1e-5)


TIMES_S = np.array([0.0, 0.5, 1.4, 2.0])


def curve_motion(limits=PAPER, **asked):
    """What is asked, the spline between the ends of its waypoints, what is free of it, and the motion that it makes."""
    problem = asking(limits=limits, **asked)
    refinement = _Refinement(problem.arms["it"], problem)
    curve = refinement._curve(TIMES_S)
    x = 0.02 * np.random.default_rng(0).normal(size=6 * curve.free)
    return refinement, curve, x, TimedPath(curve.trajectory(curve.control(x), 2.0), TIMES_S)


def room(rows, x, slack=0.0):
    """What is left above the lower and below the upper bounds of rows."""
    columns = rows.free + rows.extras
    data, row, column = (np.concatenate([getattr(b, name) for b in rows.blocks]) for name in ("data", "row", "column"))
    low, high = np.concatenate(rows.lows), np.concatenate(rows.highs)
    values = sparse.csr_matrix((data, (row, column)), shape=(len(low), columns)) @ np.append(x, slack)
    return values - low, high - values


def test_its_spline_has_sixteen_pieces_a_piece_and_rests_at_both_ends():
    for limits, rest in ((PAPER, 2), (JERK, 3)):
        _, curve, _, path = curve_motion(limits)
        assert len(curve.shares) == 49
        np.testing.assert_allclose(curve.shares[::16], TIMES_S / 2.0)
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
        rows = Rows(6 * curve.free, 1)
        refinement._bound_joints(rows, curve, 2.0)
        below, above = room(rows, x)
        at, motion = 2.0 * curve.shares, path.trajectory
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
    rows = Rows(6 * curve.free, 1)
    refinement._bound_channel(rows, curve, path, TIMES_S, piece)
    begin, end = TIMES_S[piece : piece + 2]
    inside = 2.0 * curve.shares[(2.0 * curve.shares > begin + 1e-9) & (2.0 * curve.shares < end - 1e-9)]
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
