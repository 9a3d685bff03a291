"""What an agent is given: robot, cameras, clock and log, as protocols, and the values that they return."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import InvalidInput, TrocarError, UnknownName
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
    """The encoder readings of one arm. Encoders sit at the motors and miss the cables' errors (CRTK ``measured_js``).

    Attributes:
        time_s: time of the reading on the cell's clock.
        q: (6,) joint positions, rad, or m for prismatic joints.
        jaw_rad: opening of the jaws.
    """

    time_s: float
    q: NDArray[np.float64]
    jaw_rad: float


@dataclass(frozen=True)
class SetPoint:
    """The current command of one arm (CRTK ``setpoint_js``). The next motion must start there.

    Attributes:
        time_s: time on the cell's clock.
        q: (6,) joints, rad and m.
        velocity: (6,) per second; zero at rest.
        moving: whether a motion, or its braking, is running.
        path_s: time along the current or last trajectory, as it was passed to ``move``. It advances more slowly than
            the clock while the arm brakes.
        path_rate: rate of ``path_s`` per second of the clock: 1 in an ordinary motion, 0 at rest.
        on_path: False if braking had to leave the motion's path.
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
    """The commands sent and the readings taken while a motion ran, and how it ended.

    Attributes:
        times_s: (n,) times on the cell's clock.
        commanded: (n, 7) six joints and the jaw as sent to the controller.
        measured: (n, 7) the same as read by the encoders.
        ended: how the motion ended.
        cause: why it ended, as a typed error; None for ``DONE``.
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
    """One or more arms on one clock, named as in ``Cell.arms``."""

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        ...

    def setpoint(self, arm: str) -> SetPoint:
        """Return the current command of the arm; plan from it, not from the encoder readings."""
        ...

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run a trajectory of the six joints on each of these arms, from rest; all start together.

        Returns when all have ended. If one must be slowed down, all are slowed down by the same factor. If the caller
        is cancelled, the arms come to rest within their limits before the cancellation propagates.

        Raises:
            MotionRefused: a motion does not start at its arm's set-point or leaves what is allowed, or an arm is
                already moving. In these cases no arm moves.
        """
        ...

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions of these arms without a stop; otherwise like ``move``.

        Each new motion must start at the arm's ``setpoint``, in position and velocity. The replaced motion returns
        ``REPLACED`` to its caller.
        """
        ...

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Compute in advance what these motions need, so that ``move`` starts them at once.

        A script calls it while planning, so that the time counts as planning. The motions must start where the arms
        rest, or where their current motions will end.
        """
        ...

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening; return when they have arrived or stall on an object."""
        ...

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms (none named: all) to rest within their limits, on their path if possible; then hold.

        Returns at once; ``rest`` waits until they are at rest.

        Args:
            arms: names.
            reason: becomes the ``cause`` in the results of the stopped motions: a sentence, or a typed error.
        """
        ...

    async def rest(self, *arms: str) -> None:
        """Return when these arms (none named: all) are at rest."""
        ...


class Camera(Protocol):
    """A calibrated camera: a single one with depth, or a stereo pair."""

    @property
    def model(self) -> CameraModel:
        """Return the intrinsics, or the stereo rig if there are two eyes."""
        ...

    async def capture(self, window: Window | StereoWindow | None = None) -> Image:
        """Expose one image; takes the sensor's exposure time on the cell's clock.

        Args:
            window: the pixels to read out: a ``Window`` for one eye, a ``StereoWindow`` for two; None: all pixels. The
                camera model of the returned image is that of the window, after any binning.

        Raises:
            TrocarError: the window exceeds the image, or is not for this kind of camera.
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
        """Run a function; return its result and the real time that it took, in s.

        In simulation the clock advances by ``budget_s``, however long the function took. On hardware the function runs
        in a thread beside the loop, which keeps serving the other arms while the wall clock runs on.
        """
        ...


class Log(Protocol):
    """The record of what scripts do; time charts, time tables and explanations are made from it."""

    def span(self, arm: str, name: str) -> AbstractContextManager[None]:
        """Return a context whose duration on the cell's clock is noted under this name."""
        ...

    def event(self, name: str, **values: object) -> None:
        """Note something that happened now; values must be JSON values."""
        ...

    def sample(self, name: str, row: NDArray[np.float64]) -> None:
        """Append a row of numbers to the series of this name, which is saved with the trial's arrays."""
        ...

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Note the real time that a computation took, and the budget that the script declared for it."""
        ...

    def saw(self, camera: str, image: Image, outlines_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Note what perception found in a camera's image, for those who watch the trial.

        Args:
            camera: name.
            image: the image.
            outlines_m: closed outline (n, 3) of each object by its name, in m, in the camera frame (left eye of a
                stereo pair).
        """
        ...


SEAT = "person"
"""Role, in ``Cell.assistants``, of the person at a console."""


@dataclass(frozen=True)
class GoalOffer:
    """A goal that a script may pursue next.

    Attributes:
        arm: the arm that begins it.
        words: what would be done, as the rest of a sentence that begins with the arm's name.
        path_world_m: (n, 3) places in the world through which it leads, from where something is taken to its end;
            the console draws two of them as an arc.
    """

    arm: str
    words: str
    path_world_m: NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """One laboratory: devices, and what registration found there. Never the truth.

    Attributes:
        robot: moves the arms.
        cameras: by name.
        arms: model of each arm by name.
        limits: velocity and acceleration limits of each arm in this cell; plan motions within them.
        T_world_base_registered: each arm's base as registration found it.
        T_world_camera_registered: each camera's pose as registration found it (of a stereo pair: the left eye's).
        T_world_fixture: nominal poses of what is fixed on the table, by name; perception refines them.
        clock: the cell's time.
        log: where scripts note what they do.
        assistants: people beside the robot, by role; the task that needs one defines what it can be asked to do.
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
        """Run a computation for an arm; log its span, its real time and its declared budget."""
        with self.log.span(arm, name):
            result, seconds = await self.clock.compute(function, budget_s)
        self.log.compute(name, seconds, budget_s)
        return result

    async def choose(self, goals: Sequence[GoalOffer]) -> int:
        """Return which of these goals to pursue next: 0, unless a person at a console chooses another one.

        A script calls it when it holds nothing and is about to begin a goal, with its first choice first. Without a
        person it returns at once.

        Raises:
            InvalidInput: no goal is offered, or one for an arm that the cell does not have.
        """
        if not goals:
            raise InvalidInput("a choice of goals", "offers none", "offer at least one")
        for goal in goals:
            if goal.arm not in self.arms:
                raise UnknownName("the arm of a goal", goal.arm, self.arms)
        person = self.assistants.get(SEAT)
        return 0 if person is None else await person.choose(goals)
