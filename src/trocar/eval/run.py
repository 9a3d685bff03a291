"""Run trials of a task in a prepared session."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import trio

from trocar.calibration.fleet import FleetPrior
from trocar.calibration.models import CableModel
from trocar.cell import Cell
from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.eval.method import AgentContext, begun, objects_of, pick_perception
from trocar.eval.prepare import Prepared
from trocar.eval.staged import AGENT_ERROR, FAULT, OUT_OF_TIME, End, StagedTrial
from trocar.eval.trial import Trial
from trocar.hardware.laboratory import HardwareLaboratory
from trocar.motion import PLANNERS
from trocar.registry import Lazy
from trocar.robots import Adaptive, Compensated
from trocar.sim.laboratory import Listener, SimLaboratory
from trocar.sim.pace import Pace, Script
from trocar.sim.world import PhysicsError

OBSERVED = Lazy("trocar.learn.observed:Observed")
"""Wrapper of an agent that also records what a policy would observe."""


class Attendant(Pace, Protocol):
    """Attends a trial while it runs, and sets the pace of a simulator's clock: a person at a console."""

    def attend(self, config: RunConfig, laboratory: SimLaboratory | HardwareLaboratory) -> None:
        """Set up for a trial in this laboratory, whose robot nothing has wrapped yet."""
        ...

    async def serve(self, cell: Cell) -> None:
        """Act beside the agent, until cancelled."""
        ...

    def heard(self, event: Mapping[str, object]) -> None:
        """Receive an event of the log."""
        ...

    @property
    def asks(self) -> bool:
        """Return whether a script waits for the person's answer."""
        ...


def run_trial(
    config: RunConfig,
    prepared: Prepared,
    index: int,
    listener: Listener | None = None,
    *,
    raise_errors: bool = False,
    attendant: Attendant | None = None,
) -> Trial:
    """Run one trial of a session and return it.

    Args:
        config: the run's configuration.
        prepared: the session.
        index: the trial's number in its session.
        listener: called with each event of the scripts.
        raise_errors: whether an exception of the agent is raised; else it ends the trial, which keeps its traceback.
        attendant: a person beside the trial.

    Raises:
        PhysicsError: the simulation broke down; the trial is void.
        InvalidInput: the task does not score each of its goals.
    """
    began = time.perf_counter()
    staged = StagedTrial(config, prepared, index, heard_by(listener, attendant))
    laboratory, run = staged.laboratory, staged.laboratory.run
    if attendant is not None:
        attendant.attend(config, laboratory)
        run = partial(_run_attended, laboratory, attendant)
    context = equipped(config, laboratory, prepared.models, prepared.priors, staged.agent_rng)
    try:
        end = play_agent(run, config, context, raise_errors)
    except Exception as error:
        error.add_note(f"in session {prepared.number}, trial {index} of seed {config.seed}, method {config.method!r}")
        raise
    return staged.finished(end, time.perf_counter() - began, context.settings)


def heard_by(listener: Listener | None, attendant: Attendant | None) -> Listener | None:
    """Return a listener that passes each event on to both; None if there is neither."""
    if attendant is None or listener is None:
        return attendant.heard if attendant is not None else listener

    def tell(event: Mapping[str, object]) -> None:
        listener(event)
        attendant.heard(event)

    return tell


def _run_attended(laboratory: SimLaboratory, attendant: Attendant, script: Script, budget_s: float) -> bool:
    """Run a script with an attendant beside it; return whether it ended in time."""

    async def both(cell: Cell) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(attendant.serve, cell)
            await script(cell)
            nursery.cancel_scope.cancel()

    return laboratory.run(both, budget_s, attendant)


def equipped(
    config: RunConfig,
    laboratory: SimLaboratory | HardwareLaboratory,
    models: Mapping[str, CableModel],
    priors: Mapping[str, FleetPrior],
    rng: np.random.Generator,
) -> AgentContext:
    """Wrap a laboratory's robot as the run's method needs it; return the agent's context."""
    method, task = config.chosen_method, config.task
    compensate(config, laboratory, models, priors)
    settings = method.make_settings(config.settings)
    if method.wrap_robot is not None:
        laboratory.wrap_robot(lambda cell: method.wrapped(cell, settings))
    return AgentContext(
        cell=laboratory.cell,
        goals=task.goals(),
        nominal=task.nominal(),
        arms=config.arms,
        planner=PLANNERS[config.planner],
        perception=pick_perception(type(task), config.perception) if config.perception else None,
        rng=rng,
        settings=settings,
        objects=objects_of(task, laboratory.cell),
    )


def compensate(
    config: RunConfig,
    laboratory: SimLaboratory | HardwareLaboratory,
    models: Mapping[str, CableModel],
    priors: Mapping[str, FleetPrior],
) -> None:
    """Wrap a laboratory's robot so that it compensates its cables, if there are models; with priors, it also learns."""

    def wrapped(cell: Cell) -> Compensated:
        given = cell.robot, cell.arms, models, cell.limits, cell.clock, cell.log
        if priors:
            return Adaptive(*given, priors=priors)
        return Compensated(*given, stop_at_limits=config.chosen_method.stop_at_limits)

    if models:
        laboratory.wrap_robot(wrapped)


def play_agent(
    run: Callable[[Script, float], bool], config: RunConfig, context: AgentContext, raise_errors: bool
) -> End:
    """Make an agent and run it with ``run``, such as a laboratory's method; return how it ended."""
    budget_s = config.task.budget_s
    try:
        agent = config.chosen_method.make_agent(context)
        agent = OBSERVED.load()(agent, context) if config.observations else agent
        in_time = run(lambda cell: begun(agent), budget_s)
    except PhysicsError:
        raise
    except (TrocarError, OSError) as error:  # refused by the guard, or a device that does not answer
        return End(FAULT, str(error), error=type(error).__name__)
    except SystemExit as error:
        return End(FAULT, f"the script tried to exit the program (exit code {error.code})")
    except Exception as error:
        if raise_errors:
            raise
        frame = traceback.extract_tb(error.__traceback__)[-1]
        line = f"{Path(frame.filename).name}, line {frame.lineno}"
        reason = f"the agent raised {type(error).__name__}: {error} ({line})"
        return End(AGENT_ERROR, reason, "".join(traceback.format_exception(error)))
    return End() if in_time else End(OUT_OF_TIME, f"the script had not finished after {budget_s:g} s")
