"""The waypoints of a plan for a robot: times, joints, poses and jaws along every stitch, as files hold them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import Suture
from trocar.tasks.suture.planning.segments import (
    DRIVING_M_S,
    JAW_CLOSED_RAD,
    minimum_jerk,
    suture_segments,
)

JAW_S = 0.5
"""Time for the jaws to open or close, in which the arm rests."""
SHARES = minimum_jerk(np.linspace(0.0, 1.0, 1001))
DIGITS = 9
JOINT_NAMES = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""CRTK's names of the joints, whatever an arm's own are."""
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
    """Waypoints of one stitch. The needle is in the jaws at the first; time begins there.

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
        """Return them as JSON values."""
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
    """Return the waypoints of a feasible stitch, in the speeds at which a simulated arm drives it.

    Each movement begins and ends at rest, with the least jerk.
    """
    arm = suture.setup.arm
    names, times, paths, jaws, now, jaw = [], [], [], [], 0.0, JAW_CLOSED_RAD
    for segment in suture_segments(suture):
        wanted = JAW_OPEN_RAD if segment.regrasps or segment.name in ("withdraw", "rise") else JAW_CLOSED_RAD
        if wanted != jaw and paths:
            names += ["open" if wanted > jaw else "close"]
            times.append(np.array([now + JAW_S]))
            paths.append(paths[-1][-1:])
            jaws.append(np.array([wanted]))
            now += JAW_S
        jaw = wanted
        for part in (segment, segment.back) if segment.beyond else (segment,):
            if len(part.q) < 2:
                continue
            seconds = part.length_m / (part.free_m_s or DRIVING_M_S)
            share = np.linspace(0.0, 1.0, len(part.q))
            at = now + seconds * np.interp(share, SHARES, np.linspace(0.0, 1.0, len(SHARES)))
            new = slice(1 if paths else 0, None)  # where the last movement ended, this one begins
            names += [part.name] * len(part.q[new])
            times.append(at[new])
            paths.append(part.q[new])
            jaws.append(np.full(len(part.q[new]), jaw))
            now += seconds
    q = np.concatenate(paths)
    tip = fk(arm, q)
    xyzw = np.roll(tip.rotation.as_quaternion(), -1, axis=-1)
    poses = np.concatenate([tip.translation_m, xyzw], axis=-1)
    return Waypoints(suture, np.concatenate(times), tuple(names), q, np.concatenate(jaws), poses)


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
