"""Messages between the scripts' process and the loop's process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.cell import JointReading, MotionEnd, SetPoint
from trocar.errors import TrocarError
from trocar.hardware.arm import ArmFault
from trocar.robots.executor import Ending
from trocar.trajectory import Trajectory


@dataclass(frozen=True)
class Start:
    """Start trajectories: at once from rest, or at a tick, in place of running motions."""

    key: int
    motions: Mapping[str, Trajectory]
    at_tick: int | None = None


@dataclass(frozen=True)
class Jaw:
    """Drive an arm's jaws to an angle; None: stop them there, if the command of this key still drives them."""

    key: int
    arm: str
    angle_rad: float | None


class Reason(TrocarError):
    """Stand-in for a stop's reason, which the scripts' process keeps: importing its class in the loop takes too long.

    Attributes:
        key: of the reason.
    """

    def __init__(self, key: int):
        self.key = key
        super().__init__(f"reason {key}")


@dataclass(frozen=True)
class Stop:
    """Bring arms to rest on their paths."""

    arms: tuple[str, ...]
    ended: MotionEnd
    reason: Reason


@dataclass(frozen=True)
class Emergency:
    """Bring all arms to rest; none moves until its fault is cleared."""

    detail: str = ""


@dataclass(frozen=True)
class Clear:
    """Forget the faults of arms."""

    arms: tuple[str, ...]


@dataclass(frozen=True)
class Alive:
    """The scripts' process is alive."""


@dataclass(frozen=True)
class Close:
    """Come to rest and end."""


@dataclass
class ArmReport:
    """One arm after a tick.

    Attributes:
        sent: (7,) joints and jaw of the last set-point.
        reading: of its encoders, on the loop's clock.
        setpoint: the one ``lead_ticks`` from now, where a motion that takes over has to start.
        braking: in the tick in which an arm begins to brake, the braking motion and its start; else None.
        jaw_goal_rad: goal of its jaws.
        limit_use: largest shares of the velocity and acceleration limits used so far.
    """

    sent: NDArray[np.float64]
    reading: JointReading
    setpoint: SetPoint
    braking: tuple[Trajectory, float] | None
    jaw_goal_rad: float
    limit_use: tuple[float, float]


@dataclass
class Report:
    """What happened in a tick.

    Attributes:
        tick: its number.
        clock_s: the motions' own time, one period per tick.
        time_s: the machine's monotonic clock.
        arms: by name.
        over: keys, arms and endings of motions and jaw commands that are over.
        refused: keys of motions that were not started, and why.
        faults: that are new.
    """

    tick: int
    clock_s: float
    time_s: float
    arms: dict[str, ArmReport] = field(default_factory=dict)
    over: list[tuple[int, str, Ending]] = field(default_factory=list)
    refused: list[tuple[int, TrocarError]] = field(default_factory=list)
    faults: list[ArmFault] = field(default_factory=list)

    @property
    def eventful(self) -> bool:
        """Return whether a script may wait for this report."""
        braking = any(arm.braking is not None for arm in self.arms.values())
        return braking or bool(self.over or self.refused or self.faults)
