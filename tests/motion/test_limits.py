import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits
from trocar.motion import limit_use
from trocar.trajectory import Trajectory

ARM = ARMS["psm-classic"]
LIMITS = MOTION_LIMITS["paper"]


def test_ratios_of_a_cubic_known_in_closed_form():
    step, t = np.array([0.3, 0, 0, 0, 0, 0]), 0.8
    trajectory = Trajectory.hermite([0, t], ARM.middle + np.outer([0, 1], step), np.zeros((2, 6)))
    use = limit_use(ARM, trajectory, LIMITS)
    assert use.velocity_ratio == pytest.approx(1.5 * 0.3 / t / LIMITS.velocity[0], rel=1e-12)
    assert use.acceleration_ratio == pytest.approx(6 * 0.3 / t**2 / LIMITS.acceleration[0], rel=1e-12)
    assert not use.range_excess.any()


def test_both_sides_of_a_knot_are_seen():
    """The acceleration before a knot is the largest here, and no sample on the right of any knot shows it."""
    coefficients = np.zeros((3, 2, 6))
    coefficients[2] = ARM.middle
    jerky = np.zeros((4, 2, 6))
    jerky[1:] = coefficients
    jerky[0, 0, 0] = 1.0  # q = t^3 on the first piece, so 6 t of acceleration just before its end
    use = limit_use(ARM, Trajectory(np.array([0, 0.10005, 0.5]), jerky), MotionLimits(np.ones(6), np.ones(6)))
    assert use.acceleration_ratio == pytest.approx(6 * 0.10005, rel=1e-12)


def test_range_is_checked_between_knots():
    q = np.tile(ARM.middle, (2, 1))
    q[:, 2] = ARM.upper[2] - 0.001
    velocity = np.zeros((2, 6))
    velocity[:, 2] = 0.2, -0.2
    use = limit_use(ARM, Trajectory.hermite([0, 0.4], q, velocity), LIMITS)
    assert use.range_excess[2] == pytest.approx(0.2 * 0.4 / 4 - 0.001, abs=1e-9)
    assert not use.kept
