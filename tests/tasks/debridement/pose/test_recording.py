"""The targets, on pairs of a real Raven II arm; skipped if the recording is missing."""

import numpy as np
import pytest

from trocar.tasks.debridement.pose import ErrorFilter, PaperAdjustment, RawKinematics, read_pairs
from trocar.tasks.debridement.pose.evaluate import HORIZONS_S, detection_noise, prediction_errors, ratio_of_means


@pytest.fixture(scope="module")
def pairs(recordings):
    path = recordings / "raven" / "gripper_pose_pairs.csv"
    if not path.is_file():
        pytest.skip(f"the pairs of the Raven's gripper are not at {path}; set TROCAR_DATA to the folder above raven/")
    return read_pairs(path)


def test_the_angles_are_read_in_the_order_in_which_the_sources_agree(pairs):
    apart = pairs.T_base_detected.rotation @ pairs.T_base_kinematic.rotation.inverse()
    assert len(pairs) >= 60
    assert np.degrees(apart.angle().mean()) < 30  # with yaw first, 120


def test_at_one_second_the_filter_errs_at_least_30_percent_less_than_the_papers_rule(pairs):
    ours, papers = (prediction_errors(make, pairs, 1.0) for make in (ErrorFilter, PaperAdjustment))
    ratio = ratio_of_means(ours.translation_m, papers.translation_m, np.random.default_rng(1))
    assert ratio.value < 0.7
    assert ratio.high < 0.8
    assert ratio_of_means(ours.rotation_rad, papers.rotation_rad, np.random.default_rng(1)).high < 0.95
    rms_m = np.sqrt(np.mean([ours.translation_m**2, papers.translation_m**2], axis=1))
    assert rms_m[0] < 0.7 * rms_m[1]


@pytest.mark.parametrize("horizon_s", HORIZONS_S)
def test_the_papers_rule_errs_less_than_the_kinematics_and_the_filter_less_than_both(pairs, horizon_s):
    raw, papers, ours = (prediction_errors(m, pairs, horizon_s) for m in (RawKinematics, PaperAdjustment, ErrorFilter))
    for field in ("translation_m", "rotation_rad"):
        errors = [getattr(found, field) for found in (raw, papers, ours)]
        assert ratio_of_means(errors[1], errors[0], np.random.default_rng(1)).high < 0.8
        assert ratio_of_means(errors[2], errors[1], np.random.default_rng(1)).high < 1.0


def test_the_filter_is_not_better_than_the_camera(pairs):
    # A guard against peeking: what nobody can know of a detection is its own noise.
    floor_m = np.sqrt(np.trace(detection_noise(pairs)))
    error_m = prediction_errors(ErrorFilter, pairs, 1.0).translation_m
    assert floor_m < np.sqrt(np.mean(error_m**2)) < 2.2 * floor_m
