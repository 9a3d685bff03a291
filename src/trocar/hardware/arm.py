"""What a real arm has to offer, what the loop that drives it tolerates, and how it says that something is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import ArmStopped, InvalidInput, InvalidValue
from trocar.hardware.priority import PRIORITY
from trocar.robots.driver import TICK_S


@dataclass(frozen=True)
class HardwareReading:
    """What the encoders of a real arm read.

    Attributes:
        q: (6,) joints, rad and m.
        jaw_rad: opening of the jaws.
        age_s: how long ago they were sampled; an arm that does not know says 0.
    """

    q: NDArray[np.float64]
    jaw_rad: float
    age_s: float = 0.0


class HardwareArm(Protocol):
    """One real arm, as its loop sees it: a few calls that return within a fraction of a tick.

    It lives in the loop's process. Whatever it raises stops the arm, and is named to the script that moved it; an
    ``ArmFault`` keeps its kind. One that passes set-points on in parts may have an attribute ``behind``: while it is
    true the motions of all arms wait, and the set-point is sent again. So nothing is left to come when they stop.
    """

    def commanded(self) -> tuple[NDArray[np.float64], float]:
        """Return joints (6,) and jaws that the controller holds now: the first set-point."""
        ...

    def read(self) -> HardwareReading:
        """Return the encoders' state."""
        ...

    def send(self, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: float) -> None:
        """Take the set-point of this tick: joints (6,), their velocities, and the jaws' opening."""
        ...

    def close(self) -> None:
        """Leave the arm holding where it is."""
        ...


Connect = Callable[[str], HardwareArm]
"""Connects an arm by its name, in the loop's process: a function of a module, or a ``functools.partial`` of one."""


@dataclass(frozen=True)
class LoopSettings:
    """What a loop of real arms keeps and tolerates.

    Attributes:
        tick_s: period of the set-points.
        lead_ticks: a motion that replaces a running one starts so many ticks after what was last reported, so that it
            arrives in time.
        max_late: more ticks than this within a second that are late by over half a period are a fault.
        max_stall_s: so is one tick that is later than this.
        stale_s: so are encoders that were sampled longer ago than this.
        lag_s: an arm may follow its set-points this much later,
        following_rad: and be off by this much then; a prismatic joint
        following_m: by this much.
        watchdog_s: arms brake if their script's process lets this much time pass without a sign of life.
        priority: of the loop under Linux's real-time scheduler, where that is permitted; 0: ordinary.
    """

    tick_s: float = TICK_S
    lead_ticks: int = 3
    max_late: int = 10
    max_stall_s: float = 0.1
    stale_s: float = 0.1
    lag_s: float = 0.1
    following_rad: float = 0.05
    following_m: float = 0.005
    watchdog_s: float = 1.0
    priority: int = PRIORITY

    def __post_init__(self) -> None:
        if not 0.001 <= self.tick_s <= 0.1:
            raise InvalidValue("the period of a hardware loop", f"{self.tick_s} s", "give .001 s (1 kHz) to .1 s")
        for name in ("max_stall_s", "stale_s", "lag_s", "following_rad", "following_m", "watchdog_s"):
            if not getattr(self, name) > 0:
                raise InvalidValue(f"{name} of a hardware loop", getattr(self, name), "give more than 0")
        if self.lead_ticks < 1 or self.max_late < 0:
            raise InvalidInput("a hardware loop", "needs lead_ticks of 1 or more, and max_late of 0 or more")


@dataclass(frozen=True, eq=False)
class DrivenArm:
    """What the loop knows of an arm.

    Attributes:
        model: of the arm; what is sent stays within its joints' ranges.
        limits: of velocity and acceleration, within which it brakes.
    """

    model: ArmModel
    limits: MotionLimits

    def following(self, settings: LoopSettings) -> NDArray[np.float64]:
        """Return how far (6,) each joint may be from what it was sent during the last ``lag_s``."""
        return np.array(
            [settings.following_m if joint.prismatic else settings.following_rad for joint in self.model.joints]
        )


class Fault(Enum):
    """What is wrong with a real arm, as a sentence."""

    INVALID = "its encoders read something that is not a number, or the wrong number of joints"
    STALE = "its encoders were not sampled in time"
    FOLLOWING = "it does not follow its set-points"
    DEVICE = "its connection raised an error"
    LOST = "nobody publishes its state any more"
    PAUSED = "its controller is paused"
    DISABLED = "its controller is disabled"
    CONTROLLER = "its controller reports a fault"
    UNHOMED = "its controller says that it is not homed"
    OTHERS = "somebody else commands it"
    LATE = "its loop ran late"
    WATCHDOG = "its script gave no sign of life"
    ORPHANED = "the process of its script has ended"
    EMERGENCY = "the emergency stop was pressed"
    STEP = "a set-point would have been beyond its limits, and was not sent"
    GONE = "its loop has ended"


PASSING = frozenset({Fault.LATE, Fault.WATCHDOG, Fault.ORPHANED, Fault.GONE})
"""Faults of what is around an arm; after all others it refuses to move until its faults are cleared."""


class ArmFault(ArmStopped):
    """A real arm was stopped because something is wrong.

    Attributes:
        fault: what.
        detail: with which value, in words.
    """

    def __init__(self, arm: str, fault: Fault, detail: str = ""):
        self.fault, self.detail = fault, detail
        super().__init__(arm, f"arm {arm!r} was stopped: {fault.value}{f' ({detail})' if detail else ''}")
