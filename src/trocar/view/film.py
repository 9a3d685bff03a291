"""The frames of a replay that are drawn, and the bodies that have moved at each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import steady
from trocar.replay import Replay

FRAME_RATES = (30.0, 25.0, 20.0, 15.0, 12.0, 10.0, 7.5, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0)  # per second, the finest first
STILL_M = 20e-6
STILL_RAD = 100e-6
"""A body's pose is updated once it has moved or turned by more than this since its last update: less than a fifth of a
pixel in a picture 200 mm wide."""


@dataclass(frozen=True, eq=False)
class Film:
    """Frames of a replay.

    Attributes:
        rate_hz: frames per second of the trial's clock.
        ticks: (k,) which of ``Replay.times_s`` are frames.
        times_s: (k,) of the frames.
        bodies: names of those that move, m of them.
        position_m: (m, k, 3) of each.
        wxyz: (m, k, 4) of each.
        moved: (m, k) whether its pose has to be updated at a frame; all at the first.
    """

    rate_hz: float
    ticks: NDArray[np.intp]
    times_s: NDArray[np.float64]
    bodies: tuple[str, ...]
    position_m: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    moved: NDArray[np.bool_]

    def frame_at(self, time_s: float) -> int:
        """Return the index of the last frame up to a time; 0 before the first frame."""
        return max(0, last_until(self.times_s, time_s))


def last_until(times_s: NDArray[np.float64], time_s: float) -> int:
    """Return the index of the last of these times up to a time; -1 if all are later."""
    return int(np.searchsorted(times_s, time_s + 1e-9, side="right")) - 1


def shoot(replay: Replay, rates_hz: Sequence[float] = FRAME_RATES, max_poses: int | None = None) -> Film:
    """Return a replay's film at the first of these rates at which no more than ``max_poses`` poses change.

    Args:
        replay: of the trial.
        rates_hz: frames per second, the finest first; the last one is used in any case.
        max_poses: None: no limit.

    Raises:
        TrocarError: there are no times, or a body or a path has a different number of them.
    """
    _check(replay)
    seen = {solid.body for solid in replay.solids}
    moving = {body: T for body, T in replay.T_world_body.items() if body in seen and T.matrix.ndim == 3}
    n = len(replay.times_s)
    bodies = tuple(moving)
    position = np.array([T.translation_m for T in moving.values()]).reshape(-1, n, 3)
    wxyz = np.array([steady(T.rotation.as_quaternion()) for T in moving.values()]).reshape(-1, n, 4)

    def shot(rate_hz: float) -> Film:
        ticks = _ticks(replay.times_s, rate_hz)
        at, turned = position[:, ticks], wxyz[:, ticks]
        return Film(rate_hz, ticks, replay.times_s[ticks], bodies, at, turned, _moved(at, turned))

    films = map(shot, rates_hz[:-1])
    fitting = next((film for film in films if max_poses is None or film.moved.sum() <= max_poses), None)
    return fitting or shot(rates_hz[-1])


def _check(replay: Replay) -> None:
    """Raise an error unless times and poses match."""
    n = len(replay.times_s)
    if n == 0:
        raise InvalidInput("a replay without times", "cannot be shown", "give at least one tick")
    for body, T in replay.T_world_body.items():
        if T.matrix.shape[:-2] not in ((), (n,)):
            remedy = f"give one, or one for each of the {n} times"
            raise InvalidInput(f"body '{body}'", f"has poses {T.matrix.shape}", remedy)
    for arm, path in replay.tools.items():
        for kind, points in (("planned", path.p_world_planned_m), ("driven", path.p_world_driven_m)):
            if points.shape != (n, 3):
                raise InvalidInput(f"the {kind} path", f"of '{arm}' has shape {points.shape}", f"give {(n, 3)}")
    missing = sorted({solid.body for solid in replay.solids} - set(replay.T_world_body))
    if missing:
        known = f"the replay has {', '.join(replay.T_world_body)}"
        raise InvalidInput("there", f"is no pose of body '{missing[0]}'", known)


def _ticks(times_s: NDArray[np.float64], rate_hz: float) -> NDArray[np.intp]:
    """Return the ticks nearest to frames at this rate, each once, and the last tick."""
    wanted = np.arange(times_s[0], times_s[-1], 1 / rate_hz)
    after = np.clip(np.searchsorted(times_s, wanted), 1, max(1, len(times_s) - 1))
    before_is_nearer = wanted - times_s[after - 1] <= times_s[np.minimum(after, len(times_s) - 1)] - wanted
    return np.unique(np.append(np.where(before_is_nearer, after - 1, after), len(times_s) - 1))


def _moved(position_m: NDArray[np.float64], wxyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether each body's pose (m, k) must be updated: at each full unit of its path since the first frame.

    A unit is ``STILL_M`` or ``STILL_RAD``. Between updates, a body stays within one unit of where it is drawn.
    """
    way = np.linalg.norm(np.diff(position_m, axis=1), axis=-1) / STILL_M
    turn = 2 * np.linalg.norm(np.diff(wxyz, axis=1), axis=-1) / STILL_RAD  # |dq| is half a small angle
    units = np.floor(np.cumsum(np.maximum(way, turn), axis=1))
    moved = np.ones(position_m.shape[:2], dtype=bool)
    moved[:, 1:] = np.diff(units, axis=1, prepend=0.0) > 0
    return moved
