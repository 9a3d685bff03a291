"""Joint values that bring the tip to a point while the wrist stays still."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms.forward import fk
from trocar.arms.jacobian import jacobian, limit_violations
from trocar.arms.model import ArmModel
from trocar.errors import InvalidInput, OutOfReach

OUTER = 3
"""Joints before the wrist."""
REACHED_M = 1e-9
STEPS = 20
MAX_STEP = np.array([0.5, 0.5, 0.1])
"""Largest step of yaw, pitch (rad) and insertion (m): further away the arm's geometry has changed too much."""


def ik_with_fixed_wrist(
    arm: ArmModel, q: ArrayLike, p_base_m: ArrayLike, p_tip_m: ArrayLike = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Return joints (6,) near ``q`` (6,), with the same wrist, that bring a point of the tip to ``p_base_m`` (3,).

    The point, ``p_tip_m`` (3,) in the tip's frame, is the tip itself, or lies on something that the jaws hold.

    The tip turns with the shaft: by .05 rad per centimetre, 200 mm from the remote centre. The wrist's cables do not
    move, so the effects of friction and play stay as they were.

    Raises:
        OutOfReach: the place cannot be reached this way within the joints' ranges.
        TrocarError: joints or place have another shape, or are not finite.
    """
    goal, held, found = _place(arm, p_base_m), _place(arm, p_tip_m), arm.configurations(q).copy()
    for _ in range(STEPS):
        T_base_tip = fk(arm, found)
        missing_m = goal - T_base_tip.apply(held)
        if np.abs(missing_m).max() < REACHED_M:
            break
        try:
            shifts, turns = np.split(jacobian(arm, found)[:, :OUTER], 2)
            of_point = shifts + np.cross(turns.T, T_base_tip.rotation.apply(held)).T
            step = np.linalg.solve(of_point, missing_m)
        except np.linalg.LinAlgError:
            raise OutOfReach(f"{arm.name} is singular on the way; turn its wrist") from None
        found[:OUTER] += np.clip(step, -MAX_STEP, MAX_STEP)
    else:
        raise OutOfReach(f"{arm.name} does not reach {np.round(1e3 * goal, 1).tolist()} mm with its wrist as it is")
    if outside := limit_violations(arm, found):
        raise OutOfReach(outside[0])
    return found


def _place(arm: ArmModel, p_m: ArrayLike) -> NDArray[np.float64]:
    try:
        place = np.asarray(p_m, dtype=np.float64)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InvalidInput(arm.name, f"needs three finite numbers as a place, got {p_m!r}")
    return place
