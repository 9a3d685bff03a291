"""Explain why a pose that an arm publishes is not that of its joints: units, order, the tip, or the frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import permutations, product
from math import degrees, pi

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk
from trocar.geometry import SE3, SO3
from trocar.hardware.laboratory import registered
from trocar.lab.station import Station

POSE_M, POSE_RAD = 2e-3, 0.02
"""Poses this close count as equal: models of one instrument differ by less."""
FRAME_M, FRAME_RAD = 10e-3, 0.05
"""Likewise in the world, where a base is registered anew in each session."""
TOOL_M = 0.05
"""Greatest distance of a point of the tool from its tip."""
SAMPLES = 20
FACTORS = (1.0, 1e3, 10.0)
"""Factors by which lengths may be too large: none (m), mm, and the ten of an early simulator."""


class Cause(Enum):
    """The mistake that explains the poses."""

    NONE = "nothing has to be explained"
    TIP = "the poses are of another point of the tool's axis"
    UNITS = "units"
    ORDER = "the order of the joints"
    UNKNOWN = "no single mistake that is known"


@dataclass(frozen=True)
class Explanation:
    """How poses differ from those of the joints, and why.

    Attributes:
        cause: of the difference.
        detail: the same in words, with its value.
        off_m: greatest distance of the received poses from those of the received joints.
        off_rad: likewise, the greatest angle between their rotations.
    """

    cause: Cause
    detail: str
    off_m: float
    off_rad: float


def explain(model: ArmModel, q: NDArray[np.float64], T_base_tip: SE3) -> Explanation:
    """Return why poses are not those of the joints.

    Args:
        model: of the arm.
        q: (n, 6) joints, as received.
        T_base_tip: (n,) poses of the same moments, in the arm's base, as received.
    """
    some = np.unique(np.linspace(0, len(q) - 1, SAMPLES).astype(int))
    q, T = q[some], T_base_tip[some]
    off_m, off_rad = apart(fk(model, q), T)
    if near(off_m, off_rad):
        return Explanation(Cause.NONE, "", off_m, off_rad)
    for cause, detail, alike in _guesses(model, q, T):
        if alike:
            return Explanation(cause, detail, off_m, off_rad)
    return Explanation(Cause.UNKNOWN, "", off_m, off_rad)


def _guesses(model: ArmModel, q: NDArray[np.float64], T: SE3) -> Iterator[tuple[Cause, str, bool]]:
    """Yield mistakes, and whether each explains the poses; the simplest first."""
    D = fk(model, q).inverse() @ T
    across, along = float(np.abs(D.translation_m[:, :2]).max()), D.translation_m[:, 2]
    straight = float(D.rotation.angle().max()) <= POSE_RAD and across <= POSE_M and float(np.ptp(along)) <= POSE_M
    offset_m = float(np.median(along))
    where = f"{1e3 * abs(offset_m):.1f} mm {'behind' if offset_m < 0 else 'beyond'} the tip"
    yield Cause.TIP, where, straight and abs(offset_m) <= TOOL_M
    slides = np.array([joint.prismatic for joint in model.joints])
    for turned, slid, placed in product((1.0, degrees(1.0)), FACTORS, FACTORS):
        alike = near(*apart(fk(model, q / np.where(slides, slid, turned)), _shrunk(T, placed)))
        words = [
            *(["joints in degrees"] if turned != 1 else []),
            *_long("the insertion", slid),
            *_long("poses", placed),
        ]
        yield Cause.UNITS, " and ".join(words), alike
    one, first = q[len(q) // 2], T[len(q) // 2]
    orders = np.array(list(permutations(range(6))))
    guess = fk(model, one[orders])
    distances = np.linalg.norm(guess.translation_m - first.translation_m, axis=1)
    for order in orders[distances <= POSE_M]:
        names = ", ".join(model.joints[place].name for place in np.argsort(order))
        yield Cause.ORDER, f"they come as {names}", near(*apart(fk(model, q[:, order]), T))


def _long(what: str, factor: float) -> list[str]:
    return [] if factor == 1 else [f"{what} in mm" if factor == 1e3 else f"{what} {factor:g} times too large"]


def _shrunk(T: SE3, factor: float) -> SE3:
    return SE3.from_parts(T.rotation, T.translation_m / factor)


def apart(a: SE3, b: SE3) -> tuple[float, float]:
    """Return the greatest distance (m) and angle (rad) between corresponding poses (n,)."""
    D = a.inverse() @ b
    return float(np.linalg.norm(D.translation_m, axis=-1).max()), float(D.rotation.angle().max())


def near(off_m: float, off_rad: float, within_m: float = POSE_M, within_rad: float = POSE_RAD) -> bool:
    """Return whether a distance and an angle are within tolerance."""
    return off_m <= within_m and off_rad <= within_rad


def frame_of(station: Station, arm: str, T_base_tip: SE3, T: SE3) -> str | None:
    """Return the frame of poses that are not in the station's world, in words; None: no known frame.

    Args:
        station: of the arm.
        arm: name.
        T_base_tip: (n,) poses in the arm's base.
        T: (n,) poses of the same moments, in the unknown frame.
    """
    T_world_base = {name: registered(one) for name, one in station.arms.items()}
    T_world_tip = T_world_base[arm] @ T_base_tip
    guesses = {"the arm's own base": T_base_tip}
    guesses |= {f"the base of {one!r}": T_world_base[one].inverse() @ T_world_tip for one in station.arms}
    for name, camera in station.cameras.items():
        T_world_camera = registered(camera)
        T_world_view = T_world_camera @ SE3.from_parts(SO3.axis("z", pi))
        guesses[f"the frame of camera {name!r}"] = T_world_camera.inverse() @ T_world_tip
        guesses[f"the view frame of camera {name!r} (x left, y up)"] = T_world_view.inverse() @ T_world_tip
    for where, guess in guesses.items():
        if near(*apart(guess, T), FRAME_M, FRAME_RAD):
            return where
    others = [one for one in station.arms if one != arm]
    swapped = [one for one in others if near(*apart(T_world_base[one] @ T_base_tip, T), FRAME_M, FRAME_RAD)]
    return f"the world if this is arm {swapped[0]!r}: two arms have each other's namespace" if swapped else None
