"""The waypoints of a plan for a robot: times, joints, poses and jaws along every stitch, as files hold them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MOTION_LIMITS, ArmModel, fk
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import Suture
from trocar.tasks.suture.planning.segments import (
    DRIVING_M_S,
    JAW_CLOSED_RAD,
    Segment,
    minimum_jerk,
    suture_segments,
)

JAW_S = 0.5
"""Time for the jaws to open or close, in which the arm rests."""
SHARES = minimum_jerk(np.linspace(0.0, 1.0, 1001))
OPENED = ("withdraw", "rise")
"""Segments, besides regrasps, on which the jaws are open."""
GENTLE, AWAY = 0.2, 24
"""Share of the limits that a minimum-jerk motion from place to place uses, and the number of its waypoints."""
DIGITS = 9
JOINT_NAMES = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""CRTK's names of the joints, for all arms."""
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
"""Columns of a pose: position, then the quaternion with its real part last, as in CRTK."""
UNITS = ("rad", "rad", "m", "rad", "rad", "rad")
COLUMNS = (
    *("stitch", "segment", "time_s"),
    *(f"{name}_{unit}" for name, unit in zip(JOINT_NAMES, UNITS, strict=True)),
    *("jaw_rad", *POSE),
)
"""Columns of the table of stitches."""


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints of one stitch. At the first, the needle is in the jaws and time begins.

    Attributes:
        suture: the stitch.
        times_s: (k,) ascending.
        segments: (k,) names of the movements, ``open`` and ``close`` where only the jaws move.
        q: (k, 6) joints, rad and m.
        jaw_rad: (k,) commanded opening; below 0 the jaws press.
        poses: (k, 7) of the arm's tip in its base, columns as ``POSE``.
    """

    suture: Suture
    times_s: NDArray[np.float64]
    segments: tuple[str, ...]
    q: NDArray[np.float64]
    jaw_rad: NDArray[np.float64]
    poses: NDArray[np.float64]

    def values(self) -> dict[str, Any]:
        """Return the waypoints as JSON values."""
        return {
            "theta_rad": self.suture.theta_rad,
            "direction": self.suture.direction,
            "segments": list(self.segments),
            "times_s": self.times_s.round(DIGITS).tolist(),
            "joints": self.q.round(DIGITS).tolist(),
            "jaw_rad": self.jaw_rad.round(DIGITS).tolist(),
            "poses": self.poses.round(DIGITS).tolist(),
        }


def waypoints(suture: Suture) -> Waypoints:
    """Return the waypoints of a feasible stitch, at the speeds at which a simulated arm drives it.

    Each movement is a minimum-jerk motion from rest to rest.
    """
    timeline = Timeline(suture.setup.arm)
    for segment in suture_segments(suture):
        timeline.follow(segment)
    return timeline.waypoints(suture)


class Timeline:
    """Successive movements of an arm, collected as waypoints.

    Args:
        arm: the arm, its jaws closed.
        start_q: (6,) joints at first; None: where the first movement begins.

    Attributes:
        now_s: when the last movement ends.
    """

    def __init__(self, arm: ArmModel, start_q: NDArray[np.float64] | None = None):
        self.now_s, self._arm, self._jaw = 0.0, arm, JAW_CLOSED_RAD
        self._names: list[str] = []
        self._times: list[NDArray[np.float64]] = []
        self._paths: list[NDArray[np.float64]] = []
        self._jaws: list[NDArray[np.float64]] = []
        if start_q is not None:
            self._add("start", np.zeros(1), start_q[None], self._jaw)

    def go(self, q: NDArray[np.float64]) -> None:
        """Go straight to joints (6,), each within a share ``GENTLE`` of its limits of velocity and acceleration."""
        path, limits = np.linspace(self._paths[-1][-1], q, AWAY), MOTION_LIMITS["paper"]
        way = np.abs(path[-1] - path[0]) / GENTLE
        # 1.875 and 5.774: peak velocity and acceleration of a minimum-jerk motion of length 1 in 1 s
        seconds = max((1.875 * way / limits.velocity).max(), np.sqrt(5.774 * way / limits.acceleration).max())
        self.move("go", path, float(seconds))

    def follow(self, segment: Segment) -> None:
        """Follow a segment, after the jaws have opened or closed for it."""
        self.jaw(JAW_OPEN_RAD if segment.regrasps or segment.name in OPENED else JAW_CLOSED_RAD)
        for part in (segment, segment.back) if segment.beyond else (segment,):
            self.move(part.name, part.q, part.length_m / (part.free_m_s or DRIVING_M_S))

    def jaw(self, wanted_rad: float) -> None:
        """Open or close the jaws, unless they are so already."""
        if wanted_rad != self._jaw and self._paths:
            self.now_s += JAW_S
            self._add("open" if wanted_rad > self._jaw else "close", np.zeros(1), self._paths[-1][-1:], wanted_rad)
        self._jaw = wanted_rad

    def move(self, name: str, q: NDArray[np.float64], seconds: float) -> None:
        """Move along joints (k, 6) in this time; the first row is left out unless it is the timeline's first."""
        if len(q) < 2:
            return
        share = np.interp(np.linspace(0.0, 1.0, len(q)), SHARES, np.linspace(0.0, 1.0, len(SHARES)))
        new = slice(1 if self._paths else 0, None)
        self._add(name, seconds * share[new], q[new], self._jaw)
        self.now_s += seconds

    def wait(self, until_s: float) -> None:
        """Rest where the arm is until this time."""
        if until_s > self.now_s:
            self.now_s = until_s
            self._add("wait", np.zeros(1), self._paths[-1][-1:], self._jaw)

    def _add(self, name: str, after_s: NDArray[np.float64], q: NDArray[np.float64], jaw_rad: float) -> None:
        self._names += [name] * len(q)
        self._times.append(self.now_s + after_s)
        self._paths.append(q)
        self._jaws.append(np.full(len(q), jaw_rad))

    def waypoints(self, suture: Suture) -> Waypoints:
        """Return all movements so far as the waypoints of a stitch."""
        q = np.concatenate(self._paths)
        tip = fk(self._arm, q)
        poses = np.concatenate([tip.translation_m, np.roll(tip.rotation.as_quaternion(), -1, axis=-1)], axis=-1)
        times, jaws = np.concatenate(self._times), np.concatenate(self._jaws)
        return Waypoints(suture, times, tuple(self._names), q, jaws, poses)


def waypoints_values(stitches: Sequence[Waypoints]) -> dict[str, Any]:
    """Return the stitches of a plan as JSON values, with what their columns are."""
    return {
        "joint_names": list(JOINT_NAMES),
        "joint_units": list(UNITS),
        "pose": "of the tip in the arm's base: x, y, z in m, then qx, qy, qz, qw",
        "stitches": [stitch.values() for stitch in stitches],
    }


def rows(stitches: Sequence[Waypoints]) -> Iterator[list[str]]:
    """Return the rows of the table of stitches; time begins anew with each stitch."""
    for number, stitch in enumerate(stitches, start=1):
        numbers = np.column_stack([stitch.times_s, stitch.q, stitch.jaw_rad, stitch.poses])
        for name, row in zip(stitch.segments, numbers.tolist(), strict=True):
            yield [str(number), name, *(f"{value:.9g}" for value in row)]
