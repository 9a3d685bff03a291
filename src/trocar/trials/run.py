"""Runs trials: draws the session, calibrates, plays the task, keeps each trial as it ends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trio

from trocar.agents import AGENTS, SETTINGS
from trocar.arms import MOTION_LIMITS
from trocar.calibration.compensation import Compensator
from trocar.calibration.models import MODELS, CableModel, load_model, save_model
from trocar.calibration.session import refit_offset
from trocar.cell import Cell, Robot
from trocar.errors import TrocarError
from trocar.robots import Calibrated, Guarded, Recorded
from trocar.sim.cell import SimulatedCell
from trocar.sim.photograph import Photographer
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.sim.session import Session, draw_session, record_motion
from trocar.sutures.plan_file import PlannedSutures
from trocar.tasks import TASKS, CircleSutures, PegTransfer
from trocar.trials.log import TrialLog
from trocar.trials.pictures import MOMENTS
from trocar.trials.trial import Trial, trial_file

METHODS = ("uncalibrated", "calibrated")
REFIT_SAMPLES = 30
"""Samples of a quick refit of the cables' offsets after a change of session."""

PACKAGES = ("trocar", "numpy", "scipy", "mujoco", "trio", "opencv-python-headless")
_SESSION, _CALIBRATION, _NEXT_SESSION, _REFIT, _TRIALS = range(5)
"""Streams of randomness under a run's seed: changing one leaves the others alone."""

OPTIONS = {"preset": "--preset", "direction": "--direction", "sutures": "--sutures", "planned": "--plan"}
"""Options of a plan that not every task has, and how they are given."""

Task = PegTransfer | CircleSutures
Listener = Callable[[Mapping[str, object]], None]


@dataclass(frozen=True)
class Plan:
    """What a run is made of; the same plan writes the same trials.

    Attributes:
        task: name in ``TASKS``.
        variant: of the task; empty: its first.
        method: uncalibrated (encoders are believed) or calibrated (cables are compensated).
        model: cable model of the method calibrated.
        trials: how many.
        seed: of everything random.
        new_session: draw new offsets between calibration and trials, as when the instrument is mounted again.
        refit_offsets: refit the model's offsets from 30 samples in the session of the trials.
        flawless_camera: switch the sensor's flaws off.
        preset: setup of the task suture; None for tasks without presets.
        direction: of all its sutures.
        sutures: how many a trial.
        planned: sutures of a plan of its own, in place of a preset's.
    """

    task: str = "peg-transfer"
    variant: str = ""
    method: str = "calibrated"
    model: str = "play"
    trials: int = 1
    seed: int = 0
    new_session: bool = False
    refit_offsets: bool = False
    flawless_camera: bool = False
    preset: str | None = None
    direction: str | None = None
    sutures: int | None = None
    planned: PlannedSutures | None = None

    def __post_init__(self) -> None:
        for what, value, choices in (
            ("task", self.task, tuple(TASKS)),
            ("method", self.method, METHODS),
            ("model", self.model, tuple(MODELS)),
        ):
            if value not in choices:
                raise TrocarError(f"{what} {value!r} is unknown; choose one of {', '.join(choices)}")
        if not self.variant:
            object.__setattr__(self, "variant", TASKS[self.task].variants[0])
        built = self.built()
        for option in OPTIONS:
            object.__setattr__(self, option, getattr(built, option, None))
        if self.trials < 1:
            raise TrocarError(f"the number of trials is {self.trials}; give 1 or more with --trials")
        if self.seed < 0:
            raise TrocarError(f"the seed is {self.seed}; give 0 or more with --seed")
        if self.planned and self.method == "calibrated":
            _ = built.excitation  # a plan out of reach says so before anything is written
        if self.refit_offsets and self.method != "calibrated":
            raise TrocarError("there is no model to refit with --method uncalibrated; drop --refit-offsets")

    def built(self) -> Task:
        """Return the task.

        Raises:
            TrocarError: it does not know its variant or an option.
        """
        options = {name: getattr(self, name) for name in OPTIONS if getattr(self, name) is not None}
        unknown = [name for name in options if not hasattr(TASKS[self.task], name)]
        if unknown:
            flag = OPTIONS[unknown[0]]
            raise TrocarError(f"task {self.task!r} has no option {flag.lstrip('-')!r}; drop {flag}")
        return TASKS[self.task](self.variant, **options)

    def about(self) -> dict[str, object]:
        """Return what tells this run from others: everything but the number of trials."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values |= {"trials": None, "planned": self.planned.values() if self.planned else None}
        return {key: value for key, value in values.items() if value is not None or key == "trials"}

    def rng(self, *stream: int) -> np.random.Generator:
        """Return the generator of one of the run's streams."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, *stream]))


def open_folder(plan: Plan, folder: Path) -> list[int]:
    """Make the run's folder, or take up an interrupted run of the same plan; return the trials still to do.

    Raises:
        TrocarError: the folder holds another run, or cannot be written.
    """
    record = folder / "run.json"
    wanted = plan.about()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if record.is_file():
            found = {**json.loads(record.read_text()), "trials": None}
            if found != wanted:
                other = ", ".join(_said(key, value) for key, value in found.items() if value != wanted.get(key))
                raise TrocarError(f"{str(folder)!r} holds another run ({other}); choose another folder with --out")
        record.write_text(json.dumps({**wanted, "trials": plan.trials}))
    except (OSError, json.JSONDecodeError, TypeError) as error:
        raise TrocarError(f"cannot use folder {str(folder)!r} ({error}); choose another with --out") from None
    return [k for k in range(plan.trials) if not trial_file(folder, k).is_file()]


def _said(key: str, value: object) -> str:
    """Return what a folder holds under a key in so many words; a whole plan of sutures would fill a page."""
    return "another plan" if key == "planned" else f"{key} {value!r}"


def prepare(plan: Plan, folder: Path) -> tuple[Session, dict[str, CableModel]]:
    """Return the session of the trials and, for ``calibrated``, the cable model fitted for each working arm.

    A fitted model is kept in the folder, so that an interrupted run does not fit it again.
    """
    task = plan.built()
    session = draw_session(plan.rng(_SESSION), task.T_world_base)
    models: dict[str, CableModel] = {}
    if plan.method == "calibrated":
        arm = SETTINGS[plan.task, plan.variant]().arm
        path = folder / f"cables_{arm}.npz"
        if path.is_file():
            models[arm] = load_model(path)
        else:
            rng = plan.rng(_CALIBRATION)
            models[arm] = MODELS[plan.model].fit(record_motion(session, arm, rng, box=task.excitation), rng)
            save_model(models[arm], path)
    if plan.new_session:
        session = session.redrawn(plan.rng(_NEXT_SESSION))
    if plan.refit_offsets:
        for arm, model in models.items():
            recording = record_motion(session, arm, plan.rng(_REFIT), REFIT_SAMPLES, task.excitation)
            models[arm] = refit_offset(model, recording)
    return session, models


def run_trial(
    plan: Plan,
    session: Session,
    models: Mapping[str, CableModel],
    index: int,
    listener: Listener | None = None,
    pictures: bool = False,
) -> Trial:
    """Run one trial of a plan and return it."""
    began = time.perf_counter()
    seeds = np.random.SeedSequence([plan.seed, _TRIALS, index])
    scene_rng, noise_rng, _agent_rng = map(np.random.default_rng, seeds.spawn(3))
    task = plan.built()
    flaws = SensorFlaws.none() if plan.flawless_camera else SensorFlaws()
    simulated = SimulatedCell(session, task.scene(scene_rng), noise_rng, flaws)
    recorded = Recorded(Guarded(simulated.robot, session.arms, dict.fromkeys(session.arms, MOTION_LIMITS["paper"])))
    sent: Robot = recorded
    if plan.method == "calibrated":
        compensators = {arm: Compensator(model) for arm, model in models.items()}
        sent = Calibrated(recorded, session.arms, compensators, task.stop_at_limits)
    robot = Recorded(sent)
    log = TrialLog(trio.current_time, listener=listener)
    cell = Cell(
        robot,
        simulated.camera,
        session.arms,
        session.T_world_base_found,
        simulated.T_world_camera,
        task.T_world_board,
        log,
        simulated.assistant,
    )
    settings = SETTINGS[plan.task, plan.variant]()
    agent = AGENTS[plan.task, plan.variant](cell, settings)
    finished = simulated.run(lambda: agent.run(task.work), task.budget_s)
    wall_s = time.perf_counter() - began
    truth: Any = simulated.referee.truth()  # of the kind that this task's scene has
    scores = [asdict(score) for score in task.score(log.events, truth)]
    states = simulated.referee.states()
    arrays = simulated.referee.arrays()
    for arm in sorted({name for name, _ in recorded.executions}):
        rows = [execution for name, execution in recorded.executions if name == arm]
        arrays[f"executed_s_{arm}"] = np.concatenate([row.times_s for row in rows])
        arrays[f"commanded_{arm}"] = np.concatenate([row.commanded for row in rows]).astype(np.float32)
        arrays[f"measured_{arm}"] = np.concatenate([row.measured for row in rows]).astype(np.float32)
        if task.compares_joints:
            arrays[f"asked_s_{arm}"] = np.concatenate([times for name, times, _ in robot.asked if name == arm])
            arrays[f"asked_{arm}"] = np.concatenate([q for name, _, q in robot.asked if name == arm])
    captions = []
    photographer = Photographer(simulated.world)
    shown = MOMENTS[plan.task](scores, log.spans, log.events) if pictures else []
    for number, (caption, time_s) in enumerate(shown):
        row = int(np.argmin(np.abs(arrays["times_s"] - time_s)))
        image = photographer.picture(states[row])
        arrays[f"picture_{number}"] = cv2.imencode(".png", image[..., ::-1])[1].ravel()
        captions.append(caption)
    return Trial(
        about={
            **plan.about(),
            "index": index,
            "settings": _plain(settings),
            "cables": {arm: plant.source for arm, plant in session.plants.items()},
            "versions": versions(),
        },
        transfers=scores,
        spans=log.spans,
        events=log.events,
        collisions=[asdict(c) for c in truth.collisions],
        finished=finished,
        duration_s=round(simulated.world.time_s, 6),
        arrays=arrays,
        captions=captions,
        computations=log.computations,
        wall_s=wall_s,
    )


def versions() -> dict[str, str]:
    """Return the versions of the packages that a trial's numbers depend on."""
    return {name: version(name) for name in PACKAGES}


def _plain(settings: Any) -> dict[str, object]:
    """Return settings as JSON's values."""
    values = {**asdict(settings)}
    limits = settings.limits
    values["limits"] = {"velocity": limits.velocity.tolist(), "acceleration": limits.acceleration.tolist()}
    return values
