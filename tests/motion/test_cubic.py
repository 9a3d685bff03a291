"""Durations of cubics on a grid, in closed form."""

import numpy as np
import pytest

from trocar.arms import MotionLimits
from trocar.motion.cubic import CubicGrid, _peak
from trocar.trajectory import Trajectory


def one_joint(velocity=1e3, acceleration=1e3):
    return MotionLimits(np.array([velocity]), np.array([acceleration]))


def grid_of(waypoints, limits, batch=1, first_s=0.1, step_s=0.05, longest_s=2.0):
    return CubicGrid.build(
        np.array(waypoints, dtype=float).reshape(len(waypoints), -1),
        limits,
        first_s=first_s,
        step_s=step_s,
        longest_s=longest_s,
        batch=batch,
    )


def test_the_grid_starts_at_the_first_duration_and_ends_with_none():
    grid = grid_of([0.0, 1.0], one_joint(), first_s=0.3, step_s=0.2, longest_s=1.0)
    np.testing.assert_allclose(grid.times_s, [0.3, 0.5, 0.7, 0.9, 1.1, np.inf])
    assert grid_of([0.0, 1.0], one_joint(), first_s=0.3, step_s=0.2, longest_s=0.05).times_s.tolist() == [0.3, np.inf]


@pytest.mark.parametrize(
    ("limits", "least_s"),
    [
        (one_joint(velocity=1.0), 0.9),  # 1.5 d / t
        (one_joint(acceleration=4.0), np.sqrt(0.9)),  # 6 d / t^2
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_from_rest_to_rest_a_limit_is_met_exactly(limits, least_s, sign):
    rest = np.zeros((1, 2, 1))
    for share, found_s in ((1 - 1e-6, least_s * (1 - 1e-6) + 0.05), (1 + 1e-6, least_s * (1 + 1e-6))):
        grid = grid_of([0.0, sign * 0.6], limits, first_s=share * least_s)
        assert grid.shortest(rest)[0, 0] == pytest.approx(found_s)


@pytest.mark.parametrize("way", [0.5, -0.5])
@pytest.mark.parametrize("mirrored", [False, True])
def test_both_ends_accelerate_within_the_limit(mirrored, way):
    """From 1 /s to rest: 6 d / t^2 - 4 v / t at the start, -6 d / t^2 + 2 v / t at the end; or time backwards."""
    velocities = np.array([[[1.0], [0.0]]])
    if mirrored:
        velocities = velocities[:, ::-1]
    for t in (0.2, 0.5, 0.8):
        start, end = 6 * way / t**2 - 4 / t, -6 * way / t**2 + 2 / t
        most = max(abs(start), abs(end))
        for acceleration, kept in ((1.001 * most, True), (0.999 * most, False)):
            grid = grid_of([0.0, way], one_joint(acceleration=acceleration), first_s=t, longest_s=t)
            assert (grid.shortest(velocities)[0, 0] == t) == kept
        motion = Trajectory.hermite([0.0, t], [[0.0], [way]], velocities[0])
        found = [abs(motion(when, 2)[0]) for when in (0.0, np.nextafter(t, 0))]
        assert max(found) == pytest.approx(most)


def test_a_velocity_between_the_ends_counts_and_so_does_one_at_an_end():
    """1.5 d / t - (v0 + v1) / 4 in the middle, where both ends are as fast."""
    both = np.full((1, 2, 1), 0.4)
    peak = 1.5 * 0.6 / 1.0 - 0.2
    for velocity, kept in ((1.001 * peak, True), (0.999 * peak, False)):
        grid = grid_of([0.0, 0.6], one_joint(velocity=velocity), first_s=1.0, longest_s=1.0)
        assert (grid.shortest(both)[0, 0] == 1.0) == kept
    for velocity, kept in ((0.401, True), (0.399, False)):
        for ends in ([0.4, 0.0], [0.0, 0.4], [-0.4, 0.0], [0.0, -0.4]):
            grid = grid_of([0.0, 0.0], one_joint(velocity=velocity), first_s=1.0, longest_s=1.0)
            assert (grid.shortest(np.array(ends)[None, :, None])[0, 0] == 1.0) == kept


def test_every_segment_of_every_plan_in_a_batch_is_told_by_itself():
    rng = np.random.default_rng(0)
    waypoints = rng.uniform(-0.3, 0.3, (4, 3))
    limits = MotionLimits(np.array([0.5, 0.7, 0.9]), np.array([2.0, 3.0, 4.0]))
    velocities = 0.3 * rng.uniform(-1, 1, (5, 4, 3))
    found = grid_of(waypoints, limits, batch=5).shortest(velocities)
    assert found.shape == (5, 3) and np.isfinite(found).sum() > 10 and len(np.unique(found)) > 4
    for plan, segment in np.ndindex(5, 3):
        alone = grid_of(waypoints[segment : segment + 2], limits)
        assert alone.shortest(velocities[plan, None, segment : segment + 2])[0, 0] == found[plan, segment]


def test_where_no_duration_will_do_there_is_none():
    grid = grid_of([0.0, 1.0], one_joint(velocity=0.1), longest_s=1.0)
    assert grid.shortest(np.zeros((1, 2, 1)))[0, 0] == np.inf
    fast = grid_of([0.0, 0.0], one_joint(velocity=0.1))
    assert fast.shortest(np.full((1, 2, 1), 0.2))[0, 0] == np.inf  # faster at its ends than is allowed


def test_the_extreme_of_a_quadratic_by_its_hull():
    v0, middle, v1 = (np.array(column) for column in zip((0, 1, 0), (1, 3, 2), (0, 1, 2), (0, -2, 1), strict=True))
    s = np.linspace(0, 1, 100001)
    curves = v0 * (1 - s[:, None]) ** 2 + 2 * middle * s[:, None] * (1 - s[:, None]) + v1 * s[:, None] ** 2
    found = _peak(v0.astype(float), middle.astype(float), v1.astype(float))
    np.testing.assert_allclose(found[[0, 1, 3]], [0.5, curves[:, 1].max(), curves[:, 3].min()], atol=1e-9)
    assert found[2] == 0.0  # a straight line has no extreme inside
    assert _peak(*(np.array([x]) for x in (0.0, 1.0, 1.5)))[0] == 0.0  # rises all the way
    assert _peak(*(np.array([x]) for x in (1.5, 1.0, 0.0)))[0] == 1.5  # falls all the way
