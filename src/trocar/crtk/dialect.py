"""Names and message types of arms in each dialect: today's dVRK, CRTK before 1.1, Raven II."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.messages import JointState, OldOperatingState, OperatingState, PoseStamped, TransformStamped
from trocar.errors import InvalidInput
from trocar.lab.topics import Dialect, Topics

PSM_JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""Names and order of a PSM's joints (sawIntuitiveResearchKit 2.4)."""
RAVEN_JOINTS = ("shoulder", "elbow", "ins", "roll", "wrist", "jaw1", "jaw2")
"""Ends of the names of a Raven's joints (``gold_shoulder``), and their order (uw-biorobotics/raven2, branch crtk)."""


def state_kind(dialect: Dialect) -> type[OperatingState] | type[OldOperatingState]:
    """Return the message of ``operating_state``."""
    return OperatingState if dialect is Dialect.DVRK else OldOperatingState


def pose_kind(dialect: Dialect) -> type[PoseStamped] | type[TransformStamped]:
    """Return the message of poses."""
    return PoseStamped if dialect is Dialect.DVRK else TransformStamped


def joint_names(dialect: Dialect) -> tuple[str, ...]:
    """Return the names of an arm's joints in their order."""
    return RAVEN_JOINTS if dialect is Dialect.RAVEN else PSM_JOINTS


def require_joints(dialect: Dialect, names: Sequence[str], who: str) -> tuple[str, ...]:
    """Return the names of an arm's joints in the order of its controller, which ignores names in commands.

    Raises:
        InvalidInput: the names are not the dialect's.
    """
    expected, plain = joint_names(dialect), tuple(plain_name(dialect, name) for name in names)
    if not plain or plain == tuple(f"outer_{name}" for name in expected):  # dVRK 1.x
        return expected
    if sorted(plain) == sorted(expected) and (dialect is not Dialect.RAVEN or plain == expected):
        return plain
    problem = f"names its joints {', '.join(names)}, not {', '.join(expected)}"
    raise InvalidInput(who, problem, "name its dialect in the station's file; another robot needs a driver of its own")


def plain_name(dialect: Dialect, name: str) -> str:
    """Return a joint's name without its arm's colour, which a Raven's has."""
    return name.rpartition("_")[2] if dialect is Dialect.RAVEN else name


def jaw_topic(dialect: Dialect, topic: str) -> str:
    """Return where the jaws of an arm are found: ``/PSM1/jaw``; of a Raven, ``/grasp1`` beside ``/arm1``."""
    head, slash, name = topic.rpartition("/")
    if dialect is Dialect.RAVEN and name.startswith("arm"):
        return f"{head}{slash}grasp{name.removeprefix('arm')}"
    return f"{topic}/jaw"


def command_of(topics: Topics) -> str:
    """Return the topic, below the arm's namespace, that commands its joints: a Raven takes only increments."""
    return "servo_jr" if topics.dialect is Dialect.RAVEN else topics.command.value


def held_topic(dialect: Dialect) -> str:
    """Return the topic, below that of an arm or its jaws, that tells what the controller holds.

    A Raven's ``setpoint_js`` repeats its last command, an increment, and its jaws publish none.
    """
    return "measured_js" if dialect is Dialect.RAVEN else "setpoint_js"


def joints_in(dialect: Dialect, message: JointState) -> NDArray[np.float64]:
    """Return the joints (6,) of an arm's message, put in order by their names; NaN where CRTK says "not available"."""
    names = joint_names(dialect)
    position = np.array(message.position, dtype=np.float64)
    if len(position) != len(names) or message.header.stamp.sec == 0:
        return np.full(6, np.nan)
    if dialect is Dialect.RAVEN:
        return np.append(position[:5], (position[6] - position[5]) / 2)  # each jaw has a joint; both open outwards
    if len(message.name) == len(names) and set(message.name) == set(names):
        position = position[[list(message.name).index(name) for name in names]]
    return position


def jaw_in(message: JointState) -> float:
    """Return the opening in a message of the jaws, its first position; NaN where CRTK says "not available"."""
    return float(message.position[0]) if message.position and message.header.stamp.sec else float("nan")


def as_positions(dialect: Dialect, q: Sequence[float] | NDArray[np.float64], jaw_rad: float) -> list[float]:
    """Return the positions in an arm's message: six joints, or a Raven's seven, which include the jaws."""
    values = np.asarray(q, dtype=np.float64).tolist()
    if dialect is Dialect.RAVEN:
        return [*values[:5], jaw_rad / 2 - values[5], jaw_rad / 2 + values[5]]
    return values
