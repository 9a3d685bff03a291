"""What scripts have asked a loop of real arms for and what came of it: motions and jaws on their way to an end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.cell import MotionResult
from trocar.errors import TrocarError
from trocar.hardware.messages import ArmReport, Report
from trocar.robots.executor import Ending
from trocar.trajectory import Trajectory


@dataclass
class Job:
    """Motions, or jaws, that were asked for in one call.

    Attributes:
        arms: those that are not done yet.
        first: number of the report from which on it is theirs.
        motions: by arm; none of jaws.
        at_tick: of motions that take over, when.
        endings: of the arms that are done.
        rows: what they were sent and read meanwhile, and when on the machine's clock.
        refusal: why it was not begun.
        over: set when all arms are done.
        before: the motion that each arm takes over from, and when that began on the loop's clock.
    """

    arms: set[str]
    first: int
    motions: Mapping[str, Trajectory] = field(default_factory=dict)
    at_tick: int | None = None
    endings: dict[str, Ending] = field(default_factory=dict)
    rows: dict[str, list[tuple[float, ArmReport]]] = field(default_factory=dict)
    refusal: TrocarError | None = None
    over: trio.Event = field(default_factory=trio.Event)
    before: dict[str, tuple[Trajectory, float] | None] = field(default_factory=dict)

    def end(self, arm: str, ending: Ending, reports: Iterable[Report]) -> bool:
        """Note how it ended for an arm, with the reports since it began; return whether all arms are done."""
        self.endings[arm] = ending
        self.arms.discard(arm)
        self.rows[arm] = [(report.time_s, report.arms[arm]) for report in reports]
        return not self.arms

    def result(self, arm: str, origin_s: float) -> MotionResult:
        """Return what an arm did; times count from ``origin_s`` of the machine's clock."""
        rows, ending = self.rows.get(arm, []), self.endings[arm]
        return MotionResult(
            times_s=np.array([time_s - origin_s for time_s, _ in rows]),
            commanded=_stacked([report.sent for _, report in rows]),
            measured=_stacked([np.append(report.reading.q, report.reading.jaw_rad) for _, report in rows]),
            ended=ending.ended,
            cause=ending.cause,
        )


def _stacked(rows: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.array(rows, dtype=np.float64).reshape(-1, 7)
