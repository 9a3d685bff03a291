"""Names, message types and loop settings of arms in each dialect: today's dVRK, CRTK before 1.1, Raven II."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.messages import JointState, OldOperatingState, OperatingState, PoseStamped, TransformStamped
from trocar.errors import InvalidInput, UnknownName
from trocar.hardware.arm import LoopSettings
from trocar.lab.topics import Dialect, Topics

PSM_JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""Names and order of a PSM's joints (sawIntuitiveResearchKit 2.4); before dVRK 2.3, each begins with ``outer_``."""
NO_INSTRUMENT = "disc_1"
"""A joint of a PSM without an instrument, whose last joints are ``disc_1`` to ``disc_4`` (the same, 2.4)."""
INSERT = "insert one, and wait until it is engaged"
RAVEN_JOINTS = ("shoulder", "elbow", "ins", "roll", "wrist", "jaw1", "jaw2")
"""Ends of the names of a Raven's joints (``gold_shoulder``), and their order (uw-biorobotics/raven2, branch crtk)."""
RAVEN_TICK_S = 0.005
"""A Raven that has heard nothing for 10 ms leaves joint control (the same, rt_raven.cpp)."""


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
        InvalidInput: the names are not the dialect's, or those of an arm without an instrument.
    """
    expected, plain = joint_names(dialect), tuple(plain_name(dialect, name) for name in names)
    if not plain:
        return expected
    if NO_INSTRUMENT in plain:
        raise InvalidInput(who, "has no instrument", INSERT)
    if sorted(plain) == sorted(expected) and (dialect is not Dialect.RAVEN or plain == expected):
        return plain
    problem = f"names its joints {', '.join(names)}, not {', '.join(expected)}"
    raise InvalidInput(who, problem, "name its dialect in the station's file; another robot needs a driver of its own")


def plain_name(dialect: Dialect, name: str) -> str:
    """Return a joint's name without what some robots put before it: a Raven its arm's colour, a dVRK ``outer_``."""
    return name.rpartition("_")[2] if dialect is Dialect.RAVEN else name.removeprefix("outer_")


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
    plain = [plain_name(dialect, name) for name in message.name]
    if sorted(plain) == sorted(names):
        position = position[[plain.index(name) for name in names]]
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


def loop_settings(topics: Topics) -> LoopSettings:
    """Return the loop's settings, as the station's table ``crtk.loop`` has them; a Raven's ticks are shorter.

    Raises:
        InvalidInput: it has no such setting, or the value is out of bounds.
    """
    kinds: dict[str, Any] = {field.name: type(field.default) for field in fields(LoopSettings)}
    for name in topics.loop:
        if name not in kinds:
            raise UnknownName("the station's crtk.loop: setting", name, kinds)
    usual: dict[str, Any] = {"tick_s": RAVEN_TICK_S} if topics.dialect is Dialect.RAVEN else {}
    for name, value in topics.loop.items():  # numbers of a station's file are floats
        usual[name] = int(value) if kinds[name] is int and float(value).is_integer() else value
    return LoopSettings(**usual)
