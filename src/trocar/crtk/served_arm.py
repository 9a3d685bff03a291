"""One arm of a simulated cell on its CRTK topics."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik
from trocar.crtk.bus import Bus, Subscriber, stamped
from trocar.crtk.dialect import PSM_JOINTS
from trocar.crtk.messages import (
    Empty,
    JointState,
    OperatingState,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    StringStamped,
    Time,
)
from trocar.crtk.servo import SetPoints, step_towards
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import move_to
from trocar.robots import TICK_S
from trocar.robots.driver import Driver
from trocar.sim.laboratory import SimLaboratory
from trocar.trajectory import Trajectory

STEP_TOLERANCE = 1e-6
SAME = 1e-12
"""rad, m, and per second: an arm that is this near to the last set-point has reached it."""


class ServedArm:
    """One arm on its topics.

    Attributes:
        received: set-points of ``servo_jp`` that have come.
    """

    def __init__(self, name: str, model: ArmModel, laboratory: SimLaboratory, bus: Bus, topic: str, T_world_base: SE3):
        self._name, self._model, self._laboratory = name, model, laboratory
        self._driver: Driver = laboratory.driver
        self._limits, self._T_world_base = laboratory.session.station.arms[name].limits, T_world_base
        self.received, self._streamed = 0, SetPoints()
        self._goal: NDArray[np.float64] | None = None
        self._state, self._busy, self._told = "ENABLED", 0, None
        kinds = {"measured_js": JointState, "setpoint_js": JointState}
        kinds |= {"jaw/measured_js": JointState, "jaw/setpoint_js": JointState}
        kinds |= dict.fromkeys(("measured_cp", "setpoint_cp", "local/measured_cp"), PoseStamped)
        self._out = {what: bus.publisher(f"{topic}/{what}", kind) for what, kind in kinds.items()}
        self._out_state = bus.publisher(f"{topic}/operating_state", OperatingState, latched=True)
        joints = ("servo_jp", "move_jp", "jaw/servo_jp", "jaw/move_jp")
        kinds = dict.fromkeys(joints, JointState) | dict.fromkeys(("servo_cp", "move_cp"), PoseStamped)
        kinds |= {"hold": Empty, "state_command": StringStamped}
        self._in: dict[str, Subscriber[Any]] = {
            what: bus.subscriber(f"{topic}/{what}", kind) for what, kind in kinds.items()
        }

    def tell(self) -> None:
        """Publish where the arm is."""
        setpoint, reading = self._driver.setpoint(self._name), self._driver.read(self._name)
        jaw_rad = self._driver.jaw_command_rad(self._name)
        self._out["measured_js"].send(JointState(stamped(), list(PSM_JOINTS), reading.q.tolist()))
        self._out["setpoint_js"].send(
            JointState(stamped(), list(PSM_JOINTS), setpoint.q.tolist(), setpoint.velocity.tolist())
        )
        self._out["jaw/measured_js"].send(JointState(stamped(), ["jaw"], [reading.jaw_rad]))
        self._out["jaw/setpoint_js"].send(JointState(stamped(), ["jaw"], [jaw_rad]))
        T_base_tip = fk(self._model, reading.q)
        self._out["local/measured_cp"].send(PoseStamped(stamped(), pose_of(T_base_tip)))
        self._out["measured_cp"].send(PoseStamped(stamped("world"), pose_of(self._T_world_base @ T_base_tip)))
        T_world_tip = self._T_world_base @ fk(self._model, setpoint.q)
        self._out["setpoint_cp"].send(PoseStamped(stamped("world"), pose_of(T_world_tip)))
        state = (self._state, self._state != "DISABLED", self._busy > 0)
        if state != self._told:
            self._told = state
            self._out_state.send(OperatingState(stamped(), *state))

    def hear(self, nursery: trio.Nursery, now_s: float) -> None:
        """Do what has been asked for since the last tick; ``now_s`` is the time of this machine."""
        for message in self._in["state_command"].take():
            self._command(message.string)
        if self._in["hold"].take():
            self._hold()
        come = {what: self._in[what].take() for what in self._in if what.split("_")[-1] in ("jp", "cp")}
        self.received += len(come["servo_jp"])
        if self._state != "ENABLED":
            return
        for what, messages in come.items():
            streamed = what.startswith("servo")
            for message in messages if streamed else messages[-1:]:
                try:
                    self._do(what, message, nursery)
                except TrocarError as error:
                    self._laboratory.log.event("refused", arm=self._name, topic=what, reason=str(error))
        self._follow(now_s)

    def _do(self, what: str, message: Any, nursery: trio.Nursery) -> None:
        if what.startswith("jaw/"):
            self._driver.start_jaw(self._name, float(message.position[0]))
            return
        now = self._driver.setpoint(self._name)
        if what.endswith("_cp"):
            goal = ik(self._model, self._T_world_base.inverse() @ transform_of(message.pose), now.q)
        else:
            goal = self._model.configurations(message.position)
        if what.startswith("servo"):
            self._stream(now.q, goal, message.header.stamp)
        else:
            self._streamed.clear()
            nursery.start_soon(self._move, move_to(now.q, now.velocity, goal, self._limits))

    def _stream(self, now: NDArray[np.float64], goal: NDArray[np.float64], stamp: Time) -> None:
        """Take a set-point of a stream, which is played back soon."""
        goal = np.clip(goal, self._model.lower, self._model.upper)
        stamp_s = stamp.sec + 1e-9 * stamp.nanosec if stamp.sec else None
        speed = self._streamed.add(goal, now, time.time(), stamp_s)
        share = float((speed / self._limits.velocity).max())
        if share > 1.0 + STEP_TOLERANCE:
            self._laboratory.log.event("servo", arm=self._name, share=round(share, 4))

    def _follow(self, now_s: float) -> None:
        """Move on with the stream, within the arm's limits."""
        before, goal = self._goal, self._streamed.at(now_s)
        self._goal = goal
        if goal is None:
            return
        now = self._driver.setpoint(self._name)
        if np.abs(goal - now.q).max() > SAME or np.abs(now.velocity).max() > SAME:
            goal_velocity = (goal - (goal if before is None else before)) / TICK_S
            motion = step_towards(goal, goal_velocity, now.q, now.velocity, self._limits)
            self._driver.start({self._name: motion})

    def _hold(self) -> None:
        self._streamed.clear()
        self._driver.hold(self._name)

    async def _move(self, motion: Trajectory) -> None:
        self._busy += 1
        try:
            await self._laboratory.cell.robot.replace({self._name: motion})
        except TrocarError as error:
            self._laboratory.log.event("refused", arm=self._name, topic="move", reason=str(error))
        finally:
            self._busy -= 1

    def _command(self, word: str) -> None:
        """Change the operating state as CRTK's state machine does."""
        changes: Mapping[str, Mapping[str, str]] = {
            "enable": {"DISABLED": "ENABLED", "FAULT": "ENABLED"},
            "disable": dict.fromkeys(("ENABLED", "PAUSED", "FAULT"), "DISABLED"),
            "pause": {"ENABLED": "PAUSED"},
            "resume": {"PAUSED": "ENABLED"},
            "home": {"DISABLED": "ENABLED"},
            "unhome": {"ENABLED": "DISABLED"},
        }
        after = changes.get(word, {}).get(self._state)
        if after is None:
            reason = f"{word!r} does nothing when {self._state}"
            self._laboratory.log.event("refused", arm=self._name, topic="state_command", reason=reason)
            return
        self._state = after
        if after != "ENABLED":
            self._hold()


def pose_of(T: SE3) -> Pose:
    """Return a transform as a message, the scalar of its quaternion last."""
    w, x, y, z = T.rotation.as_quaternion().tolist()
    return Pose(Point(*T.translation_m.tolist()), Quaternion(x, y, z, w))


def transform_of(pose: Pose) -> SE3:
    """Return the transform of a message."""
    q = pose.orientation
    place = pose.position
    return SE3.from_parts(SO3.from_quaternion([q.w, q.x, q.y, q.z]), [place.x, place.y, place.z])
