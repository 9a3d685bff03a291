import numpy as np
import pytest

from made_up_gripper import NOISE_M, of_its_kind
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.debridement.pose import PosePairs, RawKinematics
from trocar.tasks.debridement.pose.evaluate import Summary, detection_noise, prediction_errors, ratio_of_means, replay


class Diary:
    """Notes what it is given."""

    def __init__(self):
        self.given = []

    def update(self, t_s, T_base_kinematic, T_base_detected):
        self.given.append((t_s, T_base_detected is not None))

    def estimate(self, t_s, T_base_kinematic):
        return T_base_kinematic


def pairs_at(times_s):
    T = SE3.identity((len(times_s),))
    return PosePairs(np.array(times_s), T, T)


def test_detections_are_known_up_to_the_horizon_and_kinematics_up_to_the_target():
    told = {k: (last, diary.given) for k, last, diary in replay(Diary, pairs_at([0.0, 0.5, 1.0, 1.2, 4.0]), 1.0)}
    assert told[2] == (0, [(0.0, True), (0.5, False)])
    assert told[3] == (0, [(0.0, True), (0.5, False), (1.0, False)])
    assert told[4] == (3, [(0.0, True), (0.5, True), (1.0, True), (1.2, True)])
    assert list(told) == [2, 3, 4]


def test_errors_are_those_of_the_estimate():
    kinematic = SE3.identity((3,))
    detected = SE3.exp([[0, 0, 0, 0, 0, 0], [0.003, 0.004, 0, 0, 0, 0], [0, 0, 0, 0.2, 0, 0]])
    errors = prediction_errors(RawKinematics, PosePairs(np.array([0.0, 1.0, 2.5]), detected, kinematic), 1.0)
    assert errors.targets.tolist() == [1, 2]
    assert np.allclose(errors.ages_s, [1.0, 1.5])
    assert np.allclose(errors.translation_m, [0.005, 0.0])
    assert np.allclose(errors.rotation_rad, [0.0, 0.2])


def test_a_horizon_beyond_the_recording_is_refused():
    with pytest.raises(TrocarError, match="no pair 5"):
        prediction_errors(RawKinematics, pairs_at([0.0, 1.0]), 5.0)
    with pytest.raises(TrocarError, match="horizon is 0"):
        prediction_errors(RawKinematics, pairs_at([0.0, 1.0]), 0.0)


def test_a_summary_says_mean_rms_and_p95():
    assert Summary.of(np.array([3.0, 4.0])) == Summary(3.5, pytest.approx(12.5**0.5), pytest.approx(3.95))


def test_the_interval_holds_the_ratio_and_is_narrow_where_errors_go_together():
    rng = np.random.default_rng(1)
    reference = rng.uniform(1, 2, 60)
    same = ratio_of_means(0.5 * reference, reference, rng)
    assert (same.low, same.value, same.high) == pytest.approx((0.5, 0.5, 0.5))
    loose = ratio_of_means(rng.uniform(0.5, 1, 60), reference, rng)
    assert loose.low < loose.value < loose.high
    assert ratio_of_means(reference[:3], reference[:3], rng).value == 1.0


def test_the_noise_of_detections_is_measured():
    found = [detection_noise(of_its_kind(np.random.default_rng(seed), 200).pairs) for seed in range(3)]
    assert np.allclose(np.mean(found, 0), NOISE_M @ NOISE_M.T, atol=2.5e-6)
    with pytest.raises(TrocarError, match="no three images"):
        detection_noise(pairs_at([0.0, 1.0, 2.0]))
