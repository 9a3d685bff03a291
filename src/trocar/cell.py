"""What an agent is given. This file declares; it computes nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.log import Result
from trocar.perception.image import CameraModel, Image, StereoWindow, Window
from trocar.trajectory import Trajectory


class Outcome(Enum):
    """How a goal ended, as a sentence. Every task declares its members; ``DONE`` is always one of them."""


class MotionEnd(Enum):
    """How a motion ended, as a sentence."""

    DONE = "the motion ran to its end"
    HELD = "the arm was told to hold"
    REPLACED = "another motion took over"
    CANCELLED = "the script that moved the arm was cancelled"
    FAULT = "the robot stopped the arm on its own"


@dataclass(frozen=True)
class JointReading:
    """What the encoders of one arm read, on the motor side, so without the cables' errors (CRTK ``measured_js``).

    Attributes:
        time_s: clock of the cell at which it was read.
        q: (6,) joint positions, rad, or m for prismatic joints.
        jaw_rad: opening of the jaws.
    """

    time_s: float
    q: NDArray[np.float64]
    jaw_rad: float


@dataclass(frozen=True)
class SetPoint:
    """What one arm is commanded now (CRTK ``setpoint_js``): where a motion that follows has to start.

    Attributes:
        time_s: clock of the cell.
        q: (6,) joints, rad and m.
        velocity: (6,) per second; zero at rest.
        moving: whether a motion, or its braking, is running.
        path_s: time along the motion that runs or ran last, as it was handed to ``move``; it runs slower than the
            clock while the arm brakes.
        path_rate: how fast ``path_s`` runs: 1 in an ordinary motion, 0 at rest.
        on_path: False where braking had to leave the motion's path.
    """

    time_s: float
    q: NDArray[np.float64]
    velocity: NDArray[np.float64]
    moving: bool
    path_s: float = 0.0
    path_rate: float = 0.0
    on_path: bool = True


@dataclass(frozen=True)
class MotionResult:
    """What was really commanded and read while a motion ran, and how it ended.

    Attributes:
        times_s: (n,) clock of the cell.
        commanded: (n, 7) six joints and the jaw as sent to the controller.
        measured: (n, 7) the same as the encoders read them.
        ended: how.
        cause: why, by type and fields; None for ``DONE``.
    """

    times_s: NDArray[np.float64]
    commanded: NDArray[np.float64]
    measured: NDArray[np.float64]
    ended: MotionEnd = MotionEnd.DONE
    cause: TrocarError | None = None

    @classmethod
    def not_started(cls, ended: MotionEnd, cause: TrocarError) -> MotionResult:
        """Return the result of a motion that ended before anything was commanded."""
        return cls(np.zeros(0), np.zeros((0, 7)), np.zeros((0, 7)), ended, cause)

    @property
    def done(self) -> bool:
        """Return whether the motion ran to its end."""
        return self.ended is MotionEnd.DONE

    @property
    def reason(self) -> str:
        """Return why it ended, in a sentence; empty for ``DONE``."""
        return "" if self.cause is None else str(self.cause)


class Robot(Protocol):
    """One or more arms on one clock; names are those of the cell's ``arms``."""

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        ...

    def setpoint(self, arm: str) -> SetPoint:
        """Return what the arm is commanded now; plan from here, not from what the encoders read."""
        ...

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run a trajectory of the six joints on each of these arms, from rest; all start together.

        Returns when all have ended. If one must be slowed down, all are, by the same factor. If the caller is
        cancelled, the arms come to rest within their limits before the cancellation goes on.

        Raises:
            MotionRefused: a motion does not start where its arm is, leaves what is allowed, or an arm is moving;
                nothing has moved then.
        """
        ...

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Let these motions take over from what the arms are doing now, without a stop; otherwise like ``move``.

        Each must start at the arm's ``setpoint``, in position and velocity. The motion that it replaces returns
        ``REPLACED`` to whoever awaits it.
        """
        ...

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Compute in advance what these motions need, so that ``move`` starts them at once.

        A script calls it when it plans, so that the time counts there. The motions start where the arms rest, or
        where their current motions will end.
        """
        ...

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening; return when they have arrived or stall on an object."""
        ...

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms (none named: all) to rest within their limits, on their path where they can; then hold.

        Returns at once; ``rest`` waits for it.

        Args:
            arms: names.
            reason: what whoever awaits the motions gets as their ``cause``: a sentence, or an error to decide by.
        """
        ...

    async def rest(self, *arms: str) -> None:
        """Return when these arms (none named: all) are at rest."""
        ...


class Camera(Protocol):
    """A calibrated camera: one eye with depth, or two eyes."""

    @property
    def model(self) -> CameraModel:
        """Return its lens or lenses."""
        ...

    async def capture(self, window: Window | StereoWindow | None = None) -> Image:
        """Expose one image; takes the sensor's exposure time on the cell's clock.

        Args:
            window: the pixels to read out: a ``Window`` of one eye, a ``StereoWindow`` of two; None: all of them. The
                image's camera then is that of the window, its pixels combined if the window says so.

        Raises:
            TrocarError: the window leaves the image, or is not of this kind of camera.
        """
        ...


class Clock(Protocol):
    """The time of a cell: simulated, or wall-clock time."""

    def now_s(self) -> float:
        """Return the time since the cell was started."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...

    async def compute(self, function: Callable[[], Result], budget_s: float) -> tuple[Result, float]:
        """Return a function's result and the real time that it took, in s.

        In simulation the clock counts ``budget_s`` for it, however long it took. On hardware it runs in a thread
        beside the loop, which goes on serving the other arm, and the clock simply runs on.
        """
        ...


class Log(Protocol):
    """Where scripts note what they do; the source of time chart, time table and explanations."""

    def span(self, arm: str, name: str) -> AbstractContextManager[None]:
        """Note a stretch of the cell's clock, from entering to leaving."""
        ...

    def event(self, name: str, **values: object) -> None:
        """Note something that happened now; values must be JSON values."""
        ...

    def sample(self, name: str, row: NDArray[np.float64]) -> None:
        """Add a row of numbers to a series, which is kept with the trial's arrays under this name."""
        ...

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Note the real time that a computation took beside what the script declared for it."""
        ...

    def saw(self, camera: str, image: Image, outlines_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Note what perception found in an image of a camera, for whoever watches.

        Args:
            camera: name.
            image: the image.
            outlines_m: a closed line (n, 3) about each thing, in m, in the frame of the camera (of the left one, if
                there are two), by what it is.
        """
        ...


@dataclass(frozen=True)
class Cell:
    """One laboratory: devices, and what registration found there. Never the truth.

    Attributes:
        robot: the arms' drive.
        cameras: by name.
        arms: model of each arm by name.
        limits: of velocity and acceleration that each arm keeps here; no motion has to be planned any faster.
        T_world_base_registered: each arm's base as registration found it.
        T_world_camera_registered: each camera's pose as registration found it (of a stereo pair: the left eye's).
        T_world_fixture: what is fixed on the table by name, where it nominally is; perception refines it.
        clock: the cell's time.
        log: where scripts note what they do.
        assistants: people beside the robot, by what they do; the task that needs one defines what it can be asked to
            do.
    """

    robot: Robot
    cameras: Mapping[str, Camera]
    arms: Mapping[str, ArmModel]
    limits: Mapping[str, MotionLimits]
    T_world_base_registered: Mapping[str, SE3]
    T_world_camera_registered: Mapping[str, SE3]
    T_world_fixture: Mapping[str, SE3]
    clock: Clock
    log: Log
    assistants: Mapping[str, Any] = field(default_factory=dict)

    async def compute(self, arm: str, name: str, function: Callable[[], Result], budget_s: float) -> Result:
        """Compute for an arm; the span is noted, and the real time beside the declared budget."""
        with self.log.span(arm, name):
            result, seconds = await self.clock.compute(function, budget_s)
        self.log.compute(name, seconds, budget_s)
        return result
