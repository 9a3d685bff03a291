"""A Gaussian filter that estimates the errors of the arm's tip and of the needle in its jaws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trocar.arms import ArmModel, ik_unbounded, jacobian
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.perception import NeedleSighting

LASTING, NEEDLE = slice(0, 6), slice(6, 12)
"""Parts of the state: the tip's lasting error, and the needle's error, in the jaws or where it rests without them. The
joints' fading errors follow, six for each place where the arm has looked at the needle, released it or grasped it."""
LASTING_SD = np.repeat([0.25e-3, 0.010], 3)
"""SDs of the tip's lasting error, m and rad: what registration and fitted cables leave at difficulty `recorded`."""
FADING_SD = np.array([1.6e-3, 1.6e-3, 0.27e-3, 0.009, 0.027, 0.018])
"""SDs of the joints' fading errors, rad and m, likewise. Those of wrist pitch and yaw matter most: they shift the tip
as they turn it, so the place of a needle tells about its attitude, which is hardly seen."""
FADES_M = np.array([30e-3, 30e-3, 30e-3, 5e-3, 5e-3, 5e-3])
"""Distance between two places of the jaws at which the correlation of the joints' errors falls to 1/e. It does not
matter where the jaws were in between: back at a place, they err much as before. (In 96 sutures at `recorded`, the error
of yaw just before the exit correlated by .69 with that at the end of the rotation, 8 deg of push away, and by .23 with
that at the start of the push, 35 deg away; q1 and q2 by .98 and .75.)"""
FLEETING, FLEES_S = np.array([0.0, 0.0, 0.0, 0.2, 0.2, 0.2]), 1.5
"""Share of the variance that does not repeat at a place, and the time in which its correlation falls to 1/e."""
MOST_PLACES = 12
"""Maximum number of places in the state; older ones are forgotten."""
LOADED = np.diag(np.array([0.6e-3, 0.6e-3, 0.6e-3, 0.08, 0.09, 0.08]) ** 2)
"""How accurately a person loads a needle: covariance in the grasp's axes, which are the jaws' closing direction, along
the wire, and across both; shift, m, and rotation, rad."""
PIVOT_M = 16e-3
"""Closing jaws that push a needle aside rotate it about the part in the tissue, near its tip, this far away."""
ASIDE_SD_M = 0.35e-3
"""SD of how far closing jaws push a needle aside."""
_ASIDE = ASIDE_SD_M * np.array([1.0, 0.0, 0.0, 0.0, -1.0 / PIVOT_M, 0.0])
CLOSING = np.outer(_ASIDE, _ASIDE) + np.diag(np.array([0.0, 0.04e-3, 0.04e-3, 0.002, 0.003, 0.012]) ** 2)
"""Covariance of the twist by which closing jaws move a needle that the tissue holds. (In 190 grips at `recorded`, they
pushed the wire .34 mm aside, and its tip .05 mm.)"""
TAKING = np.outer(_ASIDE, _ASIDE) + np.diag(np.array([0.0, 0.1e-3, 0.1e-3, 0.005, 0.008, 0.045]) ** 2)
"""Likewise for a needle that a stand or other jaws hold."""
FLAT = np.array([0, 5])
FLAT_SD = np.array([0.09e-3, 0.02])
"""SDs with which flat jaws constrain the wire, m and rad: its shift along their closing direction, and its rotation
about the normal of wire and closing direction. (In the same grips, .07 mm and .015 rad.)"""
CAMERA = np.diag(np.repeat([0.1e-3, 0.0], 3) ** 2)
"""Covariance of the camera's position in the arm's base, m; all sightings share this error."""
DOUBT = 4.0
"""Factor by which ``NeedleEstimator.doubt`` multiplies variances, as after a rejected sighting."""
DOUBTS = 2
"""After this many rejections in a row of a needle in the jaws, the first estimate was wrong: all is discarded."""
UNLIKELY = float(chi2.ppf(0.999, 6))
"""Squared Mahalanobis distance that one sighting in a thousand exceeds by chance."""


@dataclass(frozen=True, eq=False)
class NeedleEstimate:
    """A pose with its uncertainty.

    Attributes:
        T_base_needle: pose of the needle in the arm's registered base.
        covariance: (6, 6) of a twist of the needle in its own frame, m and rad.
    """

    T_base_needle: SE3
    covariance: NDArray[np.float64]

    def updated(self, T_base_camera: SE3, seen: NeedleSighting) -> NeedleEstimate | None:
        """Return the estimate after a sighting that was fitted with this one as prior; None if it is an outlier."""
        T_base_needle = T_base_camera @ seen.T_camera_needle
        away = (self.T_base_needle.inverse() @ T_base_needle).log()
        known = np.linalg.inv(self.covariance)
        if away @ known @ away > UNLIKELY:
            return None
        registered = seen.information @ np.linalg.inv(np.eye(6) + CAMERA @ seen.information)
        return NeedleEstimate(T_base_needle, np.asarray(np.linalg.inv(known + registered), dtype=np.float64))


class NeedleEstimator:
    """A Gaussian filter over errors, as twists that are small enough to add up.

    The tip's error is a shift and a rotation about the tip, both in the base's axes. One part of it lasts for the whole
    session; the other comes from errors of the joints, which depend on where the jaws are, and on the time. The
    needle's error is a twist in its own frame: of its pose in the jaws or, while something else holds it, at rest.

    Args:
        arm: the arm.
        now_s: returns the time.
    """

    def __init__(self, arm: ArmModel, now_s: Callable[[], float]) -> None:
        self._arm, self._now_s = arm, now_s
        self._T_tip_needle_planned, self._T_base_resting = SE3.identity(), None
        self._begin()

    def _begin(self) -> None:
        """Start with no estimate, only the SDs of the errors."""
        self._doubts = 0
        self._places = np.zeros((0, 4))  # of the tip in the base, m, and the time there, s
        self._mean = np.zeros(12)
        self._covariance = np.diag(np.concatenate([LASTING_SD, np.zeros(6)]) ** 2)

    @property
    def rests(self) -> bool:
        """Return whether something other than the jaws holds the needle still."""
        return self._T_base_resting is not None

    def tip_error(self, T_base_tip: SE3) -> NDArray[np.float64]:
        """Return the expected error (6,) of a tip commanded to this pose: shift and rotation in the base's axes."""
        return np.asarray(self._tip_parts(T_base_tip)[0] @ self._mean)

    def loaded(self, T_tip_needle: SE3) -> None:
        """Start again, except for the tip's lasting error: a person has put the needle into the jaws near this pose."""
        self._T_tip_needle_planned, self._T_base_resting = T_tip_needle, None
        self._keep(np.arange(12))
        self._places = self._places[:0]
        self._forget_needle()
        self._closed(LOADED)

    def resting(self, needle: NeedleEstimate) -> None:
        """Note that something other than the jaws holds the needle still, about here in the arm's base."""
        self._T_base_resting = needle.T_base_needle
        self._forget_needle()
        self._covariance[NEEDLE, NEEDLE] = needle.covariance

    def released(self, T_base_tip: SE3) -> None:
        """Account for the jaws opening: from now on, something else holds the needle where they held it."""
        if self.rests:
            return
        self._visit(T_base_tip)
        of_needle, needle = self._of_needle(T_base_tip)[0], self.needle(T_base_tip)
        self._mix(of_needle)
        self._mean[NEEDLE], self._T_base_resting = 0.0, needle.T_base_needle

    def regrasped(self, T_base_tip: SE3, T_tip_needle: SE3, closing: NDArray[np.float64] = CLOSING) -> None:
        """Account for the jaws closing here, in the planned grasp, on a resting needle, which this moves a little."""
        self._visit(T_base_tip)
        needle = self.needle(T_base_tip).T_base_needle
        self._T_tip_needle_planned, self._T_base_resting = T_tip_needle, None
        of_tip, _ = self._of_tip(T_base_tip)
        offset = ((T_base_tip @ T_tip_needle).inverse() @ needle).log() - of_tip @ self._mean
        lies = -of_tip
        lies[:, NEEDLE] = np.eye(6)
        self._mix(lies)
        self._mean[NEEDLE] = offset
        self._closed(closing)

    def needle(self, T_base_tip: SE3) -> NeedleEstimate:
        """Return the estimate of the needle while the tip is commanded to this pose."""
        of_needle, left = self._of_needle(T_base_tip)
        covariance = of_needle @ self._covariance @ of_needle.T + left
        if self._T_base_resting is not None:
            return NeedleEstimate(self._T_base_resting @ SE3.exp(self._mean[NEEDLE]), covariance)
        return NeedleEstimate(self.tip(T_base_tip) @ self.T_tip_needle, covariance)

    def tip(self, T_base_tip: SE3) -> SE3:
        """Return the estimate of the tip's pose while it is commanded to this one."""
        off = self.tip_error(T_base_tip)
        return SE3.from_parts(SO3.exp(off[3:]) @ T_base_tip.rotation, T_base_tip.translation_m + off[:3])

    @property
    def T_tip_needle(self) -> SE3:
        """Return the estimated pose of the needle in the jaws; as planned while something else holds the needle."""
        return self._T_tip_needle_planned @ SE3.exp(np.zeros(6) if self.rests else self._mean[NEEDLE])

    def update(self, T_base_tip: SE3, T_base_camera: SE3, seen: NeedleSighting) -> bool:
        """Update with a sighting that was fitted with :meth:`needle` as prior; return whether it was accepted.

        A sighting that lies further off than chance explains is rejected.
        """
        before = self.needle(T_base_tip)
        after = before.updated(T_base_camera, seen)
        if after is None:
            self.doubt()
            self._doubts += not self.rests
            if self._doubts == DOUBTS:
                self._begin()
                self._closed(LOADED)
            return False
        self._doubts = 0
        self._visit(T_base_tip)
        of_needle, _ = self._of_needle(T_base_tip)
        away = (before.T_base_needle.inverse() @ after.T_base_needle).log()
        # carries the change of the needle's estimate over to the whole state
        gain = self._covariance @ of_needle.T @ np.linalg.inv(before.covariance)
        self._mean = self._mean + gain @ away
        self._covariance = self._covariance - gain @ (before.covariance - after.covariance) @ gain.T
        return True

    def doubt(self) -> None:
        """Increase the variances: of the needle if it rests, or else of everything."""
        if self.rests:
            self._covariance[NEEDLE] *= np.sqrt(DOUBT)
            self._covariance[:, NEEDLE] *= np.sqrt(DOUBT)
        else:
            self._covariance *= DOUBT

    def _visit(self, T_base_tip: SE3) -> None:
        """Add the joints' errors here to the state."""
        here, left = self._fading(T_base_tip)
        grown = np.concatenate([np.eye(len(self._mean)), here])
        self._mean, self._covariance = grown @ self._mean, grown @ self._covariance @ grown.T
        self._covariance[-6:, -6:] += left
        self._places = np.concatenate([self._places, self._place(T_base_tip)[None]])
        if len(self._places) > MOST_PLACES:
            self._places = self._places[1:]
            self._keep(np.delete(np.arange(len(self._mean)), np.arange(12, 18)))

    def _place(self, T_base_tip: SE3) -> NDArray[np.float64]:
        return np.append(T_base_tip.translation_m, self._now_s())

    def _fading(self, T_base_tip: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the effect (6, n) of the state on the joints' errors here, and the covariance (6, 6) of the rest.

        The errors at the places of the state predict those here by Gaussian process regression, joint by joint.
        """
        here, alone = np.zeros((6, len(self._mean))), np.ones(6)
        if len(self._places):
            among = alike(self._places, self._places) + 1e-6 * np.eye(len(self._places))
            of_here = alike(self._places, self._place(T_base_tip)[None])[..., 0]
            shares = np.linalg.solve(among, of_here[..., None])[..., 0]  # (6, places)
            for joint, share in enumerate(shares):
                here[joint, 12 + joint :: 6] = share
            alone = np.maximum(1.0 - np.sum(shares * of_here, axis=1), 0.0)
        return here, np.diag(FADING_SD**2 * alone)

    def _tip_parts(self, T_base_tip: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the effect (6, n) of the state on the tip here, in the base's axes, and the covariance of the rest."""
        by_joints = jacobian(self._arm, ik_unbounded(self._arm, T_base_tip))
        here, left = self._fading(T_base_tip)
        found = by_joints @ here
        found[:, LASTING] = np.eye(6)
        return found, by_joints @ left @ by_joints.T

    def _of_tip(self, T_base_tip: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the effect (6, n) of the state on the needle by way of the tip, and the rest's covariance (6, 6)."""
        to_tip = np.kron(np.eye(2), T_base_tip.rotation.matrix.T)
        of_tip = self._T_tip_needle_planned.inverse().adjoint() @ to_tip
        found, left = self._tip_parts(T_base_tip)
        return of_tip @ found, of_tip @ left @ of_tip.T

    def _of_needle(self, T_base_tip: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the effect (6, n) of the state on the needle, as a twist in its frame, and the rest's covariance."""
        found, left = np.zeros((6, len(self._mean))), np.zeros((6, 6))
        if not self.rests:
            found, left = self._of_tip(T_base_tip)
        found[:, NEEDLE] = np.eye(6)
        return found, left

    def _mix(self, of_needle: NDArray[np.float64]) -> None:
        """Replace the needle's part of the state by a linear combination (6, n) of the whole state."""
        mix = np.eye(len(self._mean))
        mix[NEEDLE] = of_needle
        self._mean, self._covariance = mix @ self._mean, mix @ self._covariance @ mix.T

    def _keep(self, which: NDArray[np.int64]) -> None:
        self._mean, self._covariance = self._mean[which], self._covariance[np.ix_(which, which)]

    def _forget_needle(self) -> None:
        self._mean[NEEDLE] = 0.0
        self._covariance[NEEDLE] = 0.0
        self._covariance[:, NEEDLE] = 0.0

    def _closed(self, covariance: NDArray[np.float64]) -> None:
        """Account for the jaws closing: they moved the needle with this covariance, and its wire is in their plane."""
        of_grasp = self._T_needle_grasp().adjoint()
        self._covariance[NEEDLE, NEEDLE] += of_grasp @ covariance @ of_grasp.T
        # a Kalman update with the measurement that the wire lies in the jaws' plane
        flat = np.zeros((2, len(self._mean)))
        flat[:, NEEDLE] = np.linalg.inv(of_grasp)[FLAT]
        gain = self._covariance @ flat.T @ np.linalg.inv(flat @ self._covariance @ flat.T + np.diag(FLAT_SD**2))
        self._mean = self._mean - gain @ (flat @ self._mean)
        self._covariance = self._covariance - gain @ flat @ self._covariance

    def _T_needle_grasp(self) -> SE3:
        """Return the grasp's frame in the needle's: at the jaws' tip, x along their closing axis, y along the wire."""
        T_needle_tip = self._T_tip_needle_planned.inverse()
        closing, (x, y, _) = T_needle_tip.rotation.matrix[:, 0], T_needle_tip.translation_m
        along = np.array([y, -x, 0.0])
        along -= closing * (closing @ along)
        along /= np.linalg.norm(along)
        R = np.column_stack([closing, along, np.cross(closing, along)])
        return SE3.from_parts(SO3.unchecked(R), T_needle_tip.translation_m)


def alike(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlations (6, n, m) of the joints' errors at places (n, 4) and (m, 4): position m, and time s."""
    apart_m = np.linalg.norm(first[:, None, :3] - second[:, :3], axis=-1)
    apart_s = np.abs(first[:, None, 3] - second[:, 3])
    stays = 1.0 - FLEETING[:, None, None] * (1.0 - np.exp(-apart_s / FLEES_S))
    return np.asarray(stays * np.exp(-apart_m / FADES_M[:, None, None]))
