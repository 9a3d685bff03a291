"""Runs trials of a task in a prepared session."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from trocar.calibration.fleet import FleetPrior
from trocar.calibration.models import CableModel
from trocar.cell import Cell
from trocar.errors import InvalidInput, TrocarError
from trocar.eval.config import TRIALS, RunConfig
from trocar.eval.method import AgentContext, Method, pick_perception
from trocar.eval.prepare import Prepared
from trocar.eval.scenery import Scenery
from trocar.eval.task import Score, Task
from trocar.eval.trial import Trial
from trocar.lab import SensorFlaws
from trocar.lab.laboratory import Laboratory
from trocar.log import machine_speed
from trocar.motion import PLANNERS
from trocar.perception.image import Image, RgbdImage
from trocar.robots import TICK_S, Adaptive, Compensated
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.record import fixed_poses, solids_of
from trocar.sim.world import PhysicsError

DONE, FAULT, OUT_OF_TIME, AGENT_ERROR = "done", "FAULT", "OUT_OF_TIME", "AGENT_ERROR"
"""How a trial's script ended: by itself, by a refusal or a device, by its budget, or by an exception of its own."""

QUALITY = 70
"""WebP quality of the images that are kept, out of 100."""
EFFORT = 1
"""WebP effort, out of 6; the default, 4, takes three times as long for a file that is a sixth smaller."""
THINNED = 4
"""Depth is stored for one in this many rows and columns, in whole millimetres."""
PACKED = 3
"""PNG compression, out of 9; level 9 takes seven times as long for a file that is one percent smaller."""

Listener = Callable[[Mapping[str, object]], None]


@runtime_checkable
class Photographer(Protocol):
    """A camera that keeps its images."""

    @property
    def taken(self) -> Sequence[Image]:
        """Return all whole images that it took."""
        ...


@dataclass(frozen=True)
class End:
    """How a script ended, why in a sentence, and where in the code if it raised an exception."""

    outcome: str = DONE
    reason: str = ""
    where: str = ""


def run_trial(
    config: RunConfig, prepared: Prepared, index: int, listener: Listener | None = None, *, raise_errors: bool = False
) -> Trial:
    """Run one trial of a session and return it.

    Args:
        config: of the run.
        prepared: the session.
        index: of the trial in its session.
        listener: called with each event of the scripts.
        raise_errors: whether an exception of the agent is raised; else it ends the trial, which keeps its traceback.

    Raises:
        PhysicsError: the simulation broke down; the trial is void.
        InvalidInput: the task does not score each of its goals.
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
        laboratory.wrap_robot(lambda cell: compensated(config, prepared.models, prepared.priors, cell))
    settings = method.make_settings(config.settings)
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
        end = play_agent(laboratory, method, context, task.budget_s, raise_errors)
    except Exception as error:
        error.add_note(f"in session {prepared.number}, trial {index} of seed {config.seed}, method {config.method!r}")
        raise
    wall_s = time.perf_counter() - began
    if end.outcome != DONE:
        more = {"traceback": end.where} if end.where else {}
        laboratory.log.event("stopped", outcome=end.outcome, reason=end.reason, **more)
    record = laboratory.record()
    scores = _scored(task, laboratory.task.truth(record), laboratory.log.events)
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
        ended=end.outcome,
        reason=end.reason,
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
        machine_speed=machine_speed(),
        wall_s=wall_s,
    )


def compensated(
    config: RunConfig, models: Mapping[str, CableModel], priors: Mapping[str, FleetPrior], cell: Cell
) -> Compensated:
    """Return a cell's robot with its cables compensated; it learns if there are priors."""
    limits = {name: arm.limits for name, arm in config.laboratory.arms.items()}
    wrapped = cell.robot, cell.arms, models, limits, cell.clock, cell.log
    if priors:
        return Adaptive(*wrapped, priors=priors)
    return Compensated(*wrapped, stop_at_limits=config.chosen_method.stop_at_limits)


def play_agent(
    laboratory: Laboratory, method: Method, context: AgentContext, budget_s: float, raise_errors: bool
) -> End:
    """Make an agent and run it; return how it ended."""
    try:
        agent = method.make_agent(context)
        in_time = laboratory.run(lambda cell: agent.run(), budget_s)
    except PhysicsError:
        raise
    except (TrocarError, OSError) as error:  # refused by the guard, or a device that does not answer
        return End(FAULT, str(error))
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


def _scored(task: Task, truth: Any, events: Sequence[Mapping[str, Any]]) -> Sequence[Score]:
    """Return a task's scores, one for each of its goals."""
    scores, goals = list(task.score(truth, events)), len(task.goals())
    if len(scores) != goals or not all(isinstance(score, Score) for score in scores):
        remedy = "return one trocar.eval.Score for each goal, in order"
        raise InvalidInput(f"task {task.name!r}", f"has {goals} goals and scores {scores!r}", remedy)
    return scores


def plain(settings: Any) -> Any:
    """Return settings as JSON values."""
    if is_dataclass(settings) and not isinstance(settings, type):
        return {name: plain(value) for name, value in vars(settings).items()}
    return settings.tolist() if isinstance(settings, np.ndarray) else settings


def encoded(cameras: Mapping[str, Photographer]) -> tuple[dict[str, bytes], dict[str, list[tuple[float, str]]]]:
    """Return the cameras' images as files by name, and for each camera the times and names of its images.

    Colour is WebP. Depth is a 16-bit PNG in mm, 0 where there was none, beside it under ``NAME_depth.png``.
    """
    blobs: dict[str, bytes] = {}
    taken: dict[str, list[tuple[float, str]]] = {}
    for name, camera in cameras.items():
        taken[name] = []
        for number, image in enumerate(camera.taken):
            stem = f"{name}_{number:03d}"
            color = image.color if isinstance(image, RgbdImage) else np.hstack([image.left, image.right])
            blobs[f"{stem}.webp"] = _webp(color)
            if isinstance(image, RgbdImage):
                depth_mm = np.rint(1e3 * np.nan_to_num(image.depth_m[::THINNED, ::THINNED])).astype(np.uint16)
                packed = cv2.imencode(".png", np.ascontiguousarray(depth_mm), [cv2.IMWRITE_PNG_COMPRESSION, PACKED])[1]
                blobs[f"{stem}_depth.png"] = packed.tobytes()
            taken[name].append((round(image.time_s, 6), f"{stem}.webp"))
    return blobs, taken


def _webp(color: NDArray[np.uint8]) -> bytes:
    """Return a picture (h, w, 3) as a file; OpenCV would not let us choose the effort."""
    file = BytesIO()
    Picture.fromarray(color).save(file, "webp", quality=QUALITY, method=EFFORT)
    return file.getvalue()
