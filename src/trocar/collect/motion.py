"""Where an arm goes to be calibrated: a random smooth path whose spheres stay in the camera's view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from trocar.arms import ArmModel
from trocar.calibration.excitation import WAKE_RAD, MotionBox, random_smooth_path
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.perception.depth import project
from trocar.perception.fiducials.fixture import Fixture
from trocar.perception.image import Intrinsics

MARGIN_PX = 6.0
"""Between a sphere, at the joints commanded, and the edge of the image."""
CABLES_M = 14e-3
"""The jaw's spheres may be this far from where the commands place them: cables are off by .3 rad and more, 44 mm away
from the wrist's middle."""
SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)
"""Shares of the outer joints' way from their middle that are tried, largest first."""
SMOOTH_ROWS = 41
"""Rows over which such a share changes, so that the path stays smooth; odd."""


@dataclass(frozen=True, eq=False)
class View:
    """What decides which places an RGBD camera sees.

    Attributes:
        lens: of the camera.
        T_camera_base: where it sees the arm's base, as registered so far.
    """

    lens: Intrinsics
    T_camera_base: SE3


def commands_in_view(
    arm: ArmModel, fixture: Fixture, view: View, box: MotionBox, rows: int, seed: np.random.SeedSequence
) -> NDArray[np.float64]:
    """Return commands (2 + rows, 6): two that swing the wrist to and fro, which takes up the slack, then the path.

    Where the path leaves the view, the outer joints are drawn towards the middle of their ranges; the wrist, whose cables
    are what is to be learnt, keeps its path.

    Raises:
        TrocarError: some poses of the wrist are not in view anywhere.
    """
    path = random_smooth_path(arm, np.random.default_rng(seed), rows, box)
    path[:, :3] = _pulled_into_view(arm, fixture, view, path, (box.lower + box.upper)[:3] / 2)
    swing = np.append(np.zeros(3), WAKE_RAD)
    wake = np.clip([path[0] + swing, path[0] - swing], arm.lower, arm.upper)
    return np.concatenate([wake, path])


def _pulled_into_view(
    arm: ArmModel, fixture: Fixture, view: View, path: NDArray[np.float64], middle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return q1 q2 q3 (n, 3) drawn towards their middle (3,) as far as each row needs it, smoothly along the path."""
    need = np.full(len(path), np.nan)
    for share in SHARES:
        tried = path.copy()
        tried[:, :3] = middle + share * (path[:, :3] - middle)
        need[np.isnan(need) & in_view(arm, fixture, view, tried)] = share
    if np.isnan(need).any():
        raise TrocarError(
            f"the camera does not see the spheres of {arm.name!r} where it should move to be calibrated; move the "
            "camera, or name another range in the station's 'calibration'"
        )
    # the mean of the least shares nearby is nowhere more than a row's own
    least = minimum_filter1d(need, SMOOTH_ROWS, mode="nearest")
    share = uniform_filter1d(least, SMOOTH_ROWS, mode="nearest")
    return middle + share[:, None] * (path[:, :3] - middle)


def in_view(arm: ArmModel, fixture: Fixture, view: View, q: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return in which configurations (n, 6) every sphere is wholly in the image, wherever the cables leave it."""
    lower, upper = bounds_px(arm, fixture, view, q, MARGIN_PX, np.where(fixture.on_shaft, 0.0, CABLES_M))
    size = np.array([view.lens.width, view.lens.height])
    return (np.isfinite(lower) & (lower >= 0) & (upper <= size)).all(-1)


def bounds_px(
    arm: ArmModel,
    fixture: Fixture,
    view: View,
    q: NDArray[np.float64],
    margin_px: float,
    slack_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (..., 2) u, v of the rectangles that hold all spheres at joints (..., 6); NaN: not in front.

    Each sphere may be ``slack_m`` (k,) away from its place.
    """
    p = view.T_camera_base.apply(fixture.base_centers_m(arm, q))
    pixels = project(view.lens, p)
    with np.errstate(invalid="ignore"):
        around = ((fixture.radii_m + slack_m) * view.lens.fx / p[..., 2] + margin_px)[..., None]
    return (pixels - around).min(-2), (pixels + around).max(-2)
