"""An arm that speaks CRTK, for the loop of real arms: a da Vinci Research Kit's PSM, or our own server."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.bus import Subscriber, open_bus, stamped
from trocar.crtk.messages import JointState, OperatingState
from trocar.errors import InvalidInput
from trocar.hardware.arm import HardwareReading
from trocar.lab.topics import Topics

JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
"""Names and order of a PSM's joints (sawIntuitiveResearchKit 2.4)."""
CONNECT_S = 5.0


class CrtkArm:
    """One arm: reads ``measured_js`` and ``jaw/measured_js``, streams ``servo_jp`` and ``jaw/servo_jp``.

    Args:
        name: of the arm.
        topics: where it is found.

    Raises:
        InvalidInput: the arm publishes nothing, or is not enabled and homed.
    """

    def __init__(self, name: str, topics: Topics):
        self._name, topic, bus = name, topics.of_arm(name), open_bus(topics)
        self._bus = bus
        self._state = bus.subscriber(f"{topic}/operating_state", OperatingState, latched=True)
        self._measured = bus.subscriber(f"{topic}/measured_js", JointState)
        self._setpoint = bus.subscriber(f"{topic}/setpoint_js", JointState)
        self._jaw_measured = bus.subscriber(f"{topic}/jaw/measured_js", JointState)
        self._jaw_setpoint = bus.subscriber(f"{topic}/jaw/setpoint_js", JointState)
        self._servo = bus.publisher(f"{topic}/servo_jp", JointState)
        self._jaw_servo = bus.publisher(f"{topic}/jaw/servo_jp", JointState)
        self._jaw_sent = np.nan
        needed = {"operating_state": self._state, "measured_js": self._measured, "setpoint_js": self._setpoint}
        needed |= {"jaw/measured_js": self._jaw_measured, "jaw/setpoint_js": self._jaw_setpoint}
        deadline_s = time.monotonic() + CONNECT_S
        while any(source.last is None for source in needed.values()) and time.monotonic() < deadline_s:
            self._take()
            time.sleep(0.01)
        silent = [f"{topic}/{name}" for name, source in needed.items() if source.last is None]
        if silent:
            problem = f"publishes no {' and no '.join(silent)} within {CONNECT_S:g} s on {topics.interface}"
            raise InvalidInput(f"CRTK arm {name!r}", problem, "check that it runs, its namespace, interface and domain")
        self._require_enabled()

    def _take(self) -> None:
        for source in (self._state, self._measured, self._setpoint, self._jaw_measured, self._jaw_setpoint):
            source.take()

    def _require_enabled(self) -> None:
        state = self._state.last
        if state is None or state.state != "ENABLED" or not state.is_homed:
            said = "unknown" if state is None else f"{state.state}, {'homed' if state.is_homed else 'not homed'}"
            raise InvalidInput(f"CRTK arm {self._name!r}", f"is {said}", "enable and home it at its console")

    def _joints(self, source: Subscriber[JointState], count: int) -> NDArray[np.float64]:
        """Return a source's positions in the order of ``JOINTS``, if it names them."""
        message = source.last
        assert message is not None
        position = np.array(message.position, dtype=np.float64)
        if len(position) != count or message.header.stamp.sec == 0:
            return np.full(count, np.nan)  # CRTK: not available
        if count == len(JOINTS) and set(message.name) == set(JOINTS):
            position = position[[list(message.name).index(joint) for joint in JOINTS]]
        return position

    def commanded(self) -> tuple[NDArray[np.float64], float]:
        """Return what the arm's controller holds now."""
        return self._joints(self._setpoint, 6), float(self._joints(self._jaw_setpoint, 1)[0])

    def read(self) -> HardwareReading:
        """Return what the encoders read, and how long ago it came.

        Raises:
            InvalidInput: the arm is not enabled any more.
        """
        self._take()
        self._require_enabled()
        now_s = time.monotonic()
        age_s = now_s - min(self._measured.at_s, self._jaw_measured.at_s)
        return HardwareReading(self._joints(self._measured, 6), float(self._joints(self._jaw_measured, 1)[0]), age_s)

    def send(self, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: float) -> None:
        """Stream a set-point; the jaws' only when it changes."""
        del velocity
        self._servo.send(JointState(stamped(), list(JOINTS), q.tolist()))
        if jaw_rad != self._jaw_sent:
            self._jaw_servo.send(JointState(stamped(), ["jaw"], [jaw_rad]))
            self._jaw_sent = jaw_rad

    def close(self) -> None:
        """Send nothing more; the controller holds its last set-point."""


def connect(name: str, topics: Topics) -> CrtkArm:
    """Connect an arm; ``functools.partial(connect, topics=station.crtk)`` is what ``HardwareLaboratory`` takes."""
    return CrtkArm(name, topics)
