"""Paths of the tips in a viser scene: bold near the present, thin before and after, whole on request."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.palette import DRIVEN, PLANNED, Rgb, mixed

if TYPE_CHECKING:
    from viser import SceneApi

SPACING_M, MAX_POINTS = 1e-3, 2000  # spacing of a whole path
STEP_S = 0.05  # between two points of a stretch
THIN_PX, BOLD_PX = 1.5, 4.5
GREY: Rgb = (128, 132, 140)
GREYED = 0.35  # share of grey in thin paths


@dataclass(frozen=True)
class PathWindow:
    """The part of a path near the present that is drawn.

    Attributes:
        name: last part of its node's name.
        behind_s: time before the present.
        ahead_s: time after the present.
        leap_s: it advances in steps of this time; 0: with each frame, up to the tip itself.
        width_px: of the line.
        grey: share of grey in its colour.
    """

    name: str
    behind_s: float
    ahead_s: float
    leap_s: float
    width_px: float
    grey: float


NEAR = PathWindow("near", 8.0, 4.0, 1.0, THIN_PX, GREYED)
PLANNED_NOW = PathWindow("now", 2.0, 1.0, STEP_S, BOLD_PX, 0.0)
DRIVEN_NOW = PathWindow("now", 2.0, 0.0, 0.0, BOLD_PX, 0.0)


class Paths:
    """Planned and driven path of each arm's tip.

    Nodes: ``/paths/ARM KIND, now``, ``near`` and ``all``, which is hidden, since in a long trial it would cover the
    scene.
    """

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        """Draw them for the first frame."""
        self._trails: list[Trail] = []
        self._times_s = film.times_s
        for arm, path in replay.tools.items():
            for kind, points, colour, now in (
                ("planned", path.p_world_planned_m, PLANNED, PLANNED_NOW),
                ("driven", path.p_world_driven_m, DRIVEN, DRIVEN_NOW),
            ):
                known = filled(points)
                if known is not None:
                    name = f"/paths/{arm} {kind}"
                    whole = _add_line(scene, f"{name}, all", thinned(known), mixed(colour, GREY, GREYED), THIN_PX)
                    whole.visible = False
                    self._trails += [Trail(scene, name, replay.times_s, known, colour, part) for part in (NEAR, now)]

    def show(self, frame: int) -> None:
        """Draw the parts near a frame in time."""
        for trail in self._trails:
            trail.show(float(self._times_s[frame]))


class Trail:
    """One stretch of one path: points every ``STEP_S``, which stay in place while the stretch advances."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        times_s: NDArray[np.float64],
        points_m: NDArray[np.float64],
        colour: Rgb,
        part: PathWindow,
    ) -> None:
        self._times_s, self._points_m, self._part = times_s, points_m.astype(np.float32), part
        self._clock_s = np.arange(times_s[0], times_s[-1] + STEP_S, STEP_S)
        self._on_clock_m = self._points_m[self._ticks(self._clock_s)]
        self._drawn = self._stretch(float(times_s[0]))
        self._node = _add_line(
            scene, f"{name}, {part.name}", self._drawn, mixed(colour, GREY, part.grey), part.width_px
        )

    def show(self, time_s: float) -> None:
        """Draw the stretch about a time, unless it is drawn already."""
        stretch = self._stretch(time_s)
        if not np.array_equal(stretch, self._drawn):
            self._drawn = stretch
            self._node.points = _segments(stretch)

    def _stretch(self, time_s: float) -> NDArray[np.float32]:
        """Return the points (k, 3), at least two."""
        leap_s = self._part.leap_s
        about_s = leap_s * np.floor(time_s / leap_s + 1e-9) if leap_s else time_s
        first, last = np.searchsorted(self._clock_s, [about_s - self._part.behind_s, about_s + self._part.ahead_s])
        points = self._on_clock_m[min(first, len(self._clock_s) - 1) : max(1, last)]
        if leap_s and len(points) > 1:
            return points
        return np.concatenate([points, self._points_m[self._ticks(np.array([time_s]))]])

    def _ticks(self, times_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the ticks (k,) at times (k,)."""
        return np.clip(np.searchsorted(self._times_s, times_s - 1e-9), 0, len(self._times_s) - 1)


def thinned(points_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return points (k, 3) of a path (n, 3) that are ``SPACING_M`` apart, or further to limit their number."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
    spacing = max(SPACING_M, way[-1] / MAX_POINTS)
    _, first = np.unique(np.floor(way / spacing), return_index=True)
    return points_m[np.append(first, len(points_m) - 1)].astype(np.float32)


def filled(points_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a path (n, 3) with straight lines where it is unknown (nan); None if it is unknown everywhere."""
    known = np.flatnonzero(np.isfinite(points_m).all(1))
    if not len(known):
        return None
    return np.column_stack([np.interp(np.arange(len(points_m)), known, column[known]) for column in points_m.T])


def _segments(points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pieces (k - 1, 2, 3) of a line."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def _add_line(scene: SceneApi, name: str, points_m: NDArray[np.float32], colour: Rgb, width_px: float):
    return scene.add_line_segments(
        name, _segments(points_m), np.array(colour, np.uint8), thickness=width_px, thickness_units="screen"
    )
