"""What the scripts' process and the loop's process say to each other."""

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
    """Start trajectories: at once and from rest, or taking over at a tick."""

    key: int
    motions: Mapping[str, Trajectory]
    at_tick: int | None = None


@dataclass(frozen=True)
class Jaw:
    """Drive an arm's jaws; None: they stay as they are commanded now."""

    key: int
    arm: str
    angle_rad: float | None


class Reason(TrocarError):
    """Stands for a reason that the scripts' process keeps; to load its class in the loop's would delay a stop.

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
class EmergencyStop:
    """Bring all arms to rest, for good."""

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
        sent: (7,) what it was sent: joints and jaw.
        reading: its encoders, on the loop's clock.
        setpoint: the command ``lead_ticks`` from now, where a motion that takes over has to start.
        braking: the rest of a motion that comes to rest early, and when it began, in the tick in which that began.
        jaw_goal_rad: where its jaws go.
        limit_use: largest share of velocity and acceleration limits in what was sent so far.
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
        clock_s: the motions' own time.
        time_s: the machine's monotonic clock.
        arms: by name.
        over: keys, arms and endings of motions and jaws that are over.
        refused: keys of motions that were not started, and why.
        faults: that came up.
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
        """Return whether somebody waits for what it tells."""
        braking = any(arm.braking is not None for arm in self.arms.values())
        return braking or bool(self.over or self.refused or self.faults)
