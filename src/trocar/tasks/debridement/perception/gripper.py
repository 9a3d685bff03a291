"""Pose and opening of a gripper from the marks on its fingers (Kehoe 2014, V-A.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.depth import project
from trocar.perception.image import StereoImage, StereoRig
from trocar.tasks.debridement.perception.mark_picture import draw_marks
from trocar.tasks.debridement.perception.marks import (
    JAW_RANGE,
    Fit,
    Spot,
    fit_marks,
    mark_points_m,
    pair_blobs,
    rough_fit,
    seen_blobs,
)  # fmt: skip

MIN_MARKS, MIN_SPOTS = 3, 6  # with fewer, a direction is undetermined, or hardly anything would reveal a wrong pose
ROUGH_PX, FINAL_PX, FOCAL_PX = 5.0, 0.7, 1600.0
"""Maximum RMS distance of the spots from the marks, at this focal length: before and after occlusions are known."""
MAX_SD_M, MAX_SD_RAD = 0.6e-3, np.radians(4.0)  # a pose that the spots determine less precisely is rejected
HIDDEN = (0.4, 0.6, 0.75, 0.75)
"""A spot with less than this share of its area in the drawing is partly hidden by something else; one value per
drawing, since the first drawings are of poses that are not accurate yet."""
FINE, SETTLED = (1.0, 1.0, 2.0, 2.0), 1e-2
"""Pixels of each drawing per pixel of the picture, at that focal length: the gripper is drawn from a better pose each
time. Once the pose changes by less than the second value (m and rad), occlusions by the fingers no longer change."""


@dataclass(frozen=True, eq=False)
class SeenGripper:
    """A gripper as found from the marks on its fingers."""

    T_world_tip: SE3  # pose of the controlled point between the jaws, as the arm's model has it
    jaw_rad: float  # opening of the jaws


def find_gripper(image: StereoImage, T_world_camera: SE3, arm: ArmModel) -> SeenGripper | None:
    """Return pose and opening of an arm's gripper, or None if fewer than three marks are seen or they contradict.

    The marks' middles are fitted to the spots first. Then the gripper is drawn in this pose; the parts of its marks
    that its own fingers hide tell the offset of each spot's middle from its mark's, and the fit is repeated without
    these offsets. A spot partly hidden by something else has less area than its drawing, and is left out.
    """
    marks = arm.instrument.marks
    if marks is None:
        return None
    options = [pair_blobs(image.rig, left, right, marks) for left, right in seen_blobs(image, marks)]
    up = T_world_camera.rotation.matrix[2]
    for pairs in product(*options):
        if sum(map(len, pairs)) < MIN_MARKS:
            continue
        fits = []
        for order in product((0, 1), repeat=2):
            # 1 takes a finger's far mark first
            named = {
                2 * finger + (number ^ order[finger]): pair
                for finger, found in enumerate(pairs)
                for number, pair in enumerate(found)
            }
            rough = rough_fit(named, marks, arm.tip_length_m)
            if rough is not None:
                spots = [
                    Spot(mark, right, blob, blob.middle_px)
                    for mark, pair in named.items()
                    for right, blob in ((False, pair.left), (True, pair.right))
                ]
                fit = fit_marks(spots, image.rig, marks, arm.tip_length_m, rough)
                if _credible(fit, image.rig, ROUGH_PX):
                    fits.append((fit, spots))
        # closed jaws look the same from both ends, but jaws hang down from their arm
        hanging = [found for found in fits if up @ found[0].T_camera_tip.rotation.matrix[:, 2] > 0]
        for fit, spots in sorted(hanging, key=lambda found: found[0].residual_px):
            best = _refined(fit, spots, image.rig, arm)
            if best is not None:
                return SeenGripper(T_world_camera @ best.T_camera_tip, best.jaw_rad)
    return None


def _credible(fit: Fit, rig: StereoRig, limit_px: float) -> bool:
    within = fit.residual_px <= limit_px * max(rig.left.fx / FOCAL_PX, 0.5)
    return within and bool(JAW_RANGE[0] <= fit.jaw_rad <= JAW_RANGE[1])


def _refined(fit: Fit, spots: Sequence[Spot], rig: StereoRig, arm: ArmModel) -> Fit | None:
    """Return the fit to spots corrected for occlusion by the fingers, without spots that something else hides."""
    marks, tip_length_m = arm.instrument.marks, arm.tip_length_m
    assert marks is not None  # spots have been found
    finer = max(1.0, FOCAL_PX / rig.left.fx)
    for number, (fine, least) in enumerate(zip(FINE, HIDDEN, strict=True)):
        centers = fit.T_camera_tip.apply(mark_points_m(marks, tip_length_m, fit.jaw_rad))
        better = []
        for right, lens, T_left_eye in ((False, rig.left, SE3.identity()), (True, rig.right, rig.T_left_right)):
            T_eye_left = T_left_eye.inverse()
            T_eye_tip = T_eye_left @ fit.T_camera_tip
            drawing = draw_marks(arm.instrument, tip_length_m, lens, T_eye_tip, fit.jaw_rad, fine * finer)
            if drawing is None:
                return None
            middles, pixel_area = project(lens, T_eye_left.apply(centers)), 1.0 / (fine * finer) ** 2
            mine = [spot for spot in spots if spot.right == right]
            better += [_compared(spot, drawing, pixel_area, middles[spot.mark], least) for spot in mine]
        known = [spot for spot in better if spot is not None]
        if len(known) < MIN_SPOTS or len({spot.mark for spot in known}) < MIN_MARKS:
            return None
        before, fit = fit, fit_marks(known, rig, marks, tip_length_m, fit)
        if fit.sd_m > MAX_SD_M or fit.sd_rad > MAX_SD_RAD:
            return None
        if np.abs((before.T_camera_tip.inverse() @ fit.T_camera_tip).log()).max() < SETTLED and number >= 2:
            break
    return fit if _credible(fit, rig, FINAL_PX) else None


def _compared(
    spot: Spot, drawing: list[NDArray[np.float64]], pixel_area: float, center_px: NDArray[np.float64], least: float
) -> Spot | None:
    """Return a spot with the middle of its mark, or None if it looks unlike its drawing."""
    drawn, merged = drawing[spot.mark], spot.blob.merged_px
    middle, area = spot.blob.middle_px, spot.blob.area_px
    if not len(drawn):
        return None
    if merged is not None:
        neighbour = drawing[spot.mark ^ 1]
        if not len(neighbour):
            return None
        # cut the seen and the drawn spot along the same line
        own, other = drawn.mean(0), neighbour.mean(0)
        both = np.concatenate([drawn, neighbour])
        seen, drawn = (pixels[(pixels - (own + other) / 2) @ (own - other) > 0] for pixels in (merged, both))
        if not len(seen) or not len(drawn):
            return None
        middle, area = seen.mean(0), float(len(seen))
    share = area / (len(drawn) * pixel_area)
    if not least <= share <= 1 / least:
        return None
    return replace(spot, middle_px=middle + center_px - drawn.mean(0))
