"""The planner 'sqp', and the programs over splines that it solves."""

import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import BSpline

from trocar.arms import MotionLimits, fk
from trocar.motion import ArmMotion, MotionProblem, plan_motion, plan_through, vertical_deviation_m
from trocar.motion.spline_program import FREE, JointSpline, Rows
from trocar.motion.sqp import _Refinement
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
