"""Motions for calibration recordings."""

import numpy as np
import pytest

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX, WIDE_ROWS, random_smooth_path, wide_path
from trocar.errors import TrocarError

WIDEST_PLAY_RAD = 2 * 0.128


@pytest.mark.parametrize("box", [PSM1_BOX, PSM2_BOX])
@pytest.mark.parametrize("rows", [2, 35, WIDE_ROWS, 128])
def test_a_wide_path_stays_in_its_box_and_is_the_same_each_time(box, rows):
    path = wide_path(PSM_CLASSIC, rows, box)
    assert path.shape == (rows, 6)
    assert (box.lower <= path).all() and (path <= box.upper).all()
    assert np.array_equal(path, wide_path(PSM_CLASSIC, rows, box))


def test_a_wide_path_swings_the_wrist_through_its_play_and_moves_the_outer_joints_slowly():
    path, smooth = wide_path(PSM_CLASSIC), random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), WIDE_ROWS)
    steps = np.abs(np.diff(path, axis=0))
    assert (np.mean(steps[:, 3:] > WIDEST_PLAY_RAD, axis=0) > 0.75).all()
    assert np.mean(np.abs(np.diff(smooth, axis=0))[:, 3:] > WIDEST_PLAY_RAD) < 0.1
    assert (steps[:, :3].max(axis=0) < 0.15 * (PSM1_BOX.upper - PSM1_BOX.lower)[:3]).all()
    assert (np.ptp(path, axis=0) > 0.9 * (PSM1_BOX.upper - PSM1_BOX.lower)).all()


def test_a_path_that_is_none_is_refused():
    for path in (wide_path, lambda arm, n: random_smooth_path(arm, np.random.default_rng(0), n)):
        for n in (1, 10**9):
            with pytest.raises(TrocarError, match=f"cannot have {n} samples; ask for 2 to 100000"):
                path(PSM_CLASSIC, n)
    far = type(PSM1_BOX)(PSM1_BOX.lower - 5.0, PSM1_BOX.upper, PSM1_BOX.step)
    with pytest.raises(TrocarError, match="joint 'yaw' is not inside"):
        wide_path(PSM_CLASSIC, 10, far)
