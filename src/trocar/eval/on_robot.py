"""Run trials of a task on real arms, without a drawn session and without a referee."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, replace
from functools import partial

import numpy as np
import trio

from trocar.calibration.fleet import FleetPrior, expected, load_prior
from trocar.calibration.models import CableModel, load_model
from trocar.cell import Cell
from trocar.eval.config import TRIALS, RunConfig
from trocar.eval.run import Attendant, equipped, heard_by, play_agent
from trocar.eval.sight import robot_scenery
from trocar.eval.staged import DONE, End, Photographer, encoded, plain
from trocar.eval.trial import Trial
from trocar.hardware.kinds import robot_of
from trocar.hardware.laboratory import HardwareLaboratory
from trocar.log import machine_speed
from trocar.sim.laboratory import Listener
from trocar.sim.pace import Script

STOPPED = "STOPPED"
"""Outcome of a trial that a person stopped."""
ASKED_S = 0.1
"""Interval at which to check whether a script waits for a person."""
SESSION = 0
"""Number of the only session of a robot's run."""


def run_on_robot(
    config: RunConfig, index: int, listener: Listener | None = None, attendant: Attendant | None = None
) -> Trial:
    """Connect the arms, run one trial, leave the arms holding; return the trial, whatever ended it.

    The trial has no true joints, bodies or collisions, which nobody knows. Its scores are what the script itself noted
    (``Task.told``), and ``Trial.on_robot`` says so.

    Args:
        config: the run's configuration, with ``robot``.
        index: the trial's number.
        listener: called with each event of the scripts.
        attendant: a person beside the trial.

    Raises:
        TrocarError: an arm or a camera cannot be connected; nothing has moved then.
    """
    began = time.perf_counter()
    config.task.told([])  # a task that needs a referee raises before anything moves
    models, priors = models_of(config)
    kind, _ = robot_of(config.robot)
    with kind.connect(config.laboratory, heard_by(listener, attendant)) as laboratory:
        if attendant is not None:
            attendant.attend(config, laboratory)
        context = equipped(config, laboratory, models, priors, config.rng(SESSION, TRIALS, index))
        run = partial(_run_until_refused, laboratory, attendant)
        try:
            end = play_agent(run, config, context, raise_errors=False)
        except KeyboardInterrupt:
            end = End(STOPPED, "a person stopped it (Ctrl-C)")
        if end.outcome != DONE:
            more = {"traceback": end.where, "error": end.error}
            told = {name: value for name, value in more.items() if value}
            laboratory.log.event("stopped", outcome=end.outcome, reason=end.reason, **told)
        duration_s = laboratory.cell.clock.now_s()
    # only after the loop is closed, because until then an arm may have a last tick to go
    return _trial(config, index, laboratory, end, duration_s, plain(context.settings), time.perf_counter() - began)


def _run_until_refused(
    laboratory: HardwareLaboratory, attendant: Attendant | None, script: Script, budget_s: float
) -> bool:
    """Run a script until it ends, its budget is spent, or an arm refuses to move; return whether it ended in time."""

    async def attended(cell: Cell) -> None:
        budget.deadline = trio.current_time() + budget_s
        with budget:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(laboratory.robot.refusal)
                if attendant is not None:
                    nursery.start_soon(attendant.serve, cell)
                    nursery.start_soon(_lengthen, budget, attendant)
                await script(cell)
                nursery.cancel_scope.cancel()

    budget, error = trio.CancelScope(), None
    try:
        laboratory.run(attended, math.inf)
    except Exception as other:
        error = other
    if (why := laboratory.robot.refused or error) is not None:  # a refusal comes before the script's own errors
        raise why
    return not budget.cancelled_caught


async def _lengthen(budget: trio.CancelScope, attendant: Attendant) -> None:
    """Exclude the time that a script waits for a person's answer from its budget, as in the simulator."""
    while True:
        await trio.sleep(ASKED_S)
        if attendant.asks:
            budget.deadline += ASKED_S


def models_of(config: RunConfig) -> tuple[dict[str, CableModel], dict[str, FleetPrior]]:
    """Return the cable models of the working arms, and their priors if the method learns.

    Raises:
        BadFile: a file is not a cable model.
    """
    if config.chosen_method.learns:
        prior = load_prior(config.prior)
        station, task = config.laboratory, config.task
        return {arm: expected(prior, task.calibration(station, arm)) for arm in config.arms}, dict.fromkeys(
            config.arms, prior
        )
    return {arm: load_model(path) for arm, path in config.cable_files().items()}, {}


def _trial(
    config: RunConfig,
    index: int,
    laboratory: HardwareLaboratory,
    end: End,
    duration_s: float,
    settings: object,
    wall_s: float,
) -> Trial:
    station, robot, log = config.laboratory, laboratory.robot, laboratory.log
    lead_s = robot.settings.lead_ticks * robot.settings.tick_s
    arrays = laboratory.record.arrays(robot.origin_s, lead_s)
    kept = {name: camera for name, camera in laboratory.cameras.items() if isinstance(camera, Photographer)}
    blobs, cameras = encoded(kept)
    return Trial(
        about={
            **config.about(),
            "fingerprint": config.fingerprint,
            "session": SESSION,
            "index": index,
            "tally": None,
            "settings": settings,
        },
        scores=[asdict(score) for score in config.task.told(log.events)],
        spans=log.spans,
        events=log.events,
        collisions=[],
        ended=end.outcome,
        reason=end.reason,
        duration_s=round(duration_s, 6),
        command_limit_use={arm: robot.limit_use(arm) for arm in station.arms},
        arrays={name: rows.astype(np.float32) for name, rows in arrays.items()} | log.series,
        scenery=replace(robot_scenery(station), cameras=cameras),
        images=blobs,
        computations=log.computations,
        machine_speed=machine_speed(),
        wall_s=wall_s,
    )
