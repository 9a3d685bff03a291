import numpy as np
import pytest

from made_up_gripper import kinematics, of_its_kind
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.debridement.pose import ErrorFilter, HeldError, PaperAdjustment, PosePairs, RawKinematics
from trocar.tasks.debridement.pose.evaluate import replay

ALL = pytest.mark.parametrize("make", [RawKinematics, PaperAdjustment, HeldError, ErrorFilter])
LEARNING = pytest.mark.parametrize("make", [PaperAdjustment, HeldError, ErrorFilter])


def predictions(make, pairs, horizon_s=1.0):
    return {
        k: estimator.estimate(pairs.times_s[k], pairs.T_base_kinematic[k]).matrix
        for k, _, estimator in replay(make, pairs, horizon_s)
    }


@ALL
def test_without_detections_the_estimate_is_the_kinematics(make):
    t, kinematic = kinematics(np.random.default_rng(1), 20)
    estimator = make()
    for i in range(20):
        assert np.allclose(estimator.estimate(t[i], kinematic[i]).matrix, kinematic[i].matrix, atol=1e-15)
        estimator.update(t[i], kinematic[i], None)


@ALL
def test_estimating_changes_nothing(make):
    pairs = of_its_kind(np.random.default_rng(2), 12).pairs
    asked, silent = make(), make()
    for i in range(11):
        for estimator in (asked, silent):
            estimator.update(pairs.times_s[i], pairs.T_base_kinematic[i], pairs.T_base_detected[i])
        asked.estimate(pairs.times_s[i] + 9.0, pairs.T_base_kinematic[0])
    last = pairs.times_s[11], pairs.T_base_kinematic[11]
    assert np.array_equal(asked.estimate(*last).matrix, silent.estimate(*last).matrix)


@ALL
def test_later_pairs_never_change_earlier_predictions(make):
    rng = np.random.default_rng(3)
    pairs = of_its_kind(rng, 30).pairs
    cut, horizon_s = 20, 1.0
    # Other detections after what may be known at the cut, and other kinematics after it.
    detected, kinematic = pairs.T_base_detected.matrix.copy(), pairs.T_base_kinematic.matrix.copy()
    hidden = np.flatnonzero(pairs.times_s > pairs.times_s[cut] - horizon_s)[0]
    detected[hidden:] = (SE3.exp(rng.normal(0, 0.5, 6)) @ SE3(detected[hidden:])).matrix
    kinematic[cut + 1 :] = (SE3.exp(rng.normal(0, 0.5, 6)) @ SE3(kinematic[cut + 1 :])).matrix
    other = PosePairs(pairs.times_s, SE3(detected), SE3(kinematic))
    before, after = predictions(make, pairs), predictions(make, other)
    for k in [k for k in before if k <= cut]:
        assert np.array_equal(before[k], after[k]), k
    if make is not RawKinematics:
        assert not np.allclose(before[29], after[29])


@LEARNING
def test_time_that_runs_backwards_is_refused(make):
    estimator = make()
    estimator.update(1.0, SE3.identity(), SE3.identity())
    with pytest.raises(TrocarError, match=r"at 0\.5 s came after one at 1\.0 s"):
        estimator.estimate(0.5, SE3.identity())
    with pytest.raises(TrocarError, match="at nan s came"):
        make().update(float("nan"), SE3.identity(), None)


def test_the_papers_rule_has_an_arm_at_rest_where_it_was_detected_and_adjusts_only_its_motion():
    """While the arm moves the adjustments learn shifts that an arm at rest does not make."""
    pairs = of_its_kind(np.random.default_rng(5), 20).pairs
    rule = PaperAdjustment()
    for i in range(20):
        rule.update(pairs.times_s[i], pairs.T_base_kinematic[i], pairs.T_base_detected[i])
    kinematic, detected = pairs.T_base_kinematic[19], pairs.T_base_detected[19]
    assert np.linalg.norm((rule.T_left @ rule.T_right).translation_m) > 5e-4
    assert np.array_equal(rule.estimate(pairs.times_s[19] + 3.0, kinematic).matrix, detected.matrix)
    step = SE3.from_parts(translation_m=(0.0, 0.0, 0.010))
    expected = detected @ rule.T_left @ step @ rule.T_right
    assert np.allclose(rule.settled(kinematic @ step).matrix, expected.matrix, atol=1e-12)
