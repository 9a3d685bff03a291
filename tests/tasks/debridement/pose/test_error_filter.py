import numpy as np
import pytest
from scipy.stats import chi2

from made_up_gripper import kinematics, of_another_kind, of_its_kind
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose import ErrorFilter, FilterSettings, HeldError, PaperAdjustment
from trocar.tasks.debridement.pose.evaluate import prediction_errors, replay

OFFSET_M, OFFSET_R = np.array([0.02, -0.005, 0.03]), SO3.exp([0.3, -0.2, 0.25])


def shifted(T):
    return SE3.from_parts(OFFSET_R @ T.rotation, T.translation_m + OFFSET_M)


def distance_m(T, other):
    return float(np.linalg.norm(T.translation_m - other.translation_m))


def fed(n, outlier=None, seed=1):
    """Return the filter after n detections with a constant offset, the times and kinematic poses; one more is free."""
    t, kinematic = kinematics(np.random.default_rng(seed), n + 1)
    estimator = ErrorFilter()
    for i in range(n):
        T_detected = shifted(kinematic[i])
        estimator.update(t[i], kinematic[i], outlier @ T_detected if outlier and i == n - 1 else T_detected)
    return estimator, t, kinematic


def test_a_constant_offset_is_recovered():
    estimator, t, kinematic = fed(60)
    T = estimator.estimate(t[60], kinematic[60])
    assert distance_m(T, shifted(kinematic[60])) < 0.0005
    assert (T.rotation.inverse() @ shifted(kinematic[60]).rotation).angle() < 0.005


def test_a_lag_is_recovered():
    # Detections that trail a steady motion by .5 s; the constant is nought.
    estimator, speed = ErrorFilter(), np.array([0.01, 0.0, -0.005])
    pose = lambda t: SE3.from_parts(translation_m=speed * max(0.0, t))  # noqa: E731
    for t in np.arange(-10, 10, 0.2):
        estimator.update(t, pose(t), pose(t - 0.5))
    assert distance_m(estimator.estimate(11.0, pose(11.0)), pose(10.5)) < 0.0005


def test_one_outlier_moves_it_little():
    outlier = SE3.exp([0.1, 0.1, 0.0, 1.0, 0.0, 0.0])
    clean, t, kinematic = fed(30)
    struck, _, _ = fed(30, outlier)
    assert distance_m(outlier @ shifted(kinematic[29]), shifted(kinematic[29])) > 0.1
    ours, theirs = (e.estimate(t[30], kinematic[30]) for e in (struck, clean))
    assert distance_m(ours, theirs) < 0.003
    assert (ours.rotation.inverse() @ theirs.rotation).angle() < 0.03


def test_a_jump_that_stays_is_followed():
    estimator, t, kinematic = fed(30)
    jump = SE3.from_parts(translation_m=[0.03, 0.0, 0.0])
    for i in range(1, 40):
        estimator.update(t[29] + 0.2 * i, kinematic[29], jump @ shifted(kinematic[29]))
    assert distance_m(estimator.estimate(t[29] + 8.0, kinematic[29]), jump @ shifted(kinematic[29])) < 0.005


def test_two_messages_of_one_image_count_as_little_more_than_one():
    once, t, kinematic = fed(10)
    twice, _, _ = fed(10)
    twice.update(t[9] + 0.001, kinematic[9], shifted(kinematic[9]))
    moment = t[10], kinematic[10]
    assert np.allclose(twice.belief(*moment).covariance, once.belief(*moment).covariance, rtol=0.03, atol=1e-9)


def test_it_grows_less_sure_with_time():
    estimator, t, kinematic = fed(20)
    traces = [np.trace(estimator.belief(t[20] + wait, kinematic[20]).covariance[:3, :3]) for wait in (0, 1, 5, 50)]
    assert traces == sorted(traces)


def test_the_noise_and_its_direction_are_learned():
    estimator = ErrorFilter()
    pairs = of_its_kind(np.random.default_rng(5), 400).pairs
    for i in range(400):
        estimator.update(pairs.times_s[i], pairs.T_base_kinematic[i], pairs.T_base_detected[i])
    noise = estimator.belief(pairs.times_s[-1], pairs.T_base_kinematic[-1]).detection_noise[:3, :3]
    variances, axes = np.linalg.eigh(noise)
    assert np.sqrt(variances[2]) == pytest.approx(0.0037, rel=0.2)
    assert abs(axes[:, 2] @ [0.24, 0.80, 0.55]) > 0.97
    assert variances[1] < 0.2 * variances[2]  # the first guess was 1, and lingers


def covered(kind, runs, horizon_s=1.0):
    """Return the share of true poses inside the stated 95 % regions, and how many were looked at."""
    inside = []
    for seed in range(runs):
        made = kind(np.random.default_rng(seed), 60)
        for k, _, estimator in replay(ErrorFilter, made.pairs, horizon_s):
            if k < 15 or k % 4:
                continue
            belief = estimator.belief(made.pairs.times_s[k], made.pairs.T_base_kinematic[k])
            T, true = belief.T_base_gripper, made.T_base_true[k]
            off = np.r_[true.translation_m - T.translation_m, (true.rotation @ T.rotation.inverse()).log()]
            inside.append(off @ np.linalg.solve(belief.covariance, off) <= chi2.ppf(0.95, 6))
    return np.mean(inside), len(inside)


def test_its_regions_cover_what_they_say_on_errors_of_its_kind():
    share, count = covered(of_its_kind, 30)
    assert count > 300
    assert 0.90 <= share <= 0.98


def test_its_regions_stay_careful_on_errors_of_another_kind():
    share, _ = covered(of_another_kind, 15)
    assert share >= 0.90


@pytest.mark.parametrize("kind", [of_its_kind, of_another_kind])
def test_it_beats_the_papers_rule_on_made_up_arms(kind):
    errors = {make: [] for make in (ErrorFilter, HeldError, PaperAdjustment)}
    for seed in range(5):
        pairs = kind(np.random.default_rng(seed), 60).pairs
        for make, found in errors.items():
            found.append(prediction_errors(make, pairs, 1.0).translation_m.mean())
    ours, held, papers = (np.mean(found) for found in errors.values())
    assert ours < 0.8 * papers
    assert ours < held


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_settings_outside_their_range_are_refused(value):
    with pytest.raises(TrocarError, match="drift_s is"):
        FilterSettings(drift_s=value)
