"""Kinds of faults of a served robot: mistakes of real set-ups, each as a change of the messages."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trocar.arms import fk
from trocar.crtk.convert import pose_of, seconds, transform_of
from trocar.crtk.messages import (
    Header,
    OldOperatingState,
    OperatingState,
    PoseStamped,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from trocar.geometry import SE3, SO3
from trocar.lab.station import Station, StationArm

GLITCH_S = 0.5
"""Time between an encoder's glitches."""
GLITCH_RAD = 0.3
BEYOND = 0.1
"""How far beyond its range a set-point is, as a share of the range."""
Value = float | str | None
Change = Callable[[Any], Any]
"""Returns what is published instead of a message; None: nothing is."""


@dataclass(frozen=True)
class Place:
    """Where a fault is.

    Attributes:
        what: topic below the arm's namespace, such as ``measured_js``.
        value: how large the fault is.
        arm: that has the fault.
        station: of the arm.
    """

    what: str
    value: Any
    arm: StationArm
    station: Station

    @property
    def of_joints(self) -> bool:
        """Return whether the topic is of the arm's joints, not of its jaws."""
        return self.what.endswith("_js") and not self.what.startswith("jaw/")


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        about: what goes wrong.
        found_by: the check of ``trocar crtk doctor`` that finds it.
        value: default size of the fault; None: it has no size.
        change: returns the change of a topic's messages.
        delay_s: returns the delay of a message.
        kinds: message types that are published as another type, with that type and the conversion.
        from_the_start: whether the fault cannot begin later than the server.
    """

    about: str
    found_by: str
    value: Value = None
    change: Callable[[Place], Change] | None = None
    delay_s: Callable[[Any, random.Random], float] | None = None
    kinds: Mapping[type, tuple[type, Change]] | None = None
    from_the_start: bool = False


def _stale(place: Place) -> Change:
    first: Any = None

    def change(message: Any) -> Any:
        nonlocal first
        first = message if first is None else first
        return first

    return change


def _frozen(place: Place) -> Change:
    held = _stale(place)
    return lambda message: replace(held(message), header=message.header) if "measured" in place.what else message


def _silent(place: Place) -> Change:
    return lambda message: None if place.what == place.value else message


def _slow(place: Place) -> Change:
    last_s = -math.inf

    def change(message: Any) -> Any:
        nonlocal last_s
        now_s = seconds(message.header.stamp)
        if now_s - last_s < 1 / place.value - 1e-3:
            return None
        last_s = now_s
        return message

    return change


def _clock(place: Place) -> Change:
    return lambda message: replace(message, header=shifted(message.header, place.value))


def _positions(place: Place, change: Callable[[list[float]], list[float]], what: str = "_js") -> Change:
    """Return a change of the joints' positions in topics whose names end in ``what``."""
    if not (place.of_joints and place.what.endswith(what)):
        return lambda message: message
    return lambda message: replace(message, position=change(list(message.position)))


def _poses(change: Callable[[SE3], SE3]) -> Change:
    return lambda message: (
        replace(message, pose=pose_of(change(transform_of(message.pose))))
        if isinstance(message, PoseStamped)
        else message
    )


def _nan(place: Place) -> Change:
    return _positions(place, lambda q: [math.nan, *q[1:]], "measured_js")


def _degrees(place: Place) -> Change:
    joints = place.arm.model.joints
    return _positions(place, lambda q: [v if j.prismatic else math.degrees(v) for j, v in zip(joints, q, strict=True)])


def _scaled(place: Place, factor: float) -> Change:
    """Return a change of all lengths: of prismatic joints, and of poses."""
    joints = place.arm.model.joints
    slid = _positions(place, lambda q: [factor * v if j.prismatic else v for j, v in zip(joints, q, strict=True)])
    placed = _poses(lambda T: SE3.from_parts(T.rotation, factor * T.translation_m))
    return lambda message: slid(placed(message))


def _names(place: Place, names: Sequence[str]) -> Change:
    return lambda message: replace(message, name=list(names)) if place.of_joints else message


def _at_wrist(place: Place) -> Change:
    model = place.arm.model
    T_tip_wrist = fk(model, model.middle).inverse() @ fk(replace(model, tip_length_m=0.0), model.middle)
    return _poses(lambda T: T @ T_tip_wrist)


def _in_base(place: Place) -> Change:
    T_base_world = place.arm.T_world_base.inverse()
    return _unless_local(place, _poses(lambda T: T_base_world @ T))


def _in_view(place: Place) -> Change:
    """Return a change of poses to the frame of an endoscope's view: x left, y up, z away."""
    cameras = [camera.T_world_camera for camera in place.station.cameras.values()]
    T_view_world = ((cameras or [SE3.identity()])[0] @ SE3.from_parts(SO3.axis("z", math.pi))).inverse()
    return _unless_local(place, _poses(lambda T: T_view_world @ T))


def _unless_local(place: Place, change: Change) -> Change:
    return (lambda message: message) if place.what.startswith("local/") else change


def _offset(place: Place) -> Change:
    """Return a change of all measured topics by an offset of the first joint's encoder."""
    if "measured" not in place.what:
        return lambda message: message
    model, off = place.arm.model, np.array([place.value, *np.zeros(5)])
    T = fk(model, model.middle + off) @ fk(model, model.middle).inverse()  # about the first joint's axis
    B = place.arm.T_world_base
    turned = _poses(
        (lambda pose: T @ pose) if place.what.startswith("local/") else lambda pose: B @ T @ B.inverse() @ pose
    )
    moved = _positions(place, lambda q: (np.array(q) + off).tolist())
    return lambda message: turned(moved(message))


def _glitches(place: Place) -> Change:
    last_s = -math.inf

    def change(message: Any) -> Any:
        nonlocal last_s
        now_s = seconds(message.header.stamp)
        if place.what != "measured_js" or now_s - last_s < GLITCH_S:
            return message
        last_s = now_s
        return replace(message, position=[message.position[0] + GLITCH_RAD, *message.position[1:]])

    return change


def _beyond(place: Place) -> Change:
    joint = place.arm.model.joints[0]
    return _positions(place, lambda q: [joint.upper + BEYOND * (joint.upper - joint.lower), *q[1:]], "setpoint_js")


def _state(**values: Any) -> Callable[[Place], Change]:
    return lambda _: lambda message: replace(message, **values) if isinstance(message, OperatingState) else message


def _transform(message: PoseStamped) -> TransformStamped:
    place = message.pose.position
    transform = Transform(Vector3(place.x, place.y, place.z), message.pose.orientation)
    return TransformStamped(message.header, "", transform)


def _old_state(message: OperatingState) -> OldOperatingState:
    return OldOperatingState(message.header, message.state, message.is_homed, message.is_busy)


KINDS: Mapping[str, Kind] = {
    "silent": Kind("a topic ends", "data", "measured_js", _silent),
    "stale": Kind("data and stamps stop while messages go on", "stamps", None, _stale),
    "slow": Kind("messages come at this rate, Hz", "rate", 10.0, _slow),
    "jittery": Kind(
        "messages come in bursts, up to so many seconds late", "jitter", 0.06, None, lambda s, rng: rng.uniform(0, s)
    ),
    "late": Kind("messages come so many seconds late", "latency", 0.3, None, lambda s, _: s),
    "clock": Kind("the robot's clock is so many seconds ahead", "clock", 2.0, _clock),
    "nan": Kind("a joint reads NaN", "finite", None, _nan),
    "degrees": Kind("joints are in degrees", "units", None, _degrees),
    "millimetres": Kind("insertion and poses are in mm", "units", None, lambda place: _scaled(place, 1e3)),
    "scale": Kind(
        "insertion and poses are so many times too large", "units", 10.0, lambda place: _scaled(place, place.value)
    ),
    "order": Kind("joints come in reverse order", "order", None, lambda place: _positions(place, lambda q: q[::-1])),
    "unnamed": Kind("joints have no names", "names", None, lambda place: _names(place, ())),
    "misnamed": Kind(
        "joints have other names", "names", None, lambda place: _names(place, [f"joint_{k}" for k in range(6)])
    ),
    "base": Kind("poses are in the arm's base, not in the station's world", "frames", None, _in_base),
    "view": Kind("poses are in a camera's view frame: x left, y up", "frames", None, _in_view),
    "swapped": Kind("two arms have each other's namespace", "frames", from_the_start=True),
    "tip": Kind("poses are of the wrist, without the tip's offset", "tip", None, _at_wrist),
    "offset": Kind("the first joint's encoder is off by so many rad", "following", 0.2, _offset),
    "frozen": Kind("what is measured stays while the arm moves", "following", None, _frozen),
    "beyond": Kind("a set-point is beyond its joint's range", "ranges", None, _beyond),
    "glitches": Kind("an encoder jumps now and then", "speeds", None, _glitches),
    "paused": Kind("the arm is PAUSED", "state", None, _state(state="PAUSED")),
    "fault": Kind("the arm is in FAULT", "state", None, _state(state="FAULT")),
    "unhomed": Kind("the arm is not homed", "state", None, _state(is_homed=False)),
    "busy": Kind("is_busy never falls", "busy", None, _state(is_busy=True)),
    "transforms": Kind(
        "poses are TransformStamped, as before CRTK 1.1",
        "types",
        kinds={PoseStamped: (TransformStamped, _transform)},
        from_the_start=True,
    ),
    "old-state": Kind(
        "the operating state's type is of before CRTK 1.1",
        "types",
        kinds={OperatingState: (OldOperatingState, _old_state)},
        from_the_start=True,
    ),
    "twice": Kind("a second program publishes the same", "publishers", from_the_start=True),
}


def shifted(header: Header, by_s: float) -> Header:
    """Return a header with its stamp shifted by ``by_s``; a stamp of 0, which is not valid, stays."""
    if header.stamp.sec == 0:
        return header
    sec, ns = divmod(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec + round(1e9 * by_s), 1_000_000_000)
    return Header(Time(sec, ns), header.frame_id)
