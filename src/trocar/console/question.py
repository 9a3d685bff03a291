"""What the arms do, and what waits for a person's confirmation: motions, or a choice of goals, in words and paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.cell import Cell, GoalOffer
from trocar.geometry import shown
from trocar.motion.bodies import MovingArm
from trocar.motion.clearance import swept_clearance
from trocar.trajectory import Trajectory
from trocar.view.console_view import Ghost

PATH_STEP_S = 0.02
"""Time between two points of a displayed path."""
ARC_M, ARC_POINTS = 0.05, 21
"""Height of the arc, over the straight line, in which a goal between two places is drawn: over what stands between."""


@dataclass(frozen=True, eq=False)
class Choice:
    """What happens if the person says yes.

    Attributes:
        words: description for the person.
        ghosts: the motions, by arm.
    """

    words: str
    ghosts: Mapping[str, Ghost]


@dataclass(eq=False)
class Question:
    """Motions, or a choice of goals, that wait for confirmation.

    Attributes:
        choices: what a yes may mean; several only for goals.
        of_goals: whether it is about goals.
        may_refuse: whether the person may say no.
        refused: whether the person has said no.
        chosen: number of the choice that the page shows.
        answered: set once the person has answered, or the script waits no more.
    """

    choices: Sequence[Choice]
    of_goals: bool = False
    may_refuse: bool = False
    refused: bool = False
    chosen: int = 0
    answered: trio.Event = field(default_factory=trio.Event)

    @property
    def words(self) -> str:
        """Return the description of the choice that the page shows."""
        among = f" ({self.chosen + 1} of {len(self.choices)})" if len(self.choices) > 1 else ""
        return self.choices[self.chosen].words + among

    @property
    def ghosts(self) -> Mapping[str, Ghost]:
        """Return the motions of the choice that the page shows."""
        return self.choices[self.chosen].ghosts

    def turn_over(self) -> None:
        """Show the next choice; after the last one, the first."""
        self.chosen = (self.chosen + 1) % len(self.choices)

    @classmethod
    def of(cls, cell: Cell, goals: Sequence[GoalOffer]) -> Question:
        """Return the question which of these goals is next."""
        return cls([_choice(cell, goal) for goal in goals], of_goals=True)

    @classmethod
    def about(cls, cell: Cell, motions: Mapping[str, Trajectory], *, begun: bool = False) -> Question:
        """Return the question about motions that would start now, each from where its arm is; unless ``begun``."""
        told, ghosts = list[str](), dict[str, Ghost]()
        for arm, motion in motions.items():
            path, end = tip_path_m(cell, arm, motion), motion(motion.times_s[-1])
            ghosts[arm] = Ghost(
                cell.arms[arm], cell.T_world_base_registered[arm], path, end, cell.robot.read(arm).jaw_rad
            )
            length_m, (x, y, z) = np.linalg.norm(np.diff(path, axis=0), axis=1).sum(), 1e3 * path[-1]
            told.append(
                f"{arm} moves {100 * length_m:.1f} cm in {motion.duration_s:.1f} s, to {x:.0f} {y:.0f} {z:.0f} mm"
            )
        return cls([Choice("; ".join([*told, *_apart(cell, motions)]), ghosts)], may_refuse=not begun)


class Paths:
    """The paths of motions that run, each computed once."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Trajectory, NDArray[np.float64]]] = {}

    def of(self, cell: Cell, motions: Mapping[str, Trajectory]) -> Mapping[str, NDArray[np.float64]]:
        """Return the points (n, 3) m in the world of the arms' paths, by the registered bases."""
        for arm, motion in motions.items():
            if arm not in self._known or self._known[arm][0] is not motion:
                self._known[arm] = motion, tip_path_m(cell, arm, motion)
        return {arm: self._known[arm][1] for arm in motions}


def tip_path_m(cell: Cell, arm: str, motion: Trajectory) -> NDArray[np.float64]:
    """Return points (n, 3) m in the world of the tip's path, by the registered base."""
    q = motion.sample(PATH_STEP_S)[1]
    return (cell.T_world_base_registered[arm] @ fk(cell.arms[arm], q)).translation_m


def _choice(cell: Cell, goal: GoalOffer) -> Choice:
    """Return a goal as a choice: a line along its path, and the arm where it is."""
    arm = goal.arm
    q, jaw_rad = cell.robot.setpoint(arm).q, cell.robot.read(arm).jaw_rad
    path_m = _arc(goal.path_world_m) if len(goal.path_world_m) == 2 else goal.path_world_m
    ghost = Ghost(cell.arms[arm], cell.T_world_base_registered[arm], path_m, q, jaw_rad)
    return Choice(f"{arm} {goal.words}", {arm: ghost})


def _arc(ends_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 3) of an arc between two places (2, 3) in the world."""
    share = np.linspace(0.0, 1.0, ARC_POINTS)[:, None]
    return (1 - share) * ends_m[0] + share * ends_m[1] + 4 * ARC_M * share * (1 - share) * [0.0, 0.0, 1.0]


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
