"""Motions that wait for a person's confirmation, in words and as paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import trio

from trocar.arms import fk
from trocar.cell import Cell
from trocar.geometry import shown
from trocar.motion.bodies import MovingArm
from trocar.motion.clearance import swept_clearance
from trocar.trajectory import Trajectory
from trocar.view.console_view import Ghost

PATH_STEP_S = 0.02
"""Time between two points of a displayed path."""


@dataclass(eq=False)
class Question:
    """Motions that wait for confirmation.

    Attributes:
        words: description for the person.
        ghosts: the motions, by arm.
        answered: set once the person has answered, or the script waits no more.
    """

    words: str
    ghosts: Mapping[str, Ghost]
    answered: trio.Event = field(default_factory=trio.Event)

    @classmethod
    def about(cls, cell: Cell, motions: Mapping[str, Trajectory]) -> Question:
        """Return the question about motions that would start now, each from where its arm is."""
        told, ghosts = list[str](), dict[str, Ghost]()
        for arm, motion in motions.items():
            model, T_world_base, q = cell.arms[arm], cell.T_world_base_registered[arm], motion.sample(PATH_STEP_S)[1]
            path = (T_world_base @ fk(model, q)).translation_m
            ghosts[arm] = Ghost(model, T_world_base, path, q[-1], cell.robot.read(arm).jaw_rad)
            length_m, (x, y, z) = np.linalg.norm(np.diff(path, axis=0), axis=1).sum(), 1e3 * path[-1]
            told.append(
                f"{arm} moves {100 * length_m:.1f} cm in {motion.duration_s:.1f} s, to {x:.0f} {y:.0f} {z:.0f} mm"
            )
        return cls("; ".join([*told, *_apart(cell, motions)]), ghosts)


def _apart(cell: Cell, motions: Mapping[str, Trajectory]) -> list[str]:
    """Return a sentence on the smallest distance between arms; none if other arms move, as it is then unknown."""
    others = [arm for arm in cell.arms if arm not in motions]
    if len(cell.arms) < 2 or any(cell.robot.setpoint(arm).moving for arm in others):
        return []

    def mover(arm: str) -> MovingArm:
        model, base, jaw_rad = cell.arms[arm], cell.T_world_base_registered[arm], cell.robot.read(arm).jaw_rad
        if arm in motions:
            return MovingArm(model, motions[arm], base, 0.0, jaw_rad)
        return MovingArm.resting(model, cell.robot.setpoint(arm).q, base, jaw_rad)

    clear = swept_clearance({arm: mover(arm) for arm in motions}, others={arm: mover(arm) for arm in others})
    return [f"arms stay {shown(max(0.0, clear.distance_m), 'm', '.0f')} apart"]
