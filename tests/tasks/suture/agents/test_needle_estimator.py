"""The estimates of arm and needle."""

import numpy as np
import pytest

from trocar.arms import ik_unbounded, jacobian
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.agents.needle_estimator import (
    CAMERA,
    CLOSING,
    DOUBT,
    FADES_M,
    FADING_SD,
    FLAT,
    FLAT_SD,
    FLEES_S,
    FLEETING,
    LASTING_SD,
    LOADED,
    MOST_PLACES,
    NEEDLE,
    TAKING,
    NeedleEstimate,
    NeedleEstimator,
    alike,
)
from trocar.tasks.suture.perception import NeedleSighting
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.task import CircleSutures

SETUP = CircleSutures().setup
HELD = grasp_pose(SETUP).inverse()
BACK = (SE3.from_parts(SO3.axis("z", -SETUP.insertion.regrasp_rad)) @ grasp_pose(SETUP)).inverse()
TIP = SE3.from_parts(SO3.exp([2.8, 0.4, -0.3]), [0.01, -0.02, -0.12])
BY_JOINTS = jacobian(SETUP.arm, ik_unbounded(SETUP.arm, TIP))
SHARP = NeedleSighting(SE3.identity(), np.diag(np.repeat([1.0 / 0.03e-3**2, 1.0 / 0.003**2], 3)), 100, 1e-4)


def seen_at(T):
    return NeedleSighting(T, SHARP.information, SHARP.pixels, SHARP.depth_sd_m)


def loaded(time_s=0.0):
    estimator = NeedleEstimator(SETUP.arm, lambda: time_s)
    estimator.loaded(HELD)
    return estimator


def beside(T_base_tip, x_m):
    return SE3.from_parts(translation_m=[x_m, 0.0, 0.0]) @ T_base_tip


def sd(estimate):
    return np.sqrt(np.diag(estimate.covariance))


def test_nothing_is_off_before_a_look_and_much_may_be():
    estimate = loaded().needle(TIP)
    np.testing.assert_allclose(estimate.T_base_needle.matrix, (TIP @ HELD).matrix, atol=1e-12)
    assert (sd(estimate)[:3] > 0.3e-3).all()


def test_a_look_is_taken_over_and_a_wild_one_is_not():
    estimator = loaded()
    off = SE3.exp([0.4e-3, -0.3e-3, 0.2e-3, 0.03, -0.02, 0.04])
    true = estimator.needle(TIP).T_base_needle @ off
    assert estimator.update(TIP, SE3.identity(), seen_at(true))
    left = (estimator.needle(TIP).T_base_needle.inverse() @ true).log()
    assert np.abs(left[:3]).max() < 0.03e-3 and np.abs(left[3:]).max() < 0.003
    said = np.hypot(np.repeat([0.03e-3, 0.003], 3), np.sqrt(np.diag(CAMERA)))
    assert (sd(estimator.needle(TIP)) <= 1.01 * said).all(), "a sighting is no surer than the camera's place"
    assert (sd(estimator.needle(TIP))[:3] > 0.1e-3).all()
    before = estimator.needle(TIP).T_base_needle.matrix
    assert not estimator.update(TIP, SE3.identity(), seen_at(true @ SE3.from_parts(translation_m=[0.0, 3e-3, 0.0])))
    np.testing.assert_array_equal(estimator.needle(TIP).T_base_needle.matrix, before)


def test_far_away_what_was_seen_of_the_arm_does_not_count_but_how_the_needle_lies_does():
    estimator = loaded()
    estimator.update(TIP, SE3.identity(), seen_at(estimator.needle(TIP).T_base_needle @ SE3.exp([0, 0, 0, 0.08, 0, 0])))
    lies, off, far = estimator.T_tip_needle, estimator.tip_error(TIP), beside(TIP, 0.05)
    assert np.linalg.norm(estimator.tip_error(far)[3:]) < 0.5 * np.linalg.norm(off[3:])
    np.testing.assert_allclose(estimator.T_tip_needle.matrix, lies.matrix)
    tip_sd = np.sqrt(np.diag(BY_JOINTS @ np.diag(FADING_SD**2) @ BY_JOINTS.T))
    assert np.linalg.norm(sd(estimator.needle(far))[:3]) > 0.8 * np.linalg.norm(tip_sd[:3])


def test_errors_of_the_joints_are_alike_where_and_when_the_jaws_are_near():
    place = np.array([[0.0, 0.0, 0.1, 5.0]])
    there = np.array([[0.0, 3e-3, 0.1, 5.0], [0.0, 0.0, 0.1, 5.0 + FLEES_S]])
    np.testing.assert_allclose(alike(place, there)[:, 0, 0], np.exp(-3e-3 / FADES_M))
    np.testing.assert_allclose(alike(place, there)[:, 0, 1], 1.0 - FLEETING * (1.0 - np.exp(-1.0)))
    assert (alike(place, place) == 1.0).all()


def test_jaws_that_come_back_err_as_they_did_there():
    """What was seen at a place counts there again, after a look elsewhere, and more than at places not seen."""
    estimator = loaded()
    for T in (TIP, beside(TIP, 10e-3)):
        off = SE3.exp([3e-4, 2e-4, 0, 0.03, 0.01, 0]) if T is TIP else SE3.identity()
        assert estimator.update(T, SE3.identity(), seen_at(T @ HELD @ off))
    seen, elsewhere = sd(estimator.needle(TIP)), sd(estimator.needle(beside(TIP, -10e-3)))
    assert (seen[:3] < 0.15e-3).all() and (elsewhere[:3] > 1.5 * seen[:3]).any()
    left = (estimator.needle(TIP).T_base_needle.inverse() @ TIP @ HELD @ SE3.exp([3e-4, 2e-4, 0, 0.03, 0.01, 0])).log()
    assert (np.abs(left) < 2.0 * seen).all()


def test_what_is_seen_of_a_resting_needle_tells_how_the_jaws_held_it():
    """The arm's error at the place where it let go is less uncertain then."""
    estimator = loaded()
    estimator.update(TIP, SE3.identity(), seen_at(TIP @ HELD))
    there = beside(TIP, 15e-3)
    before = estimator._tip_parts(there)
    spread = before[0] @ estimator._covariance @ before[0].T + before[1]
    estimator.released(there)
    assert estimator.rests and estimator.update(
        there, SE3.identity(), seen_at(there @ HELD @ SE3.exp([0, 0, 0, 0.02, 0, 0]))
    )
    after = estimator._tip_parts(there)
    left = after[0] @ estimator._covariance @ after[0].T + after[1]
    assert np.trace(left[3:, 3:]) < 0.8 * np.trace(spread[3:, 3:])
    assert np.abs(estimator.tip_error(there)[3:]).max() > 0.005


def test_only_the_last_places_are_kept():
    estimator = loaded()
    for number in range(MOST_PLACES + 3):
        T = beside(TIP, 1e-3 * number)
        estimator.update(T, SE3.identity(), seen_at(estimator.needle(T).T_base_needle))
    assert len(estimator._mean) == 12 + 6 * MOST_PLACES
    assert np.linalg.eigvalsh(estimator._covariance).min() > -1e-9
    estimator.loaded(HELD)
    assert len(estimator._mean) == 12


def of_grasp(estimator, covariance):
    """Return a twist's covariance of the needle in the axes of the grasp."""
    to_grasp = np.linalg.inv(estimator._T_needle_grasp().adjoint())
    return to_grasp @ covariance @ to_grasp.T


@pytest.mark.parametrize("T_tip_needle", [HELD, BACK], ids=["first grip", "regrasped"])
def test_the_axes_of_a_grasp_are_the_jaws_closing_axis_and_the_wire(T_tip_needle):
    estimator, held_at = loaded(), T_tip_needle.inverse()
    estimator.loaded(T_tip_needle)
    T_needle_grasp = estimator._T_needle_grasp()
    closing, along, _ = T_needle_grasp.rotation.matrix.T
    np.testing.assert_allclose(T_needle_grasp.translation_m, held_at.translation_m)
    np.testing.assert_allclose(closing, held_at.rotation.matrix[:, 0], atol=1e-12)
    assert along[2] == pytest.approx(0.0, abs=1e-9), "the wire lies in the needle's plane"
    assert along @ held_at.translation_m == pytest.approx(0.0, abs=1e-9), "and is at right angles to its radius"


def test_flat_jaws_fix_two_of_six_and_leave_a_person_the_others():
    estimator = loaded()
    left = np.sqrt(np.diag(of_grasp(estimator, estimator._covariance[NEEDLE, NEEDLE])))
    given = np.sqrt(np.diag(LOADED))
    np.testing.assert_allclose(left[FLAT], given[FLAT] * FLAT_SD / np.hypot(given[FLAT], FLAT_SD))
    others = np.setdiff1d(np.arange(6), FLAT)
    np.testing.assert_allclose(left[others], given[others])


def test_closing_jaws_move_a_needle_that_the_tissue_holds_and_what_was_known_of_it_counts_on(monkeypatch):
    monkeypatch.setattr("trocar.tasks.suture.agents.needle_estimator.FLAT_SD", np.array([1e3, 1e3]))
    estimator = loaded()
    estimator.update(
        TIP, SE3.identity(), seen_at(estimator.needle(TIP).T_base_needle @ SE3.exp([3e-4, 2e-4, 0, 0.02, 0.03, 0.0]))
    )
    held = estimator.needle(TIP)
    moved = TIP @ HELD @ BACK.inverse() @ SE3.exp([1e-3, 0, 0, 0, 0.02, 0])
    estimator.released(TIP)
    estimator.regrasped(moved, BACK)
    after = estimator.needle(moved)
    assert np.abs((after.T_base_needle.inverse() @ held.T_base_needle).log()).max() < 1e-4
    added = of_grasp(estimator, after.covariance - held.covariance)
    scale = np.sqrt(np.diag(CLOSING + LOADED))
    assert np.abs((added - CLOSING) / np.outer(scale, scale)).max() < 0.02


def test_closing_jaws_turn_a_needle_in_the_tissue_about_its_tip():
    held, moved = TIP @ HELD, TIP @ HELD @ BACK.inverse()
    p_tip = SETUP.needle.p_tip_m
    lever = np.column_stack([np.eye(3), np.cross(np.eye(3), p_tip).T])
    aside_mm = {}
    for name, closing in {"tissue": CLOSING, "elsewhere": TAKING}.items():
        estimator = loaded()
        estimator.resting(NeedleEstimate(held, np.diag(np.repeat([1e-6, 1e-5], 3) ** 2)))
        estimator.regrasped(moved, BACK, closing)
        covariance = estimator.needle(moved).covariance
        aside_mm[name] = 1e3 * np.sqrt((lever @ covariance @ lever.T)[2, 2])
        assert 1e3 * np.sqrt(covariance[2, 2]) > 0.08, "the rest of the needle goes aside"
    assert aside_mm["tissue"] < 0.08
    assert aside_mm["elsewhere"] > 0.11


def test_a_needle_in_the_tissue_that_was_seen_elsewhere_is_less_sure():
    held = NeedleEstimate(TIP @ HELD, np.diag(np.repeat([1e-4, 0.01], 3) ** 2))
    far = seen_at(held.T_base_needle @ SE3.from_parts(translation_m=[3e-3, 0.0, 0.0]))
    assert held.updated(SE3.identity(), far) is None
    less_sure = NeedleEstimate(held.T_base_needle, DOUBT**5 * held.covariance)
    assert less_sure.updated(SE3.identity(), far) is not None


def test_a_regrasped_needle_stays_where_it_was_and_flat_jaws_tell_of_it():
    estimator = loaded()
    true = estimator.needle(TIP).T_base_needle @ SE3.exp([0.3e-3, 0.2e-3, 0.0, 0.02, 0.03, 0.0])
    estimator.update(TIP, SE3.identity(), seen_at(true))
    held = estimator.needle(TIP)
    moved = TIP @ HELD @ BACK.inverse()  # the jaws go along the wire; as planned the needle stays
    estimator.released(TIP)
    estimator.released(TIP)  # jaws that are open already change nothing
    estimator.regrasped(moved, BACK)
    after = estimator.needle(moved)
    left = (after.T_base_needle.inverse() @ held.T_base_needle).log()
    assert np.abs(left[:3]).max() < 0.3e-3 and np.abs(left[3:]).max() < 0.03
    assert (sd(after)[:3] < 0.6e-3).all()


def test_the_errors_add_up_as_they_are_drawn():
    """Its covariance is that of needles whose errors are drawn and put together exactly."""
    estimator, rng = loaded(), np.random.default_rng(0)
    drawn = []
    for _ in range(3000):
        off = LASTING_SD * rng.standard_normal(6) + BY_JOINTS @ (FADING_SD * rng.standard_normal(6))
        tip = SE3.from_parts(SO3.exp(off[3:]) @ TIP.rotation, TIP.translation_m + off[:3])
        drawn.append(((TIP @ HELD).inverse() @ tip @ HELD).log())
    before = estimator.needle(TIP).covariance
    surely = NeedleEstimator(SETUP.arm, lambda: 0.0)
    surely._T_tip_needle_planned = HELD  # no error of the grip
    np.testing.assert_allclose(np.sqrt(np.diag(surely.needle(TIP).covariance)), np.std(drawn, axis=0), rtol=0.08)
    assert (np.diag(before) > np.diag(surely.needle(TIP).covariance)).all()


def test_a_wild_sighting_that_comes_again_is_believed_in_the_end():
    estimator = loaded()
    estimator.update(TIP, SE3.identity(), seen_at(estimator.needle(TIP).T_base_needle))
    far = seen_at(estimator.needle(TIP).T_base_needle @ SE3.from_parts(translation_m=[0.0, 1e-3, 0.0]))
    estimate = [estimator.update(TIP, SE3.identity(), far) for _ in range(6)]
    assert not estimate[0] and estimate[-1]
