"""Runs trials of a task in a prepared session."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np

from trocar.cell import Cell
from trocar.errors import TrocarError
from trocar.eval.config import TRIALS, RunConfig
from trocar.eval.images import encoded
from trocar.eval.method import Agent, AgentContext, pick_perception
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.scenery import Scenery
from trocar.eval.trial import Trial
from trocar.lab import SensorFlaws
from trocar.motion import PLANNERS
from trocar.robots import TICK_S, Adaptive, Compensated
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.recorder import fixed_poses, solids_of
from trocar.sim.world import PhysicsError

DONE, FAULT, OUT_OF_TIME = "done", "FAULT", "OUT_OF_TIME"

Listener = Callable[[Mapping[str, object]], None]

__all__ = ["DONE", "FAULT", "OUT_OF_TIME", "Prepared", "free_memory", "plain", "prepare", "run_trial"]


def run_trial(config: RunConfig, prepared: Prepared, index: int, listener: Listener | None = None) -> Trial:
    """Run one trial of a session and return it.

    Args:
        config: of the run.
        prepared: the session.
        index: of the trial in its session.
        listener: called with each event of the scripts.

    Raises:
        PhysicsError: the simulation broke down; the trial is void.
    """
    began = time.perf_counter()
    seeds = config.seeds(prepared.number, TRIALS, index)
    scene_rng, noise_rng, agent_rng = map(np.random.default_rng, seeds.spawn(3))
    task, method, station = config.task, config.chosen_method, config.laboratory
    laboratory = SimLaboratory(
        prepared.session,
        task.world(task.scene(scene_rng, station)),
        noise_rng,
        flaws=SensorFlaws.none() if config.flawless_camera else None,
        listener=listener,
    )
    if prepared.models:
        laboratory.wrap_robot(lambda cell: _compensated(config, prepared, cell))
    settings = method.default_settings()
    if method.wrap_robot is not None:
        laboratory.wrap_robot(lambda cell: method.wrapped(cell, settings))
    context = AgentContext(
        cell=laboratory.cell,
        goals=task.goals(),
        nominal=task.nominal(),
        arms=config.arms,
        planner=PLANNERS[config.planner],
        perception=pick_perception(type(task), config.perception) if config.perception else None,
        rng=agent_rng,
        settings=settings,
    )
    solids, fixed = solids_of(laboratory.world), fixed_poses(laboratory.world)
    try:
        ended, reason = _play(laboratory, method.made(context), task.budget_s)
    except Exception as error:
        error.add_note(f"in session {prepared.number}, trial {index} of seed {config.seed}, method {config.method!r}")
        raise
    wall_s = time.perf_counter() - began
    if ended != DONE:
        laboratory.log.event("stopped", outcome=ended, reason=reason)
    record = laboratory.record()
    scores = task.score(laboratory.task.truth(record), laboratory.log.events)
    blobs, cameras = encoded(laboratory.cameras)
    return Trial(
        about={
            **config.about(),
            "fingerprint": config.fingerprint,
            "session": prepared.number,
            "index": index,
            "settings": plain(settings),
            "transmissions": {arm: found.source for arm, found in prepared.session.transmissions.items()},
        },
        scores=[asdict(score) for score in scores],
        spans=laboratory.log.spans,
        events=laboratory.log.events,
        collisions=[asdict(c) for c in record.collisions],
        ended=ended,
        reason=reason,
        duration_s=round(laboratory.now_s(), 6),
        command_limit_use={arm: laboratory.driver.limit_use(arm) for arm in station.arms},
        arrays={
            **{name: rows.astype(np.float32) for name, rows in laboratory.recorder.arrays().items()},
            **laboratory.task.arrays(record),
        },
        scenery=Scenery(
            solids=solids,
            T_world_body=fixed,
            arms=prepared.session.models,
            T_world_base=prepared.session.T_world_base,
            T_world_base_registered=prepared.session.T_world_base_registered,
            cameras=cameras,
            tick_s=TICK_S,
        ),
        images=blobs,
        computations=laboratory.log.computations,
        wall_s=wall_s,
    )


def free_memory() -> None:
    """Free the worlds of trials that have ended.

    Their parts refer to one another, and Python collects such cycles so rarely that a run of ten trials held 2 GB.
    """
    gc.collect()


def _compensated(config: RunConfig, prepared: Prepared, cell: Cell) -> Compensated:
    """Return the cell's robot with its cables compensated."""
    limits = {name: arm.limits for name, arm in config.laboratory.arms.items()}
    if prepared.priors:
        return Adaptive(cell.robot, cell.arms, prepared.models, prepared.priors, limits, cell.clock, cell.log)
    stop = config.chosen_method.stop_at_limits
    return Compensated(cell.robot, cell.arms, prepared.models, limits, cell.clock, cell.log, stop_at_limits=stop)


def _play(laboratory: SimLaboratory, agent: Agent, budget_s: float) -> tuple[str, str]:
    """Run an agent; return how it ended, and a sentence if something stopped it."""
    try:
        in_time = laboratory.run(lambda cell: agent.run(), budget_s)
    except PhysicsError:
        raise
    except (TrocarError, OSError) as error:  # refused by the guard, or a device that does not answer
        return FAULT, str(error)
    except SystemExit as error:
        return FAULT, f"the script tried to exit the program (exit code {error.code})"
    return (DONE, "") if in_time else (OUT_OF_TIME, f"the script had not finished after {budget_s:g} s")


def plain(settings: Any) -> Any:
    """Return settings as JSON values."""
    if is_dataclass(settings) and not isinstance(settings, type):
        return {name: plain(value) for name, value in vars(settings).items()}
    return settings.tolist() if isinstance(settings, np.ndarray) else settings
