"""A Kalman filter of the errors of the arm's tip and of the needle in its jaws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trocar.arms import ArmModel, ik_unbounded, jacobian
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.perception import NeedleSighting

LASTING, FADING, GRIP = slice(0, 6), slice(6, 12), slice(12, 18)
"""Parts of the state: the tip's lasting error, the joints' fading errors, and how the needle lies in the jaws."""
LASTING_SD = np.repeat([0.25e-3, 0.010], 3)
"""SDs of the tip's lasting error, m and rad: what registration and fitted cables leave at difficulty `recorded`."""
FADING_SD = np.array([1.6e-3, 1.6e-3, 0.27e-3, 0.009, 0.027, 0.018])
"""SDs of the joints' fading errors, rad and m, likewise. Most comes from pitch and yaw of the wrist: they shift the tip
as they turn it, so that a needle whose attitude is hardly seen is known by its place."""
FADES_M = 6e-3
"""Distance travelled by the jaws over which the fading error falls to 1/e."""
LOADED = np.diag(np.array([0.6e-3, 0.6e-3, 0.6e-3, 0.08, 0.09, 0.08]) ** 2)
"""How accurately a person loads a needle: covariance in the grasp's axes, which are the jaws' closing direction, along
the wire, and across both; shift, m, and rotation, rad."""
PIVOT_M = 15e-3
"""Closing jaws that push a needle aside rotate it about its part in the tissue, this far away along the arc."""
ASIDE_SD_M = 0.35e-3
"""SD of how far they push it."""
_ASIDE = ASIDE_SD_M * np.array([1.0, 0.0, 0.0, 0.0, -1.0 / PIVOT_M, 0.0])
CLOSING = np.outer(_ASIDE, _ASIDE) + np.diag(np.array([0.0, 0.1e-3, 0.1e-3, 0.005, 0.008, 0.045]) ** 2)
"""Covariance of what closing jaws do to a needle that the tissue holds."""
FLAT = np.array([0, 5])
FLAT_SD = np.array([0.15e-3, 0.027])
"""SDs with which flat jaws constrain the wire, m and rad: its shift along their closing direction, and its rotation
about the normal of wire and closing direction."""
ADJUSTING = 0.5
"""A small correction adds this share of the variance of the fading error, because it reverses cables."""
CAMERA = np.diag(np.repeat([0.1e-3, 0.0], 3) ** 2)
"""Covariance of a camera's place in the arm's base, m: all sightings share this error."""
DOUBT = 4.0
"""After a rejected sighting, all variances are multiplied by this."""
DOUBTS = 2
"""After so many rejections in a row, everything seen before is discarded: the first estimate was wrong."""
UNLIKELY = float(chi2.ppf(0.999, 6))
"""Squared Mahalanobis distance that one sighting in a thousand exceeds by chance."""


@dataclass(frozen=True, eq=False)
class NeedleEstimate:
    """A pose with its uncertainty.

    Attributes:
        T_base_needle: of the needle in the arm's registered base.
        covariance: (6, 6) of a twist of the needle in its own frame, m and rad.
    """

    T_base_needle: SE3
    covariance: NDArray[np.float64]

    def doubted(self) -> NeedleEstimate:
        """Return the same with more uncertainty, because something was seen that does not fit it."""
        return NeedleEstimate(self.T_base_needle, DOUBT * self.covariance)

    def updated(self, T_base_camera: SE3, seen: NeedleSighting) -> NeedleEstimate | None:
        """Return the estimate after a sighting fitted from here; None if that lies further off than chance explains."""
        T_base_needle = T_base_camera @ seen.T_camera_needle
        away = (self.T_base_needle.inverse() @ T_base_needle).log()
        known = np.linalg.inv(self.covariance)
        if away @ known @ away > UNLIKELY:
            return None
        registered = seen.information @ np.linalg.inv(np.eye(6) + CAMERA @ seen.information)
        return NeedleEstimate(T_base_needle, np.asarray(np.linalg.inv(known + registered), dtype=np.float64))


class NeedleEstimator:
    """A normal distribution of three twists, small enough to add up.

    The tip's error is a shift and a rotation about the tip, both in the base's axes; one part of it lasts for the whole
    session, the other comes from errors of the joints, which fade with the distance that the jaws travel. The needle's
    error is a twist in its own frame.

    Args:
        arm: the arm.
    """

    def __init__(self, arm: ArmModel) -> None:
        self._arm = arm
        self._T_tip_needle_planned = SE3.identity()
        self._begin()

    def _begin(self) -> None:
        """Start knowing only how large errors are."""
        self._doubts = 0
        self._mean = np.zeros(18)
        self._covariance = np.diag(np.concatenate([LASTING_SD, FADING_SD, np.zeros(6)]) ** 2)

    def tip_error(self, T_base_tip: SE3) -> NDArray[np.float64]:
        """Return the expected error (6,) of a tip that is asked to be here: shift and rotation in the base's axes."""
        return np.asarray(self._mean[LASTING] + self._by_joints(T_base_tip) @ self._mean[FADING])

    def loaded(self, T_tip_needle: SE3) -> None:
        """Start again: a person has put the needle into the jaws near this pose."""
        self._T_tip_needle_planned = T_tip_needle
        self._forget(GRIP)
        self._closed(LOADED)

    def moved(self, way_m: float) -> None:
        """Account for a movement of the jaws by this distance, with or without the needle."""
        keeps = float(np.exp(-way_m / FADES_M))
        self._mean[FADING] *= keeps
        self._covariance[FADING] *= keeps
        self._covariance[:, FADING] *= keeps
        self._covariance[FADING, FADING] += (1.0 - keeps**2) * np.diag(FADING_SD**2)

    def adjusted(self) -> None:
        """Account for a correction of the arm by less than a millimetre: sightings still hold, but less certainly."""
        self._covariance[FADING, FADING] += ADJUSTING * np.diag(FADING_SD**2)

    def regrasped(self, needle: NeedleEstimate, T_base_tip: SE3, T_tip_needle: SE3) -> None:
        """Account for the jaws closing elsewhere on a needle that the tissue held meanwhile.

        The estimate is that from before the jaws opened; the poses are those asked for now.
        """
        self._T_tip_needle_planned = T_tip_needle
        self._forget(GRIP)
        tip = self._of_tip(T_base_tip)
        offset = ((T_base_tip @ T_tip_needle).inverse() @ needle.T_base_needle).log()
        self._mean[GRIP] = offset - tip @ self._mean
        mix = np.eye(18)
        mix[GRIP] = -tip
        self._covariance = mix @ self._covariance @ mix.T
        self._covariance[GRIP, GRIP] += needle.covariance
        self._closed(CLOSING)

    def needle(self, T_base_tip: SE3) -> NeedleEstimate:
        """Return where the needle is if the tip is asked to be here."""
        T_base_needle = self.tip(T_base_tip) @ self._T_tip_needle_planned @ SE3.exp(self._mean[GRIP])
        of_needle = self._of_needle(T_base_tip)
        return NeedleEstimate(T_base_needle, of_needle @ self._covariance @ of_needle.T)

    def tip(self, T_base_tip: SE3) -> SE3:
        """Return where the tip is if it is asked to be here."""
        off = self.tip_error(T_base_tip)
        return SE3.from_parts(SO3.exp(off[3:]) @ T_base_tip.rotation, T_base_tip.translation_m + off[:3])

    @property
    def T_tip_needle(self) -> SE3:
        """Return how the needle lies in the jaws."""
        return self._T_tip_needle_planned @ SE3.exp(self._mean[GRIP])

    def update(self, T_base_tip: SE3, T_base_camera: SE3, seen: NeedleSighting) -> bool:
        """Update with a sighting, fitted from where :meth:`needle` predicts it; return whether it was accepted.

        It is not if it lies further off than chance explains.
        """
        before = self.needle(T_base_tip)
        after = before.updated(T_base_camera, seen)
        if after is None:
            self.doubt()
            self._doubts += 1
            if self._doubts == DOUBTS:
                self._begin()
                self._closed(LOADED)
            return False
        self._doubts = 0
        away = (before.T_base_needle.inverse() @ after.T_base_needle).log()
        gain = self._covariance @ self._of_needle(T_base_tip).T @ np.linalg.inv(before.covariance)
        self._mean = self._mean + gain @ away
        self._covariance = self._covariance - gain @ (before.covariance - after.covariance) @ gain.T
        return True

    def doubt(self) -> None:
        """Become less certain of everything."""
        self._covariance *= DOUBT

    def _of_tip(self, T_base_tip: SE3) -> NDArray[np.float64]:
        """Return the effect (6, 18) of the tip's parts of the state on the needle, as a twist in its frame."""
        to_tip = np.kron(np.eye(2), T_base_tip.rotation.matrix.T)
        of_tip = self._T_tip_needle_planned.inverse().adjoint() @ to_tip
        return np.concatenate([of_tip, of_tip @ self._by_joints(T_base_tip), np.zeros((6, 6))], axis=1)

    def _by_joints(self, T_base_tip: SE3) -> NDArray[np.float64]:
        """Return the effect (6, 6) of the joints' errors on the tip, in the base's axes."""
        return jacobian(self._arm, ik_unbounded(self._arm, T_base_tip))

    def _of_needle(self, T_base_tip: SE3) -> NDArray[np.float64]:
        """Return the effect (6, 18) of the state on the needle, as a twist in its frame."""
        found = self._of_tip(T_base_tip)
        found[:, GRIP] = np.eye(6)
        return found

    def _forget(self, part: slice) -> None:
        self._mean[part] = 0.0
        self._covariance[part] = 0.0
        self._covariance[:, part] = 0.0

    def _closed(self, covariance: NDArray[np.float64]) -> None:
        """Account for the jaws closing: this moved the needle by some amount, and put its wire into their plane."""
        of_grasp = self._T_needle_grasp().adjoint()
        self._covariance[GRIP, GRIP] += of_grasp @ covariance @ of_grasp.T
        flat = np.zeros((2, 18))
        flat[:, GRIP] = np.linalg.inv(of_grasp)[FLAT]
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
