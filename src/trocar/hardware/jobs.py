"""Requests of scripts to the loop of real arms: motions and jaw commands in progress, and their results."""

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
    """The motions, or the jaw command, that one call requested.

    Attributes:
        arms: that are not done yet.
        first: number of the job's first report.
        motions: by arm; empty for a jaw command.
        at_tick: when motions that take over begin; None: at once, from rest.
        endings: of the arms that are done.
        rows: reports on each of these arms, with their times on the machine's clock.
        refusal: why the job was not begun.
        over: set when all arms are done, or the job was refused.
        before: the motion that each arm takes over from, and its start on the loop's clock.
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
        """Note how the job ended for an arm, and the reports since it began; return whether all arms are done."""
        self.endings[arm] = ending
        self.arms.discard(arm)
        self.rows[arm] = [(report.time_s, report.arms[arm]) for report in reports]
        return not self.arms

    def result(self, arm: str, origin_s: float) -> MotionResult:
        """Return the result for an arm; times count from ``origin_s`` of the machine's clock."""
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
