import numpy as np
import pytest

from trocar.arms import capsules
from trocar.errors import TrocarError
from trocar.motion import MovingArm
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PSM

LATE = Trajectory.hermite([0.5, 1.0, 2.5], FOUR[:3], 0.01 * np.ones((3, 6)))


@pytest.mark.parametrize("start_s", [0.0, 0.3, -0.7])
def test_its_trajectory_begins_at_its_start_on_the_callers_clock(start_s):
    arm = MovingArm(PSM, LATE, LEFT, start_s, jaw_rad=0.4)
    np.testing.assert_allclose(arm.knots_s, start_s + np.array([0.0, 0.5, 2.0]))
    assert arm.end_s == pytest.approx(start_s + 2.0)
    times = start_s + np.array([-1.0, 0.0, 0.5, 1.1, 3.0])
    wanted = LATE([0.0, 0.5, 1.0, 1.6, 9.0])
    np.testing.assert_allclose(arm.joints(times), wanted)
    np.testing.assert_allclose(arm.joints(times[1:4], 1), LATE([0.5, 1.0, 1.6], 1))
    np.testing.assert_allclose(arm.ends_m(times), capsules(PSM, wanted, 0.4).moved(LEFT).ends_m)
    assert repr(arm) == f"<MovingArm psm-classic from {start_s:.3f} s to {start_s + 2:.3f} s>"


def test_one_that_rests_is_always_where_it_is():
    arm = MovingArm.resting(PSM, FOUR[1], LEFT, 0.2)
    assert arm.start_s == 0.0 and 0 < arm.end_s < 0.01 and arm.jaw_rad == 0.2
    np.testing.assert_array_equal(arm.joints([-5.0, 0.0, 5.0]), np.tile(FOUR[1], (3, 1)))
    assert MovingArm(PSM, LATE).start_s == MovingArm(PSM, LATE).jaw_rad == 0.0
    assert MovingArm.resting(PSM, FOUR[1]).jaw_rad == 0.0


@pytest.mark.parametrize("given", [{"start_s": np.inf}, {"start_s": np.nan}, {"jaw_rad": np.nan}])
def test_times_and_jaws_are_finite(given):
    with pytest.raises(TrocarError, match="give finite numbers"):
        MovingArm(PSM, LATE, **given)


def test_it_has_as_many_joints_as_its_model():
    with pytest.raises(TrocarError, match="has 6 joints, its trajectory 5"):
        MovingArm(PSM, Trajectory([0.0, 1.0], np.zeros((1, 1, 5))))
