"""Commands for a calibration from images: a path on which the arm's spheres stay in the camera's view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from trocar.arms import ArmModel
from trocar.calibration.excitation import SAMPLES, MotionBox, random_smooth_path, slack_taken_up, wide_path
from trocar.errors import InvalidInput, TrocarError
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.lab import Station
from trocar.perception.depth import project
from trocar.perception.fiducial_joints import require_psm
from trocar.perception.fiducials import SIX_SPHERES
from trocar.perception.image import Intrinsics

MARGIN_PX = 6.0  # margin between a sphere, at the commanded joints, and the edge of the image
CABLES_M = 14e-3
"""The jaw's spheres may be this far from where the commands place them: cable errors reach .3 rad and more, and the
spheres are 44 mm from the middle of the wrist."""
SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)
"""Shares of the outer joints' distance from their middle that are tried, largest first."""
WRIST_STEPS = 7
SMOOTH_ROWS = 41  # odd number of rows over which these shares are smoothed, so that the path stays smooth


@dataclass(frozen=True, eq=False)
class View:
    """An RGBD camera's view of an arm that wears the spheres."""

    arm: ArmModel
    lens: Intrinsics
    T_camera_base: SE3  # as registered so far

    def bounds_px(self, q: Array) -> tuple[Array, Array]:
        """Return the corners (..., 2) u, v of the rectangles that hold all spheres at joints (..., 6), with a margin.

        The rectangles allow for cable errors of the jaw's spheres. NaN: a sphere is not in front of the camera.
        """
        p = self.T_camera_base.apply(SIX_SPHERES.base_centers_m(self.arm, q))
        pixels, slack_m = project(self.lens, p), np.where(SIX_SPHERES.on_shaft, 0.0, CABLES_M)
        with np.errstate(invalid="ignore"):
            around = ((SIX_SPHERES.radii_m + slack_m) * self.lens.fx / p[..., 2] + MARGIN_PX)[..., None]
        return (pixels - around).min(-2), (pixels + around).max(-2)

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Return in which configurations (n, 6) every sphere is wholly in the image, despite the cables' errors."""
        lower, upper = self.bounds_px(q)
        size = np.array([self.lens.width, self.lens.height])
        return np.all(np.isfinite(lower) & (lower >= 0) & (upper <= size), axis=-1)

    def always_holds(self, box: MotionBox) -> bool:
        """Return whether every wrist configuration within a box is in view at the middle of the outer joints' ranges.

        Then :func:`commands_in_view` finds a path for every seed.
        """
        middle = (box.lower + box.upper) / 2
        steps = np.linspace(box.lower[3:], box.upper[3:], WRIST_STEPS)
        wrist = np.stack(np.meshgrid(*steps.T, indexing="ij"), -1).reshape(-1, 3)
        return bool(self.holds(np.column_stack([np.tile(middle[:3], (len(wrist), 1)), wrist])).all())


def commands_in_view(view: View, box: MotionBox, rows: int, seed: np.random.SeedSequence, *, wide: bool) -> Array:
    """Return commands (2 + rows, 6): two that swing the wrist back and forth, which takes up the slack, then the path.

    Where the path leaves the view, the outer joints are pulled towards the middle of their ranges; the wrist, whose
    cables are to be learned, keeps its path. ``wide`` selects the short path of wide swings.

    Raises TrocarError: the spheres leave the view even with the outer joints in the middle.
    """
    smooth = random_smooth_path(view.arm, np.random.default_rng(seed), max(rows, SAMPLES), box)
    path = wide_path(view.arm, rows, box) if wide else smooth
    path[:, :3] = _pulled_into_view(view, path, (box.lower + box.upper)[:3] / 2)
    return slack_taken_up(view.arm, path[:rows])


def why_no_images(station: Station, arm: str, box: MotionBox) -> str:
    """Return why an arm of a station cannot be calibrated from images; empty if it can."""
    model = station.arm(arm).model
    try:
        require_psm(model)
        camera = depth_camera(station)
    except TrocarError as error:
        return str(error)
    seen_by = station.cameras[camera]
    assert isinstance(seen_by.model, Intrinsics)
    view = View(model, seen_by.model, seen_by.T_world_camera.inverse() @ station.arm(arm).T_world_base)
    return "" if view.always_holds(box) else str(_not_in_view(model))


def depth_camera(station: Station) -> str:
    """Return the name of a station's first depth camera (TrocarError: there is none)."""
    found = [name for name, camera in station.cameras.items() if isinstance(camera.model, Intrinsics)]
    if not found:
        problem = "has no camera that sees depth, which spheres need"
        raise InvalidInput(f"station {station.name!r}", problem, "add one of kind 'rgbd'")
    return found[0]


def _not_in_view(arm: ArmModel) -> InvalidInput:
    problem = f"does not see the spheres of {arm.name!r} where it should move to be calibrated"
    return InvalidInput("the camera", problem, "move it, or name another range in the station's 'calibration'")


def _pulled_into_view(view: View, path: Array, middle: Array) -> Array:
    """Return q1 q2 q3 (n, 3), pulled towards their middle (3,) as far as each row needs, smoothly along the path."""
    need = np.full(len(path), np.nan)
    for share in SHARES:
        tried = path.copy()
        tried[:, :3] = middle + share * (path[:, :3] - middle)
        need[np.isnan(need) & view.holds(tried)] = share
    if np.isnan(need).any():
        raise _not_in_view(view.arm)
    # the mean of the least shares nearby never exceeds a row's own share
    least = minimum_filter1d(need, SMOOTH_ROWS, mode="nearest")
    share = uniform_filter1d(least, SMOOTH_ROWS, mode="nearest")
    return middle + share[:, None] * (path[:, :3] - middle)
