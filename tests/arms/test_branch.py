"""The branches of the inverse kinematics are what their signs say."""

from itertools import product

import numpy as np

from trocar.arms import BRANCHES, PSM_CLASSIC, fk, ik_branches
from trocar.arms.branch import Branch


def test_every_combination_of_signs_is_a_branch_in_the_order_of_the_solutions():
    assert set(BRANCHES) == {Branch(*signs) for signs in product((1, -1), repeat=3)} and len(BRANCHES) == 8
    arm = PSM_CLASSIC
    q, real = ik_branches(arm, fk(arm, np.random.default_rng(0).uniform(arm.lower, arm.upper, (20, 6))))
    assert real.all()
    turned = q + arm.offsets
    signs = np.sign([np.cos(turned[..., 5]), np.cos(turned[..., 4]), np.sin(turned[..., 1])])
    for number, branch in enumerate(BRANCHES):
        assert (signs[:, :, number] == np.array(branch)[:, None]).all(), branch
