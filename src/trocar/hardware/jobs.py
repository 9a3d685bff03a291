"""Requests of scripts to the loop of real arms: motions and jaw commands in progress, and their results."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.cell import MotionEnd, MotionResult
from trocar.errors import ArmStopped, TrocarError
from trocar.hardware.messages import ArmReport, Reason, Report
from trocar.robots.executor import Ending
from trocar.trajectory import Trajectory

Began = tuple[Trajectory, float]
"""A motion, and its start on the loop's clock, s."""


@dataclass
class Job:
    """The motions, or the jaw command, that one call requested.

    Attributes:
        key: by which the loop's reports name the job; a later job or stop has a greater one.
        arms: that are not done yet.
        first: number of the job's first report.
        motions: by arm; empty for a jaw command.
        at_tick: when motions that take over begin; None: at once, from rest.
        endings: of the arms that are done.
        rows: reports on each of these arms, with their times on the machine's clock.
        refusal: why the job was not begun.
        over: set when all arms are done, or the job was refused.
        began: the motion of each arm.
        before: the motion that each arm takes over from.
    """

    key: int
    arms: set[str]
    first: int
    motions: Mapping[str, Trajectory] = field(default_factory=dict)
    at_tick: int | None = None
    endings: dict[str, Ending] = field(default_factory=dict)
    rows: dict[str, list[tuple[float, ArmReport]]] = field(default_factory=dict)
    refusal: TrocarError | None = None
    over: trio.Event = field(default_factory=trio.Event)
    began: Mapping[str, Began] = field(default_factory=dict)
    before: dict[str, Began | None] = field(default_factory=dict)

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


class Jobs:
    """The jobs in progress, the reports and reasons that they still need, and what the arms execute for them.

    Attributes:
        executing: the motion that each arm was last told to execute.
        braking: arms that are coming to rest before the end of their motion.
    """

    def __init__(self) -> None:
        self.executing: dict[str, Began] = {}
        self.braking: set[str] = set()
        self._keys = itertools.count()
        self._running: dict[int, Job] = {}  # the oldest first
        self._reasons: dict[int, TrocarError | str] = {}
        self._rows: deque[Report] = deque()
        self._row = 0  # number of the first report in _rows

    def begin(
        self,
        arms: Iterable[str],
        motions: Mapping[str, Trajectory] | None = None,
        at_tick: int | None = None,
        start_s: float = 0.0,
    ) -> Job:
        """Return a new job; its motions start at ``start_s`` of the loop's clock."""
        began = {name: (motion, start_s) for name, motion in (motions or {}).items()}
        before = {name: self.executing.get(name) for name in began}
        key, first = next(self._keys), self._row + len(self._rows)
        job = Job(key, set(arms), first, dict(motions or {}), at_tick, began=began, before=before)
        self._running[key] = job
        self.executing |= began
        return job

    def latest(self, arm: str) -> Job | None:
        """Return the latest job that is to move an arm's joints and has not ended for it; None: there is none."""
        jobs = reversed(self._running.values())
        return next((job for job in jobs if arm in job.motions and arm in job.arms), None)

    def reason(self, given: TrocarError | str) -> Reason:
        """Return the stand-in for the reason of a stop, which is kept while a job that it may end is in progress."""
        key = next(self._keys)
        self._reasons[key] = given
        return Reason(key)

    def take(self, report: Report) -> None:
        """Note what a report says of the jobs: the calls that wait for those that are over go on."""
        self._rows.append(report)
        for name, arm in report.arms.items():
            if arm.braking is not None:
                self.braking.add(name)
                self.executing[name] = arm.braking
            elif not arm.setpoint.moving:
                self.braking.discard(name)
        for key, refusal in report.refused:
            if key in self._running:
                self._refuse(self._running.pop(key), refusal)
        for key, name, ending in report.over:
            if key in self._running:
                self._end(self._running[key], name, ending)
        self._forget()

    def end(self, cause: TrocarError) -> None:
        """End all jobs by a fault."""
        for job in list(self._running.values()):
            for name in list(job.arms):
                self._end(job, name, Ending(MotionEnd.FAULT, cause))
        self._forget()

    def _end(self, job: Job, name: str, ending: Ending) -> None:
        if isinstance(ending.cause, Reason):
            ending = Ending(ending.ended, self._given(name, ending.ended, ending.cause))
        if job.end(name, ending, itertools.islice(self._rows, max(0, job.first - self._row), None)):
            self._running.pop(job.key).over.set()

    def _refuse(self, job: Job, refusal: TrocarError) -> None:
        """End a job that was not begun: the motions that it was to replace go on."""
        job.refusal = self._given(next(iter(job.motions)), MotionEnd.HELD, refusal)
        for name, before in job.before.items():
            for other in self._running.values():
                if other.before.get(name) is job.began[name]:
                    other.before[name] = before
            if self.executing.get(name) is job.began[name]:
                self.executing.pop(name)
                self.executing |= {} if before is None else {name: before}
        job.over.set()

    def _given(self, arm: str, ended: MotionEnd, error: TrocarError) -> TrocarError:
        """Return the error that a stop was given, in place of its stand-in."""
        if not isinstance(error, Reason):
            return error
        given = self._reasons[error.key]
        return given if isinstance(given, TrocarError) else ArmStopped(arm, given or ended.value)

    def _forget(self) -> None:
        """Forget reports and reasons that are older than all jobs need: a stop ends only jobs begun before it."""
        oldest = next(iter(self._running.values()), None)
        first = self._row + len(self._rows) if oldest is None else oldest.first
        while self._row < first:
            self._rows.popleft()
            self._row += 1
        if oldest is None:
            self._reasons.clear()
        else:
            self._reasons = {key: given for key, given in self._reasons.items() if key > oldest.key}


def _stacked(rows: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.array(rows, dtype=np.float64).reshape(-1, 7)
