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
FILLED = 0.54  # shares of the picture's height and width filled by where objects are handled; the instruments are above
MIN_EDGE = 0.08  # share of the same, between a parked arm's tip and the edge
HANDLING_M = 0.04  # a tip this close to objects handles them
OBJECT_M = 0.01  # half of an object whose middle is in the workspace
ASPECT = 1.25  # aspect ratio of a window, or narrower
LIVE_FILLED, LIVE_ASPECT = 0.78, 1.0
MIN_RADIUS_M = 0.03
STEP_RAD = math.radians(45.0)  # steps of the camera's azimuth: boards and tables are aligned with axes
UPRIGHT = 0.5  # instruments that lean forwards or backwards by less than this tangent count as upright
MOMENTS = 9  # number of the film's frames at which the arms' positions are used
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera and what it looks at.

    Attributes:
        eye_m: (3,) where it is.
        centre_m: (3,) middle of the workspace, at which it looks.
        radius_m: of a ball that contains the workspace.
        right: (3,) unit, to the right in the picture, level.
        front: (3,) unit, level, from the middle towards the camera.
    """

    eye_m: NDArray[np.float64]
    centre_m: NDArray[np.float64]
    radius_m: float
    right: NDArray[np.float64]
    front: NDArray[np.float64]


def viewpoint(replay: Replay, film: Film, *, live: bool = False) -> Viewpoint:
    """Return the viewpoint.

    The workspace is where objects are, and tips near them. The camera looks across the line from arm to arm, or across
    a single arm: along it, one would hide the other, or its own tip. Of the two sides it takes the one that the
    instruments lean away from; if they lean to neither, the side of negative y. Its distance is such that the workspace
    fills ``FILLED`` of the picture, and that arms parked elsewhere are in it too. If it is ``live``, and nobody knows
    where the arms will go, the workspace is wherever anything is now, and the page's panel makes the window narrower.
    """
    tips = _tips(replay, film)
    near = _handling(tips, _objects(replay, film), math.inf if live else HANDLING_M)
    aspect, filled = (LIVE_ASPECT, LIVE_FILLED) if live else (ASPECT, FILLED)
    low, high = near.min(0), near.max(0)
    centre = (low + high) / 2
    radius = max(MIN_RADIUS_M, float(np.linalg.norm(high - low)) / 2)
    right = _right(np.array([_from_middle(replay, film, arm, centre) for arm in replay.tools]).reshape(-1, 2))
    front = np.cross(right, UP)
    back = -(math.cos(ELEVATION_RAD) * front + math.sin(ELEVATION_RAD) * UP)
    everything = np.concatenate([near, tips])
    distance = max(
        _distance(near - centre, right, back, filled, aspect),
        _distance(everything - centre, right, back, 1 - MIN_EDGE, aspect),
    )
    eye = centre - distance * back
    return Viewpoint(eye, centre, radius, right, front)


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
    """Return the mean position (2,) of an arm, with equal weights for its solids; 0 if it has none."""
    ticks = film.ticks[np.linspace(0, len(film.ticks) - 1, MOMENTS).astype(int)]
    centres = []
    for solid in (solid for solid in replay.solids if solid.body.startswith(arm)):
        T = replay.T_world_body[solid.body]
        middle = solid.T_body_solid.apply(solid_mesh(solid).vertices_m.mean(0))
        centres.append((T if T.matrix.ndim == 2 else T[ticks]).apply(middle).reshape(-1, 3).mean(0))
    return np.mean(centres, axis=0)[:2] - centre_m[:2] if centres else np.zeros(2)


def _distance(
    points_m: NDArray[np.float64], right: NDArray[np.float64], back: NDArray[np.float64], filled: float, aspect: float
) -> float:
    """Return the distance at which points (n, 3), relative to the middle, fill this share of the picture."""
    slope = filled * math.tan(FIELD_RAD / 2)
    sideways, upwards = np.abs(points_m @ right), np.abs(points_m @ np.cross(right, back))
    needed = ((np.maximum(sideways / aspect, upwards) + OBJECT_M) / slope - points_m @ back).max()
    return max(float(needed), MIN_RADIUS_M / slope)


def _tips(replay: Replay, film: Film) -> NDArray[np.float64]:
    """Return the positions (n, 3) of the tips of all arms at all frames."""
    points = [path.p_world_driven_m[film.ticks] for path in replay.tools.values()]
    together = np.concatenate([*points, np.zeros((0, 3))])
    return together[np.isfinite(together).all(1)]


def _objects(replay: Replay, film: Film) -> NDArray[np.float64]:
    """Return the positions (n, 3) of objects at all frames: bodies that can move and do not belong to an arm.

    An arm's bodies have names that begin with its own.
    """
    mine = [not body.startswith(tuple(replay.tools)) for body in film.bodies]
    return film.position_m[mine].reshape(-1, 3)


def _handling(tips_m: NDArray[np.float64], objects_m: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Return objects (n, 3) and tips so near them; all tips if there are no objects, the origin if there is neither."""
    if not len(objects_m):
        return tips_m if len(tips_m) else np.zeros((1, 3))
    low, high = objects_m.min(0) - near_m, objects_m.max(0) + near_m
    return np.concatenate([objects_m, tips_m[((low <= tips_m) & (tips_m <= high)).all(1)]])
