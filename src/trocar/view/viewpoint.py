"""The viewpoint of a replay, chosen so that its arms and what they handle fill the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.mesh import solid_mesh

ELEVATION_RAD = math.radians(33.0)
FIELD_RAD = math.radians(34.0)  # from the upper to the lower edge; narrow, so that parallel edges stay nearly parallel
MARGINS = (0.10, 0.22, 0.15)
"""Margins: shares of half the picture's height above and below, and of half its width at either side. The page's title
is in the lower one."""
FOR_BOARDS, FOR_PORTS = 1.6, 1.35
"""The camera's distance grows by at most these factors to have boards, then ports, in the picture too."""
LABEL, ROW = 0.24, 0.09
"""Height of an arm's label above its tip, and of a row of letters, in radii of the workspace."""
HANDLING_M = 0.04  # a tip this close to objects handles them
OBJECT_M = 0.01  # half the assumed size of an object
ASPECT = 1.5  # of a window, or narrower
BESIDE_PANEL = 1.0  # likewise, of what a page's panel leaves free
MIN_RADIUS_M = 0.03
STEP_RAD = math.radians(45.0)  # steps of the camera's azimuth: boards and tables are aligned with axes
UPRIGHT = 0.5  # instruments that lean forwards or backwards by less than this tangent count as upright
MOMENTS = 9  # number of the film's frames at which the arms' positions are used
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class CameraView:
    """A camera and what it looks at.

    Attributes:
        eye_m: (3,) where it is.
        target_m: (3,) what is in the middle of the picture, as far away as the workspace's middle.
        centre_m: (3,) middle of the workspace.
        radius_m: of a ball that contains the workspace.
        right: (3,) unit, to the right in the picture, level.
        front: (3,) unit, level, from the middle towards the camera.
    """

    eye_m: NDArray[np.float64]
    target_m: NDArray[np.float64]
    centre_m: NDArray[np.float64]
    radius_m: float
    right: NDArray[np.float64]
    front: NDArray[np.float64]


def viewpoint(replay: Replay, film: Film, aspect: float = ASPECT, *, live: bool = False) -> CameraView:
    """Return the viewpoint of a window of this aspect ratio.

    The workspace is where objects are, and tips near them. The camera looks across the line from arm to arm, or across
    a single arm: along it, one arm would hide the other, or its own tip. It stands on the side that the instruments
    lean away from; if they lean to neither, on that of negative y. It is as near as possible with the workspace, all
    tips and their labels within ``MARGINS``. Boards and ports are in the picture too, unless the camera would have to
    be too far away. For a ``live`` view, whose future motion is unknown, the workspace is wherever anything is now.
    """
    tips = _tips(replay, film)
    near = _handling(tips, objects(replay, film), math.inf if live else HANDLING_M)
    low, high = near.min(0), near.max(0)
    centre = (low + high) / 2
    radius = max(MIN_RADIUS_M, float(np.linalg.norm(high - low)) / 2)
    right = _right(np.array([_from_middle(replay, film, arm, centre) for arm in replay.tools]).reshape(-1, 2))
    front = np.cross(right, UP)
    forward = -(math.cos(ELEVATION_RAD) * front + math.sin(ELEVATION_RAD) * UP)
    axes = np.stack([right, np.cross(right, forward), forward])
    ball = centre + MIN_RADIUS_M * np.concatenate([axes[:2], -axes[:2]])
    wanted = np.concatenate([_thick(near), tips, tips + (LABEL + ROW) * radius * UP, ball])
    eye = _eye(wanted, axes, aspect)
    for more, growth in ((fixed_corners(replay, film), FOR_BOARDS), (ports(replay), FOR_PORTS)):
        further = np.concatenate([wanted, more])
        there = _eye(further, axes, aspect)
        if (centre - there) @ forward <= growth * (centre - eye) @ forward:
            wanted, eye = further, there
    return CameraView(eye, eye + ((centre - eye) @ forward) * forward, centre, radius, right, front)


def _eye(points_m: NDArray[np.float64], axes: NDArray[np.float64], aspect: float) -> NDArray[np.float64]:
    """Return the nearest position (3,) of a camera that has these points (n, 3) within its margins.

    Args:
        points_m: in the world.
        axes: (3, 3) rows: right, up and forward in the picture.
        aspect: of the window.
    """
    above, below, beside = MARGINS
    half = math.tan(FIELD_RAD / 2)
    x, y, z = (points_m @ axes.T).T
    wide, up, down = half * aspect * (1 - beside), half * (1 - above), half * (1 - below)
    back, middle = [], []
    for along, plus, minus in ((x, wide, wide), (y, up, down)):
        # all points are at most plus * depth to one side of the eye and minus * depth to the other
        far, other = (along - plus * z).max(), (-along - minus * z).max()
        back.append(-(far + other) / (plus + minus))
        middle.append((far, plus, other, minus))
    depth = min(back)
    place = [((far + plus * depth) + (-other - minus * depth)) / 2 for far, plus, other, minus in middle]
    return np.array([*place, depth]) @ axes


def _thick(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (6m, 3) on the surfaces of objects with these middles (m, 3)."""
    return np.concatenate([points_m + sign * OBJECT_M * np.eye(3)[k] for k in range(3) for sign in (-1, 1)])


def fixed_corners(replay: Replay, film: Film) -> NDArray[np.float64]:
    """Return the corners (n, 3) in the world of all solids that never move and are no arm's."""
    fixed = [s for s in replay.solids if s.body not in film.bodies and not s.body.startswith(tuple(replay.tools))]
    corners = [
        (replay.T_world_body[solid.body] @ solid.T_body_solid).apply(solid_mesh(solid).vertices_m.astype(np.float64))
        for solid in fixed
    ]
    return np.concatenate([*corners, np.zeros((0, 3))])


def ports(replay: Replay) -> NDArray[np.float64]:
    """Return the remote centres (n, 3) of all arms."""
    return np.array([*replay.ports_m.values()]).reshape(-1, 3)


def _right(arms_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction to the right (3,) in the picture; arms (m, 2) are relative to the workspace's middle."""
    spread = arms_m - arms_m.mean(0) if len(arms_m) > 1 else arms_m
    x, y = np.linalg.eigh(spread.T @ spread)[1][:, 1] if np.abs(spread).sum() > 0 else (1.0, 0.0)
    turn = STEP_RAD * round(math.atan2(y, x) / STEP_RAD)
    right = np.array([math.cos(turn), math.sin(turn), 0.0])
    front = np.cross(right, UP)
    lean, width = float((arms_m @ front[:2]).sum()), float(np.abs(arms_m @ right[:2]).sum())
    leans = abs(lean) > UPRIGHT * width
    return -right if (leans and lean > 0) or (not leans and front[1] > 1e-9) else right


def _from_middle(replay: Replay, film: Film, arm: str, centre_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an arm's mean position (2,) from the workspace's middle, its solids weighted equally; 0 without any."""
    ticks = film.ticks[np.linspace(0, len(film.ticks) - 1, MOMENTS).astype(int)]
    centres = []
    for solid in (solid for solid in replay.solids if solid.body.startswith(arm)):
        T = replay.T_world_body[solid.body]
        middle = solid.T_body_solid.apply(solid_mesh(solid).vertices_m.mean(0))
        centres.append((T if T.matrix.ndim == 2 else T[ticks]).apply(middle).reshape(-1, 3).mean(0))
    return np.mean(centres, axis=0)[:2] - centre_m[:2] if centres else np.zeros(2)


def _tips(replay: Replay, film: Film) -> NDArray[np.float64]:
    """Return the positions (n, 3) of the tips of all arms at all frames."""
    points = [path.p_world_driven_m[film.ticks] for path in replay.tools.values()]
    together = np.concatenate([*points, np.zeros((0, 3))])
    return together[np.isfinite(together).all(1)]


def objects(replay: Replay, film: Film) -> NDArray[np.float64]:
    """Return the positions (n, 3) of objects at all frames: bodies that can move and do not belong to an arm.

    An arm's bodies have names that begin with its own.
    """
    mine = [not body.startswith(tuple(replay.tools)) for body in film.bodies]
    return film.position_m[mine].reshape(-1, 3)


def _handling(tips_m: NDArray[np.float64], objects_m: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Return objects (n, 3) and tips near them; without objects all tips; without tips either, the origin."""
    if not len(objects_m):
        return tips_m if len(tips_m) else np.zeros((1, 3))
    low, high = objects_m.min(0) - near_m, objects_m.max(0) + near_m
    return np.concatenate([objects_m, tips_m[((low <= tips_m) & (tips_m <= high)).all(1)]])
