"""What an agent is given. This file declares; it computes nothing."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.trajectory import Trajectory


class Outcome(Enum):
    """How a step of a script ended, as a sentence."""

    DONE = "the goal was reached"
    NO_BLOCK = "the camera saw no block where one was expected"
    OUT_OF_REACH = "no grasp or target pose lies within the arm's joint limits"
    NOT_GRASPED = "the jaws closed but the block did not come up with them"
    DROPPED = "the block left the jaws before its target"
    NOT_PLACED = "the block was released but does not lie on its target peg"
    JOINT_LIMIT = "the next step of the primitive leaves the range of a joint, and the arm stopped there"
    NEEDLE_MISSED = "the jaws closed on nothing where the needle should have been"
    NEEDLE_SLIPPED = "the needle moved in the closed jaws"
    OFF_TARGET = "the needle went in or came out too far from where it was planned"


@dataclass(frozen=True)
class JointReading:
    """What the encoders of one arm say: motor side, so the cable errors are not in it.

    Attributes:
        time_s: clock of the cell.
        q: (6,) joint positions, rad and m as the arm's joints say.
        jaw_rad: opening of the jaws.
    """

    time_s: float
    q: NDArray[np.float64]
    jaw_rad: float


@dataclass(frozen=True)
class Execution:
    """What was really commanded and read while a motion ran.

    Attributes:
        times_s: (n,) clock of the cell.
        commanded: (n, 7) six joints and the jaw as sent to the controller.
        measured: (n, 7) the same as the encoders read them.
    """

    times_s: NDArray[np.float64]
    commanded: NDArray[np.float64]
    measured: NDArray[np.float64]


class Robot(Protocol):
    """One or more arms; names are those of the cell's ``arms``."""

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state now."""
        ...

    async def move(self, arm: str, trajectory: Trajectory) -> Execution:
        """Run the trajectory of the six joints; return when it has ended and the arm has settled."""
        ...

    async def jaw(self, arm: str, angle_rad: float) -> Execution:
        """Drive the jaws to an opening; return when they have arrived or stall on an object."""
        ...

    def hold(self, arm: str) -> None:
        """Stop this arm where it is, at once."""
        ...


class Camera(Protocol):
    """A calibrated RGBD camera."""

    @property
    def intrinsics(self) -> Intrinsics:
        """Return the pinhole model with distortion."""
        ...

    async def capture(self) -> RgbdImage:
        """Expose one image; takes the sensor's exposure time on the cell's clock."""
        ...


class Assistant(Protocol):
    """The person beside the robot."""

    async def load(self, arm: str) -> None:
        """Take the needle from where it is and hold it between the open jaws, in the agreed grasp, until they close."""
        ...


class Log(Protocol):
    """Where scripts note what they do; the time chart, the time table and the score come from it."""

    def span(self, arm: str, name: str) -> AbstractContextManager[None]:
        """Note a stretch of the cell's clock, from entering to leaving."""
        ...

    def event(self, name: str, **values: object) -> None:
        """Note something that happened now; values must be JSON's."""
        ...

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Note the real time that a computation took beside what the script declared for it."""
        ...


@dataclass(frozen=True)
class Cell:
    """One laboratory: devices and what was calibrated there. Never the truth.

    Attributes:
        robot: the arms' drive.
        camera: the RGBD camera.
        arms: model of each arm by name.
        T_world_base: each arm's base as the laboratory's registration knows it.
        T_world_camera: the camera's pose as the laboratory's registration knows it.
        T_world_board: the board as fixed in the laboratory, nominally; perception refines it. For sutures, the circle.
        log: where scripts note what they do.
        assistant: who hands out what the robot cannot fetch; None where nobody does.
    """

    robot: Robot
    camera: Camera
    arms: Mapping[str, ArmModel]
    T_world_base: Mapping[str, SE3]
    T_world_camera: SE3
    T_world_board: SE3
    log: Log
    assistant: Assistant | None = None
