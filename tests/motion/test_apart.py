"""The quick proof that arms stay apart never promises more than the exact distance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import PSM_CLASSIC, RAVEN2_LEFT
from trocar.geometry import SE3
from trocar.motion import MovingArm, swept_clearance
from trocar.motion.apart import Apart
from trocar.trajectory import Trajectory

JAW_RAD = 0.4


def moving(rng, arm, spread, T_world_base=None):
    """Return an arm on a random motion, and at rest near its start with its jaws elsewhere."""
    middle, half = (arm.lower + arm.upper) / 2, (arm.upper - arm.lower) / 2
    start = middle + half * rng.uniform(-0.5, 0.5, 6)
    knots = start + half * rng.uniform(-spread, spread, (3, 6))
    motion = Trajectory.hermite([0.0, 0.4, 1.0], knots, half * rng.uniform(-1.0, 1.0, (3, 6)) * spread)
    before = MovingArm.resting(arm, start, T_world_base, rng.uniform(0.0, 1.0))
    return before, MovingArm(arm, motion, before.T_world_base, jaw_rad=rng.uniform(0.0, 1.0))


@pytest.mark.parametrize("arm", [PSM_CLASSIC, RAVEN2_LEFT], ids=lambda arm: arm.name)
@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.001, 0.02, 0.2]))
def test_bound_lies_below_the_exact_distance(arm, seed, spread):
    rng = np.random.default_rng(seed)
    T_world_right = SE3.exp(np.concatenate([rng.uniform(-0.3, 0.3, 3), rng.uniform(-1.0, 1.0, 3)]))
    (left, going), (right, coming) = moving(rng, arm, spread), moving(rng, arm, spread, T_world_right)
    apart = Apart.at({"left": left, "right": right}, 0.0)
    motions = {"left": going, "right": coming}
    bound_m, exact_m = apart.least_m(motions), swept_clearance(motions).sampled_m
    assert bound_m <= exact_m + 1e-9
    if exact_m > 0:  # not so low a bound that it proves nothing for short motions
        assert bound_m >= exact_m - 3.0 * spread - 0.05


def test_arms_where_they_were_are_as_far_apart_as_they_were():
    rng = np.random.default_rng(5)
    (left, _), (right, _) = (
        moving(rng, PSM_CLASSIC, 0.1),
        moving(rng, PSM_CLASSIC, 0.1, SE3.from_parts(None, [0.2, 0, 0])),
    )
    arms = {"left": left, "right": right}
    apart = Apart.at(arms, 0.0)
    assert apart.least_m(arms) == pytest.approx(swept_clearance(arms).sampled_m, abs=1e-9)


def test_only_the_jaws_opening_counts_too():
    q = (PSM_CLASSIC.lower + PSM_CLASSIC.upper) / 2
    left = MovingArm.resting(PSM_CLASSIC, q, None, 0.0)
    right = MovingArm.resting(PSM_CLASSIC, q, SE3.from_parts(None, [0.1, 0.0, 0.0]), 0.0)
    apart = Apart.at({"left": left, "right": right}, 0.0)
    wider = MovingArm.resting(PSM_CLASSIC, q, None, JAW_RAD)
    finger_m = PSM_CLASSIC.instrument.finger_length_m
    assert apart.least_m({"left": wider, "right": right}) == pytest.approx(apart.distance_m - finger_m * JAW_RAD / 2)


def test_one_arm_alone_meets_nothing():
    arm = MovingArm.resting(PSM_CLASSIC, (PSM_CLASSIC.lower + PSM_CLASSIC.upper) / 2)
    assert Apart.at({"psm1": arm}, 0.0).least_m({"psm1": arm}) == np.inf
