"""One trial of a session: the laboratory in which it is played, and the trial that is made of it afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from io import BytesIO
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import InvalidInput
from trocar.eval.config import TRIALS, RunConfig
from trocar.eval.prepare import Prepared
from trocar.eval.scenery import Scenery
from trocar.eval.task import Score, Task
from trocar.eval.trial import Trial
from trocar.lab import SensorFlaws, Station
from trocar.log import machine_speed
from trocar.log import plain as plain_value
from trocar.perception.image import Image as Taken
from trocar.perception.image import RgbdImage
from trocar.robots import TICK_S
from trocar.robots.shaken import Shaken
from trocar.sim.laboratory import Listener, SimLaboratory
from trocar.sim.record import fixed_poses, solids_of
from trocar.sim.world import TaskWorld

DONE, FAULT, OUT_OF_TIME, AGENT_ERROR = "done", "FAULT", "OUT_OF_TIME", "AGENT_ERROR"
"""How a trial's script ended: by itself, by a refusal or a failed device, by its budget, or by its own exception."""

QUALITY = 70
"""WebP quality of saved images, out of 100."""
EFFORT = 1
"""WebP effort, out of 6; the default, 4, takes three times as long for a file that is a sixth smaller."""
THINNED = 4
"""Depth is saved for one in this many rows and columns, in whole millimetres."""
PACKED = 3
"""PNG compression, out of 9; level 9 takes seven times as long for a file that is one percent smaller."""

Files = tuple[dict[str, bytes], dict[str, list[tuple[float, str]]]]
"""Images as files by name; times and names of each camera's images."""


@runtime_checkable
class Photographer(Protocol):
    """A camera that keeps its images."""

    @property
    def taken(self) -> Sequence[Taken]:
        """Return all whole images that it took."""
        ...


@dataclass(frozen=True)
class End:
    """How a script ended and why (a sentence); for an exception also its traceback, for a fault its class."""

    outcome: str = DONE
    reason: str = ""
    where: str = ""
    error: str = ""


def draw_world(task: Task, rng: np.random.Generator, station: Station) -> TaskWorld:
    """Return the simulator's side of a scene that is drawn from a generator.

    Raises:
        InvalidInput: what the task's ``world(scene)`` returns is none.
    """
    world = task.world(task.scene(rng, station))
    if not isinstance(world, TaskWorld):
        problem, remedy = f"returns {world!r} from world(scene)", "return a trocar.sim.world.TaskWorld"
        raise InvalidInput(f"task {task.name!r}", problem, remedy)
    return world


def scenery_of(laboratory: SimLaboratory) -> Scenery:
    """Return the scenery of a simulated laboratory, without images; simulator truth."""
    world, session = laboratory.world, laboratory.session
    return Scenery(
        solids=solids_of(world),
        T_world_body=fixed_poses(world),
        arms=session.models,
        T_world_base=session.T_world_base,
        T_world_base_registered=session.T_world_base_registered,
        cameras={},
        tick_s=TICK_S,
    )


class StagedTrial:
    """The laboratory of one trial, drawn from the seeds of its run, for an agent or another program.

    Args:
        config: the run's configuration.
        prepared: the session.
        index: the trial's number in its session.
        listener: called with each event of the log.

    Attributes:
        laboratory: the laboratory with the task's objects in it.
        agent_rng: the agent's own random generator.
    """

    def __init__(self, config: RunConfig, prepared: Prepared, index: int, listener: Listener | None = None):
        self._config, self._prepared, self._index = config, prepared, index
        seeds = config.seeds(prepared.number, TRIALS, index)
        scene_rng, noise_rng, self.agent_rng, shake_rng = map(np.random.default_rng, seeds.spawn(4))
        self.laboratory = SimLaboratory(
            prepared.session,
            draw_world(config.task, scene_rng, config.laboratory),
            noise_rng,
            flaws=SensorFlaws.none() if config.flawless_camera else None,
            listener=listener,
        )
        if config.command_noise:
            push_m = 1e-3 * config.command_noise
            self.laboratory.wrap_robot(lambda cell: Shaken(cell.robot, cell.arms, shake_rng, push_m))
        self._scenery = scenery_of(self.laboratory)

    def finished(self, end: End, wall_s: float, settings: Any, images: Files | None = None) -> Trial:
        """Return the trial as it was played, scored by the task from the truth.

        Args:
            end: how it ended.
            wall_s: how long it took on this machine.
            settings: the method's settings.
            images: the cameras' images; None: those that the laboratory's own cameras took.

        Raises:
            InvalidInput: the task does not score each of its goals.
        """
        config, session, laboratory = self._config, self._prepared.session, self.laboratory
        if end.outcome != DONE:
            more = {"traceback": end.where} if end.where else {}
            laboratory.log.event("stopped", outcome=end.outcome, reason=end.reason, **more)
        record = laboratory.record()
        scores = _scored(config.task, laboratory.task.truth(record), laboratory.log.events)
        blobs, cameras = images or encoded(laboratory.cameras)
        return Trial(
            about={
                **config.about(),
                "fingerprint": config.fingerprint,
                "session": self._prepared.number,
                "index": self._index,
                "settings": plain(settings),
                "transmissions": {arm: found.source for arm, found in session.transmissions.items()},
            },
            scores=[asdict(score) for score in scores],
            spans=laboratory.log.spans,
            events=laboratory.log.events,
            collisions=[asdict(c) for c in record.collisions],
            ended=end.outcome,
            reason=end.reason,
            duration_s=round(laboratory.now_s(), 6),
            command_limit_use={arm: laboratory.driver.limit_use(arm) for arm in config.laboratory.arms},
            arrays={
                **{name: rows.astype(np.float32) for name, rows in laboratory.recorder.arrays().items()},
                **laboratory.task.arrays(record),
                **laboratory.log.series,
            },
            scenery=replace(self._scenery, cameras=cameras),
            images=blobs,
            computations=laboratory.log.computations,
            machine_speed=machine_speed(),
            wall_s=wall_s,
        )


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
    return plain_value(settings)


def encoded(cameras: Mapping[str, Photographer]) -> Files:
    """Return the cameras' whole images as files."""
    blobs: dict[str, bytes] = {}
    taken: dict[str, list[tuple[float, str]]] = {}
    for name, camera in cameras.items():
        taken[name] = []
        for number, image in enumerate(camera.taken):
            files = image_files(f"{name}_{number:03d}", image)
            blobs |= files
            taken[name].append((round(image.time_s, 6), next(iter(files))))
    return blobs, taken


def image_files(stem: str, image: Taken) -> dict[str, bytes]:
    """Return an image as files by name, the colours first.

    Colour is WebP. Depth is a 16-bit PNG in mm, 0 where there was none, beside it under ``STEM_depth.png``.
    """
    color = image.color if isinstance(image, RgbdImage) else np.hstack([image.left, image.right])
    files = {f"{stem}.webp": _webp(color)}
    if isinstance(image, RgbdImage):
        depth_mm = np.rint(1e3 * np.nan_to_num(image.depth_m[::THINNED, ::THINNED])).astype(np.uint16)
        packed = cv2.imencode(".png", np.ascontiguousarray(depth_mm), [cv2.IMWRITE_PNG_COMPRESSION, PACKED])[1]
        files[f"{stem}_depth.png"] = packed.tobytes()
    return files


def _webp(color: NDArray[np.uint8]) -> bytes:
    """Return a picture (h, w, 3) as a WebP file, by Pillow because OpenCV has no option for the effort."""
    file = BytesIO()
    Image.fromarray(color).save(file, "webp", quality=QUALITY, method=EFFORT)
    return file.getvalue()
