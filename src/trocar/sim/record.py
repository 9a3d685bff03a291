"""What happened in a simulated cell, tick by tick. Simulator truth, for referees, files and replays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3


class CollidingPair(NamedTuple):
    """Who collides with what.

    Attributes:
        arm: name of the arm.
        what: ``arm``, or what it holds.
        against: the other arm's name, or the object that is hit.
    """

    arm: str
    what: str
    against: str


@dataclass(frozen=True)
class Collision:
    """One collision of an arm or of what it holds.

    Attributes:
        time_s: when it began, on the trial's clock.
        end_s: when it ended.
        arm: name of the arm.
        what: ``arm``, or what it holds.
        against: another arm's name, or the object that is hit.
        force_n: largest force while it lasted.
        p_world_m: where that was.
    """

    time_s: float
    end_s: float
    arm: str
    what: str
    against: str
    force_n: float
    p_world_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Record:
    """The true state at every tick.

    Attributes:
        times_s: (n,) clock of the cell, 100 Hz; the first is 0.
        joints: (n, 7) true joints and jaw opening of each arm, by name.
        T_world_body: (n,) true poses of the bodies that are free, by name.
        T_world_tip: (n,) true tips of the arms, by name.
        collisions: in order of time.
    """

    times_s: NDArray[np.float64]
    joints: Mapping[str, NDArray[np.float64]]
    T_world_body: Mapping[str, SE3]
    T_world_tip: Mapping[str, SE3]
    collisions: tuple[Collision, ...]
