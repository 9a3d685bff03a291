"""What one arm of a simulated cell publishes: all topics of a da Vinci Research Kit's PSM (2.4) that clients read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, jacobian
from trocar.cell import JointReading
from trocar.crtk.bus import Bus, Publisher, stamped
from trocar.crtk.convert import matrix_of, pose_of, twist_of
from trocar.crtk.dialect import PSM_JOINTS
from trocar.crtk.messages import (
    Float64,
    Float64MultiArray,
    Header,
    JointState,
    OperatingState,
    PoseStamped,
    TwistStamped,
    WrenchStamped,
)
from trocar.geometry import SE3
from trocar.robots.driver import Driver

KINDS: dict[str, type] = {
    **dict.fromkeys(("measured_js", "setpoint_js", "goal_js", "jaw/measured_js", "jaw/setpoint_js"), JointState),
    **dict.fromkeys(("measured_cp", "setpoint_cp", "goal_cp", "local/measured_cp", "local/setpoint_cp"), PoseStamped),
    "measured_cv": TwistStamped,
    **dict.fromkeys(("body/measured_cf", "spatial/measured_cf"), WrenchStamped),
    **dict.fromkeys(("body/jacobian", "spatial/jacobian"), Float64MultiArray),
}
"""Topics that are published each tick, if anybody subscribes to them."""
STATE_KEPT_S = 0.1
"""A late reader of the state does not get one that is older, but a new one: clients act on it at once, and must have
received joints by then."""


class ArmTopics:
    """The topics that one arm publishes.

    Cartesian topics are of the tip, in the frame that each names: the station's world as registration found it, the
    arm's base (``local/``), or the tip itself (``body/``). The simulated arm knows no efforts. So the joints' efforts
    are empty and wrenches have the stamp 0, as CRTK marks what is not available.

    Args:
        model: of the arm.
        bus: where to publish.
        topic: the arm's namespace.
        T_world_base: its base as registered.
    """

    def __init__(self, model: ArmModel, bus: Bus, topic: str, T_world_base: SE3):
        self._model, self._T_world_base = model, T_world_base
        self._tip = topic.rpartition("/")[2]
        self._out: dict[str, Publisher[Any]] = {
            what: bus.publisher(f"{topic}/{what}", kind) for what, kind in KINDS.items()
        }
        self._state = bus.publisher(f"{topic}/operating_state", OperatingState, latched=True, kept_s=STATE_KEPT_S)
        self._ratio = bus.publisher(f"{topic}/trajectory_j/ratio", Float64, latched=True)
        self._readers = 0
        self._last: JointReading | None = None

    def state(self, state: str, homed: bool, busy: bool) -> None:
        """Publish the operating state."""
        self._state.send(OperatingState(stamped(), state, homed, busy))

    def has_new_readers(self) -> bool:
        """Return whether somebody has begun to read the operating state since the last call."""
        before, self._readers = self._readers, self._state.readers()
        return self._readers > before

    def ratio(self, ratio: float) -> None:
        """Publish the share of its limits that the arm's own motions use."""
        self._ratio.send(Float64(ratio))

    def tick(self, now_s: float, name: str, driver: Driver, goal: NDArray[np.float64]) -> None:
        """Publish where the arm is, with one stamp.

        Args:
            now_s: the machine's time of this tick.
            name: of the arm.
            driver: which moves it.
            goal: (joints,) where its motion ends.
        """
        setpoint, reading = driver.setpoint(name), driver.read(name)
        joints: list[str] = list(PSM_JOINTS)
        velocity = self._velocity(reading)
        now, base, tip = stamped("world", now_s), self._tip + "_base", self._tip
        local = Header(now.stamp, base)
        here = fk(self._model, reading.q)
        R = self._T_world_base.rotation
        self._say("measured_js", lambda: JointState(local, joints, reading.q.tolist(), velocity.tolist()))
        self._say("setpoint_js", lambda: JointState(local, joints, setpoint.q.tolist(), setpoint.velocity.tolist()))
        self._say("goal_js", lambda: JointState(local, joints, goal.tolist()))
        self._say("jaw/measured_js", lambda: JointState(local, ["jaw"], [reading.jaw_rad]))
        self._say("jaw/setpoint_js", lambda: JointState(local, ["jaw"], [driver.jaw_command_rad(name)]))
        self._say("local/measured_cp", lambda: PoseStamped(local, pose_of(here)))
        self._say("local/setpoint_cp", lambda: PoseStamped(local, pose_of(fk(self._model, setpoint.q))))
        self._say("measured_cp", lambda: PoseStamped(now, pose_of(self._T_world_base @ here)))
        self._say("setpoint_cp", lambda: PoseStamped(now, pose_of(self._T_world_base @ fk(self._model, setpoint.q))))
        self._say("goal_cp", lambda: PoseStamped(now, pose_of(self._T_world_base @ fk(self._model, goal))))

        def twist() -> TwistStamped:
            linear, angular = (jacobian(self._model, reading.q) @ velocity).reshape(2, 3)
            return TwistStamped(now, twist_of(R.apply(linear), R.apply(angular)))

        self._say("measured_cv", twist)
        self._say("body/measured_cf", lambda: WrenchStamped(Header(frame_id=tip)))
        self._say("spatial/measured_cf", lambda: WrenchStamped(Header(frame_id=base)))
        self._say("body/jacobian", lambda: matrix_of(body_jacobian(self._model, reading.q)))
        self._say("spatial/jacobian", lambda: matrix_of(spatial_jacobian(self._model, reading.q)))

    def _say(self, what: str, message: Callable[[], Any]) -> None:
        publisher = self._out[what]
        if publisher.readers():
            publisher.send(message())

    def _velocity(self, reading: JointReading) -> NDArray[np.float64]:
        """Return the joints' mean velocity (6,) since the last reading."""
        last, self._last = self._last, reading
        if last is None or last.time_s >= reading.time_s:
            return np.zeros(6)
        return (reading.q - last.q) / (reading.time_s - last.time_s)


def body_jacobian(model: ArmModel, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Jacobian (6, 6) to the tip's linear, then angular velocity in the tip's own axes."""
    R = fk(model, q).rotation.matrix
    return (R.T @ jacobian(model, q).reshape(2, 3, 6)).reshape(6, 6)


def spatial_jacobian(model: ArmModel, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Jacobian (6, 6) to the tip body's velocity at the base's origin, linear then angular, in base axes."""
    linear, angular = jacobian(model, q).reshape(2, 3, 6)
    return np.concatenate([linear - np.cross(angular, fk(model, q).translation_m, axis=0), angular])
