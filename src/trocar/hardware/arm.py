"""Real arms as their loop sees them: the driver protocol, the loop's tolerances, and faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import ArmStopped, InvalidValue
from trocar.hardware.priority import HIGHEST, PRIORITY
from trocar.robots.driver import TICK_S


@dataclass(frozen=True)
class HardwareReading:
    """One encoder reading of a real arm.

    Attributes:
        q: (6,) joints, rad and m.
        jaw_rad: opening of the jaws.
        age_s: time since the encoders were sampled; 0 if the arm does not know it.
    """

    q: NDArray[np.float64]
    jaw_rad: float
    age_s: float = 0.0


class HardwareArm(Protocol):
    """Driver of one real arm; each call must return within a fraction of a tick.

    The driver lives in the loop's process. Any exception stops the arm and is reported to the script that moved it; an
    ``ArmFault`` from ``read`` keeps its kind. A driver that passes a set-point on in parts may have an attribute
    ``behind``. While it is true, the motions of all arms wait and the set-point is sent again, so a stop leaves no part
    unsent.
    """

    def commanded(self) -> tuple[NDArray[np.float64], float]:
        """Return the joints (6,) and jaw angle that the controller holds now; they are the first set-point."""
        ...

    def read(self) -> HardwareReading:
        """Return the latest encoder reading."""
        ...

    def send(self, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: float) -> None:
        """Send the set-point of this tick: joints (6,), their velocities, and the jaws' opening."""
        ...

    def close(self) -> None:
        """Close the connection and leave the arm holding its position."""
        ...


Connect = Callable[[str], HardwareArm]
"""Connects an arm by its name, in the loop's process: a module-level function or class, or a ``partial`` of one."""


@dataclass(frozen=True)
class LoopSettings:
    """Timing and tolerances of the loop that drives real arms.

    Attributes:
        tick_s: period of the set-points.
        lead_ticks: a motion that replaces a running one starts this many ticks after the last report, so that it
            reaches the loop in time.
        max_late: fault if more ticks than this, within a second, are late by more than half a period.
        max_stall_s: fault if one tick is later than this.
        stale_s: fault if an encoder reading is older than this.
        lag_s: time by which an arm may lag behind its set-points.
        following_rad: fault if a revolute joint reads further than this from every set-point of the last ``lag_s``.
        following_m: likewise for a prismatic joint.
        watchdog_s: arms brake if the scripts' process gives no sign of life for this long.
        priority: of the loop under Linux's real-time scheduler, where permitted, up to 99; 0: ordinary.
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
            if not 0 < getattr(self, name) < math.inf:
                raise InvalidValue(f"{name} of a hardware loop", getattr(self, name), "give a finite number above 0")
        for name, least, most in (("lead_ticks", 1, math.inf), ("max_late", 0, math.inf), ("priority", 0, HIGHEST)):
            value = getattr(self, name)
            if not (isinstance(value, int | np.integer) and least <= value <= most):
                bounds = f"{least} to {most}" if most < math.inf else f"{least} or more"
                raise InvalidValue(f"{name} of a hardware loop", value, f"give a whole number, {bounds}")


@dataclass(frozen=True, eq=False)
class DrivenArm:
    """Model and limits of an arm, as its loop needs them.

    Attributes:
        model: of the arm; braking stays within its joints' ranges.
        limits: of velocity and acceleration, for all set-points and for braking.
    """

    model: ArmModel
    limits: MotionLimits

    def following(self, settings: LoopSettings) -> NDArray[np.float64]:
        """Return how far (6,) each joint may read from every set-point of the last ``lag_s``."""
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
"""Faults of an arm's surroundings. After any other fault, the arm refuses to move until its faults are cleared."""


class ArmFault(ArmStopped):
    """A real arm was stopped because something is wrong.

    Attributes:
        fault: kind of fault.
        detail: the value that was wrong, in words.
    """

    def __init__(self, arm: str, fault: Fault, detail: str = ""):
        self.fault, self.detail = fault, detail
        super().__init__(arm, f"arm {arm!r} was stopped: {fault.value}{f' ({detail})' if detail else ''}")
