"""Recorded commands, replayed in the cell: what they would have done on cables with errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.cell import MotionResult
from trocar.errors import InvalidInput, UnknownName
from trocar.eval.method import METHODS, AgentContext, Method
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.learn.poses import joints
from trocar.learn.read import Recorded, read_episode
from trocar.motion.moves import rest_to_rest
from trocar.registry import Lazy
from trocar.trajectory import Trajectory

WORLD, BASE = "world", "base"
METHOD, COMPENSATED = "recorded", "recorded-compensated"
REPLAYED = "replayed"
"""The event that a replay logs at its end."""
SLOWER = 1.05
"""Steps between frames take at least this multiple of the time that the velocity limits require."""
MOST_LATE = 6
"""Recorded arms are assumed to lag behind their commands by fewer frames than this."""
LOOK_S = 0.01


@dataclass(frozen=True)
class Source:
    """Settings of a replay.

    Attributes:
        data: folder of the data set.
        episode: number of the episode in it.
        frame: frame of its poses: ``world``, or each arm's own ``base``.
        digest: digest of its numbers, so that another episode at this place is another run.
    """

    data: str = ""
    episode: int = 0
    frame: str = WORLD
    digest: str = ""

    def __post_init__(self) -> None:
        if self.frame not in (WORLD, BASE):
            raise UnknownName("--frame", self.frame, (WORLD, BASE))


class Replay:
    """Moves to where the commands begin, then plays them, slower where the arms' limits require it."""

    def __init__(self, context: AgentContext):
        self.cell, self.source = context.cell, context.settings
        self.recorded = read_episode(self.source.data, self.source.episode)

    async def run(self) -> None:
        """Replay the episode."""
        cell, limits = self.cell, self.cell.limits
        rows = {arm: self._joints(arm, values) for arm, values in self.recorded.actions.items()}
        times_s = _times(rows, self.recorded.fps, {arm: limits[arm].velocity for arm in rows})
        await self._done(
            {arm: rest_to_rest(cell.robot.setpoint(arm).q, q[0, :6], limits[arm]) for arm, q in rows.items()}
        )
        for arm, q in rows.items():
            await cell.robot.jaw(arm, self._in_range(arm, float(q[0, 6])))
        paths = {arm: _through(times_s, q[:, :6]) for arm, q in rows.items()}
        began_s = cell.clock.now_s()
        async with trio.open_nursery() as nursery:
            for arm, q in rows.items():
                nursery.start_soon(self._follow_jaws, arm, times_s, q[:, 6])
            await self._done(paths)
            ended_s = cell.clock.now_s()
        told = {"start_s": began_s, "frames_s": [round(t, 4) for t in times_s.tolist()]}
        cell.log.event(REPLAYED, factor=(ended_s - began_s) / times_s[-1], **told)

    def _joints(self, arm: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        base = self.cell.T_world_base_registered[arm] if self.source.frame == WORLD else SE3.identity()
        return joints(self.cell.arms[arm], base, values, self.cell.robot.setpoint(arm).q)

    async def _done(self, motions: Mapping[str, Trajectory]) -> None:
        """Move, and raise the error that stopped an arm on its way."""
        results: Mapping[str, MotionResult] = await self.cell.robot.move(motions)
        for result in results.values():
            if result.cause is not None:
                raise result.cause

    async def _follow_jaws(self, arm: str, times_s: NDArray[np.float64], angles_rad: NDArray[np.float64]) -> None:
        """Command each new jaw angle when the arm's path reaches its frame; return when all jaws have arrived."""
        async with trio.open_nursery() as nursery:
            for frame in np.flatnonzero(np.diff(angles_rad)) + 1:
                while self.cell.robot.setpoint(arm).path_s < times_s[frame] - 1e-9:
                    await self.cell.clock.sleep(LOOK_S)
                nursery.start_soon(self.cell.robot.jaw, arm, self._in_range(arm, float(angles_rad[frame])))

    def _in_range(self, arm: str, angle_rad: float) -> float:
        jaw = self.cell.arms[arm].jaw
        return min(max(angle_rad, jaw.lower), jaw.upper)


def _times(
    rows: Mapping[str, NDArray[np.float64]], fps: float, velocity: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return when each frame is due: as recorded, but later where a step would exceed the limits (6,) of an arm."""
    needed = np.max([np.abs(np.diff(q[:, :6], axis=0) / velocity[arm]).max(axis=1) for arm, q in rows.items()], axis=0)
    return np.append(0.0, np.cumsum(np.maximum(1 / fps, SLOWER * needed)))


def _through(times_s: NDArray[np.float64], q: NDArray[np.float64]) -> Trajectory:
    """Return the spline through joints (n, 6), from rest to rest."""
    from scipy.interpolate import CubicSpline  # importing it takes half a second

    return Trajectory(times_s, CubicSpline(times_s, q, bc_type="clamped").c)


def register(task: str) -> None:
    """Register a task's methods that replay a data set: on raw encoders, and above the compensation."""
    about = "commands that a data set recorded, replayed"
    made = partial(Method, agent=Lazy("trocar.learn.replayed:Replay"), settings=Source)
    methods = {METHOD: made(about), COMPENSATED: made(f"{about}, cables compensated", calibrated=True)}
    for name, method in methods.items():
        if f"{task}/{name}" not in METHODS:
            METHODS.register(f"{task}/{name}", method)


@dataclass(frozen=True)
class Deviation:
    """How far an arm was from where it was recorded.

    Attributes:
        tip_end_m: distance of the tips at the end.
        tip_rms_m: RMS distance over all frames.
        tip_max_m: largest distance.
        jaw_end_rad: replayed minus recorded opening at the end.
        jaw_rms_rad: RMS difference over all frames.
    """

    tip_end_m: float
    tip_rms_m: float
    tip_max_m: float
    jaw_end_rad: float
    jaw_rms_rad: float


def deviations(trial: Trial, source: Source) -> tuple[dict[str, Deviation], dict[str, float]]:
    """Return each arm's true deviation from its recording, and the times ``recorded_s``, ``replayed_s``, ``lag_s``.

    Recorded states lag behind the actions. The lag is taken as the shift by which actions fit states best; each
    recorded state is compared with the replay that much earlier.

    Raises:
        InvalidInput: the replay did not come to its end; says why.
    """
    told = next((event for event in trial.events if event["name"] == REPLAYED), None)
    if told is None:
        raise InvalidInput("the replay", f"ended early ({trial.reason or trial.ended})", "see the trial")
    recorded = read_episode(source.data, source.episode)
    lag = _lag(recorded)
    frames_s = told["start_s"] + told["factor"] * np.array(told["frames_s"])
    ticks = np.minimum(np.rint(frames_s / trial.scenery.tick_s).astype(int), len(trial.times_s) - 1)
    found = {}
    for arm, actions in recorded.actions.items():
        there = recorded.states.get(arm, actions)
        kept = ticks[: len(ticks) - lag] if arm in recorded.states else ticks
        there = there[len(there) - len(kept) :]
        true = trial.arrays[f"true_{arm}"][kept].astype(np.float64)
        base = trial.scenery.T_world_base[arm] if source.frame == WORLD else SE3.identity()
        tips = (base @ fk(trial.scenery.arms[arm], true[:, :6])).translation_m
        apart, jaws = np.linalg.norm(tips - there[:, :3], axis=1), true[:, 6] - there[:, 7]
        rms = [float(np.sqrt(np.mean(values**2))) for values in (apart, jaws)]
        found[arm] = Deviation(float(apart[-1]), rms[0], float(apart.max()), float(jaws[-1]), rms[1])
    recorded_s = (recorded.frames - 1) / recorded.fps  # from the first frame to the last, as below
    times = {"recorded_s": recorded_s, "replayed_s": float(frames_s[-1] - frames_s[0])}
    return found, {**times, "lag_s": lag / recorded.fps}


def _lag(recorded: Recorded) -> int:
    """Return by how many frames states lag behind actions."""
    if not recorded.states:
        return 0
    most = min(MOST_LATE, recorded.frames - 1)

    def misfit(lag: int) -> float:
        pairs: list[Any] = [
            recorded.actions[arm][: recorded.frames - lag, :3] - recorded.states[arm][lag:, :3]
            for arm in recorded.states
        ]
        return float(np.mean([np.linalg.norm(pair, axis=1).mean() for pair in pairs]))

    return min(range(most), key=misfit)
