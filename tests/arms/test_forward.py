from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recounted import recounted
from trocar.arms import ARMS, PSM_CLASSIC, RAVEN2_LEFT, RAVEN2_RIGHT, fk, frames
from trocar.errors import TrocarError

ODD = recounted(replace(RAVEN2_LEFT, name="odd", twists_rad=(0.4, 1.2, 2.0), wrist_sign=-1))
"""Like no registered arm: its first twist is no right angle, and its wrist has offsets."""
arms = pytest.mark.parametrize("arm", [*ARMS.values(), ODD], ids=lambda arm: arm.name)
seeds = st.integers(0, 2**32 - 1)
PI = np.pi


def dh(a, alpha, d, theta):
    """One row of modified DH, written out."""
    ca, sa, ct, st_ = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [[ct, -st_, 0, a], [st_ * ca, ct * ca, -sa, -d * sa], [st_ * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]]
    )


def psm_table(q):
    """The eight rows of the PSM in modified DH (Hwang et al. 2022)."""
    rows = [
        (0, PI / 2, 0, q[0] + PI / 2),
        (0, -PI / 2, 0, q[1] - PI / 2),
        (0, PI / 2, q[2] - 0.4318 + 0.4162, 0),
        (0, 0, 0, q[3]),
        (0, -PI / 2, 0, q[4] - PI / 2),
        (0.0091, -PI / 2, 0, q[5] - PI / 2),
        (0, -PI / 2, 0.0095, 0),
        (0, PI, 0, PI),
    ]
    return np.linalg.multi_dot([dh(*row) for row in rows])


def raven_table(q, left):
    """The six rows of the Raven II in modified DH: frame 6, with its x axis along the jaws."""
    deg = np.radians
    rows = [
        (0, deg(0 if left else 180), 0, q[0] + deg(205 if left else 25)),
        (0, deg(75), 0, q[1] + deg(180 if left else 0)),
        (0, deg(128 if left else 52), q[2], deg(90 if left else -90)),
        (0, 0, -0.47, q[3]),
        (0, deg(90), 0, q[4] - deg(90)),
        (0.013, deg(90), 0, q[5]),
    ]
    return np.linalg.multi_dot([dh(*row) for row in rows])


@given(seed=seeds)
def test_the_psm_is_its_published_table(seed):
    q = np.random.default_rng(seed).uniform(PSM_CLASSIC.lower, PSM_CLASSIC.upper)
    np.testing.assert_allclose(fk(PSM_CLASSIC, q).matrix, psm_table(q), atol=1e-14)


@pytest.mark.parametrize(("arm", "left"), [(RAVEN2_LEFT, True), (RAVEN2_RIGHT, False)])
@given(seed=seeds)
def test_raven_is_its_published_table(arm, left, seed):
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper)
    frame, tip = raven_table(q, left), fk(arm, q).matrix
    np.testing.assert_allclose(tip[:3, 3], frame[:3, 3] + 0.010 * frame[:3, 0], atol=1e-14)
    np.testing.assert_allclose(tip[:3, 2], -frame[:3, 0], atol=1e-14)
    np.testing.assert_allclose(tip[:3, 1], -frame[:3, 2], atol=1e-14)


@arms
@settings(max_examples=25)
@given(seed=seeds)
def test_the_tip_is_the_last_frame_in_every_batch_shape(arm, seed):
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper, (2, 3, 6))
    T = fk(arm, q)
    assert T.matrix.shape == (2, 3, 4, 4)
    chain = frames(arm, q).matrix
    assert chain.shape == (2, 3, 8, 4, 4)
    np.testing.assert_allclose(chain[..., 7, :, :], T.matrix, atol=1e-14)
    np.testing.assert_array_equal(chain[..., 0, :, :], np.broadcast_to(np.eye(4), (2, 3, 4, 4)))
    np.testing.assert_allclose(fk(arm, q[1, 2]).matrix, T.matrix[1, 2], atol=1e-15)


@arms
@settings(max_examples=25)
@given(seed=seeds)
def test_the_shaft_passes_through_the_remote_centre(arm, seed):
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper)
    chain = frames(arm, q).matrix
    np.testing.assert_allclose(chain[1:3, :3, 3], 0.0, atol=1e-15)
    off_axis = np.cross(chain[4, :3, 3], chain[4, :3, 2])
    np.testing.assert_allclose(off_axis, 0.0, atol=1e-15)


@arms
@pytest.mark.parametrize("q", [np.zeros(5), np.full(6, np.nan), "abc", [[1, 2], [3]]])
def test_bad_joint_values_are_refused(arm, q):
    with pytest.raises(TrocarError, match=arm.name):
        fk(arm, q)
