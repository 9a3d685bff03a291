"""Runs trials: draws a session, calibrates it, plays the task."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trocar.calibration.models import MODELS, CableModel, load_model, save_model
from trocar.calibration.session import refit_offset
from trocar.cell import Cell
from trocar.errors import TrocarError
from trocar.motion import PLANNERS
from trocar.robots import TICK_S, Calibrated
from trocar.sim.laboratory import SimLaboratory, arrays_of
from trocar.sim.recorder import fixed_poses, solids_of
from trocar.sim.recording import record_motion
from trocar.sim.world import PhysicsError
from trocar.station import SensorFlaws
from trocar.station.session import Session, draw_session
from trocar.tasks.kit import Agent, Brief, pick_perception
from trocar.trials.config import CALIBRATION, REFIT, REMOUNT, SESSION, TRIALS, RunConfig, fingerprint
from trocar.trials.images import encoded
from trocar.trials.scenery import Scenery
from trocar.trials.trial import Trial, session_folder

REFIT_SAMPLES = 30
"""Samples of a quick refit of the cables' offsets after instruments were mounted again."""

DONE, FAULT, OUT_OF_TIME = "done", "FAULT", "OUT_OF_TIME"

Listener = Callable[[Mapping[str, object]], None]


@dataclass(frozen=True, eq=False)
class Prepared:
    """A session that is ready for its trials.

    Attributes:
        number: of the session in its run.
        session: the day; simulator truth.
        models: the cable model of each working arm, where the method compensates.
    """

    number: int
    session: Session
    models: Mapping[str, CableModel]


def prepare(config: RunConfig, number: int, folder: Path) -> Prepared:
    """Return one session of a run, calibrated where the method wants that.

    A fitted model is kept in the session's folder, so that an interrupted run does not fit it again; it is always the
    model of that file that is used, so that a resumed run computes what an uninterrupted one does.
    """
    session = draw_session(config.laboratory, config.rng(number, SESSION))
    home = session_folder(folder, number)
    home.mkdir(parents=True, exist_ok=True)
    models: dict[str, CableModel] = {}
    if config.chosen_method.calibrated:
        for place, arm in enumerate(config.arms):
            path = cable_file(folder, number, arm)
            if not path.is_file():
                rng = config.rng(number, CALIBRATION, place)
                recording = record_motion(session, arm, rng, config.task.calibration(config.laboratory, arm))
                save_model(MODELS.pick(config.model).fit(recording, rng), path, config.fingerprint)
            models[arm] = load_model(path, config.fingerprint)
    if config.new_session:
        session = session.remounted(config.rng(number, REMOUNT))
    if config.refit_offsets:
        for place, (arm, model) in enumerate(models.items()):
            box = config.task.calibration(config.laboratory, arm)
            recording = record_motion(session, arm, config.rng(number, REFIT, place), box, REFIT_SAMPLES)
            models[arm] = refit_offset(model, recording)
    return Prepared(number, session, models)


def cable_file(folder: Path, number: int, arm: str) -> Path:
    """Return where the cable model of an arm in a session of a run lies."""
    return session_folder(folder, number) / f"cables_{arm}.npz"


NO_MATTER = {"variant", "options", "arms", "method", "planner", "perception", "new_session", "refit_offsets"}
"""What of a run its fitted cable models do not depend on."""


def calibration_key(config: RunConfig, arm: str) -> str:
    """Return a digest of all that the fitted model of an arm depends on: runs with the same one can share it."""
    about = {key: value for key, value in config.about().items() if key not in NO_MATTER}
    box = config.task.calibration(config.laboratory, arm)
    return fingerprint({**about, "arm": arm, "place": config.arms.index(arm), "motion": repr(box)})


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
        laboratory.wear(lambda cell: _calibrated(config, prepared, cell))
    settings = method.default_settings()
    brief = Brief(
        cell=laboratory.cell,
        goals=task.goals(),
        known=task.known(),
        arms=config.arms,
        planner=PLANNERS[config.planner],
        perception=pick_perception(type(task), config.perception) if config.perception else None,
        rng=agent_rng,
        settings=settings,
    )
    solids, fixed = solids_of(laboratory.world), fixed_poses(laboratory.world)
    ended, reason = _play(laboratory, method.made(brief), task.budget_s)
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
            **{name: rows.astype(np.float32) for name, rows in arrays_of(laboratory.recorder).items()},
            **laboratory.task.arrays(record),
        },
        scenery=Scenery(
            solids=solids,
            T_world_body=fixed,
            arms=station.models,
            T_world_base=prepared.session.T_world_base,
            T_world_base_registered=prepared.session.T_world_base_registered,
            cameras=cameras,
            tick_s=TICK_S,
        ),
        images=blobs,
        computations=laboratory.log.computations,
        wall_s=wall_s,
    )


def _calibrated(config: RunConfig, prepared: Prepared, cell: Cell) -> Calibrated:
    return Calibrated(
        cell.robot,
        cell.arms,
        prepared.models,
        {name: arm.limits for name, arm in config.laboratory.arms.items()},
        cell.clock,
        cell.log,
        stop_at_limits=config.chosen_method.stop_at_limits,
    )


def _play(laboratory: SimLaboratory, agent: Agent, budget_s: float) -> tuple[str, str]:
    """Run an agent; return how it ended, and a sentence where something stopped it."""
    try:
        in_time = laboratory.run(lambda cell: agent.run(), budget_s)
    except PhysicsError:
        raise
    except (TrocarError, OSError) as error:  # refused by the guard, or a device that does not answer
        return FAULT, str(error)
    return (DONE, "") if in_time else (OUT_OF_TIME, f"the script was not done after {budget_s:g} s")


def plain(settings: Any) -> Any:
    """Return settings as JSON's values."""
    if is_dataclass(settings) and not isinstance(settings, type):
        return {name: plain(value) for name, value in vars(settings).items()}
    return settings.tolist() if isinstance(settings, np.ndarray) else settings
