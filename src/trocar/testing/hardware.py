"""What every real arm's loop has to do when something goes wrong: faults are planted between the loop and the arm."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.cell import Cell, MotionEnd, MotionResult
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import ArmFault, Connect, Fault, HardwareArm, HardwareReading, LoopSettings
from trocar.lab import Station
from trocar.motion import rest_to_rest
from trocar.testing.requirement import require

PLANTED = {
    "nan": Fault.INVALID,
    "stale": Fault.STALE,
    "frozen": Fault.FOLLOWING,
    "read raises": Fault.DEVICE,
    "send raises": Fault.DEVICE,
    "stall": Fault.LATE,
}
"""What can be planted, and the fault that the loop must report."""
EXACT = 1.001


class FaultyArm:
    """An arm whose connection fails while it moves.

    Args:
        arm: the arm.
        plant: what goes wrong, a key of ``PLANTED``.
        after: number of the moving set-point from which on it goes wrong.
    """

    def __init__(self, arm: HardwareArm, plant: str, after: int):
        self._arm, self._plant, self._after, self._count = arm, plant, after, 0
        self._frozen: HardwareReading | None = None

    def _now(self, plant: str) -> bool:
        return self._plant == plant and self._count >= self._after

    @property
    def behind(self) -> bool:
        """Return whether a part of the last set-point is still to be passed on."""
        return bool(getattr(self._arm, "behind", False))

    def commanded(self) -> tuple[NDArray[np.float64], float]:
        """Return the set-point that the arm holds."""
        return self._arm.commanded()

    def read(self) -> HardwareReading:
        """Return the encoders' state, or the planted fault."""
        read = self._arm.read()
        if self._now("read raises"):
            raise OSError("planted: the cable is cut")
        if self._now("nan"):
            return HardwareReading(np.full(6, np.nan), read.jaw_rad)
        if self._now("stale"):
            return HardwareReading(read.q, read.jaw_rad, read.age_s + 60.0)
        if self._now("frozen"):
            self._frozen = self._frozen or read
            return self._frozen
        return read

    def send(self, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: float) -> None:
        """Pass on a set-point, or produce the planted fault."""
        self._count += bool(np.any(velocity))
        if self._now("send raises"):
            raise OSError("planted: no such device")
        if self._now("stall") and self._count == self._after:
            time.sleep(0.3)
        self._arm.send(q, velocity, jaw_rad)

    def close(self) -> None:
        """Leave the arm holding."""
        self._arm.close()


def faulty(name: str, connect: Connect, plant: str, after: int = 8) -> FaultyArm:
    """Return a connected arm with a planted fault."""
    return FaultyArm(connect(name), plant, after)


def check_hardware(
    station: Station, connect: Connect, arm: str, *, span: float = 0.05, settings: LoopSettings | None = None
) -> None:
    """Check what the loop of a real arm does when its connection fails, one fault after the other; the arm **moves**.

    Args:
        station: the arm's station.
        connect: connects the arm, as for ``HardwareLaboratory``.
        arm: its name.
        span: share of each joint's range, towards its middle, by which it would move.
        settings: settings of the loop.

    Raises:
        CheckFailed: a fault is reported as another one, or the arm does not stop within its limits.
    """
    for plant, fault in PLANTED.items():
        with HardwareLaboratory(station, partial(faulty, connect=connect, plant=plant), settings) as laboratory:
            results: list[MotionResult] = []
            laboratory.run(partial(_moved, arm=arm, span=span, limits=station.arms[arm].limits, results=results), 60.0)
            subject = f"the loop of arm {arm!r} with {plant!r} planted"
            (result,) = results
            told = result.cause.fault if isinstance(result.cause, ArmFault) else None
            require(
                result.ended is MotionEnd.FAULT and told is fault, subject, f"tell {fault.name}, not {result.cause}"
            )
            require(not laboratory.cell.robot.setpoint(arm).moving, subject, "bring the arm to rest")
            use = max(laboratory.robot.limit_use(arm))
            require(use <= EXACT, subject, f"stay within the limits, not at {use:.3f} of them")


async def _moved(cell: Cell, *, arm: str, span: float, limits: MotionLimits, results: list[MotionResult]) -> None:
    model, here = cell.arms[arm], cell.robot.setpoint(arm).q
    away = here + np.where(here > model.middle, -span, span) * (model.upper - model.lower)
    slow = MotionLimits(limits.velocity / 4, limits.acceleration / 8)
    results.append((await cell.robot.move({arm: rest_to_rest(here, away, slow)}))[arm])
