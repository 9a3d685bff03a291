"""An arm that speaks CRTK, for the loop of real arms: a da Vinci Research Kit's PSM, a Raven II, or our own server."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Hashable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.bus import Bus, Keeping, Subscriber, open_bus, stamped
from trocar.crtk.dialect import (
    as_positions,
    command_of,
    held_topic,
    jaw_in,
    jaw_topic,
    joint_names,
    joints_in,
    loop_settings,
    pose_kind,
    require_joints,
    state_kind,
)
from trocar.crtk.messages import (
    EFFORTS,
    Empty,
    Header,
    JointState,
    OldOperatingState,
    OperatingState,
    StringStamped,
    TransformStamped,
    TwistStamped,
)
from trocar.errors import InvalidInput
from trocar.hardware.arm import ArmFault, Fault, HardwareReading
from trocar.lab.topics import Command, Dialect, Topics

CONNECT_S = 5.0
LISTEN_S = 0.1
"""Minimum time to listen before use, so that a second robot of the same name is noticed."""
SILENT_S = 0.05
"""After this long without a reading, check whether anybody still publishes."""
ALONE_S = 0.03
"""The connection is lost when nobody has published for this long."""
HEARD_S = 0.5
HEARD, HEARD_JAW_RAD = np.array([5e-3, 5e-3, 5e-4, 5e-3, 5e-3, 5e-3]), 5e-3
"""``HEARD_S`` after a new set-point, a controller that received it holds it to within this much (rad and m)."""
UNITS = ("rad", "rad", "m", "rad", "rad", "rad")
"""Units of the joints."""
REMEMBERED = 500
"""Number of stamps of sent messages that are kept, to tell them from messages of others."""
RAVEN_STEP = np.array([2.5e-3, 2.5e-3, 5e-5, 2.5e-3, 2.5e-3, 2.5e-3])
"""rad and m: a Raven cuts off larger increments of its joints (uw-biorobotics/raven2, branch crtk)."""
ROUNDING = 1e-9
STATES = {"PAUSED": Fault.PAUSED, "DISABLED": Fault.DISABLED, "FAULT": Fault.CONTROLLER}


class CrtkArm:
    """One arm: reads ``measured_js`` of its joints and jaws, and sends the commands that the station's file names.

    After a fault, or readings older than the loop tolerates, nothing more is sent, and the arm must be connected anew.
    Others may move the arm then; and what is sent into a broken network arrives all at once when it recovers, a whole
    braking path in one step. If this process itself stood still, it reads before it sends.

    Args:
        name: of the arm.
        topics: where the arm is found, and how it is commanded.

    Raises:
        InvalidInput: the arm publishes nothing, does not subscribe to its commands, is not enabled and homed, is busy,
            has no instrument, names other joints than its dialect's, or has its readings published by two programs.
    """

    def __init__(self, name: str, topics: Topics):
        self._name, self._topic = name, topics.of_arm(name)
        self._dialect, self._command = topics.dialect, topics.command
        self._bus = bus = open_bus(topics)
        topic, raven = self._topic, self._dialect is Dialect.RAVEN
        jaw, held, command = jaw_topic(self._dialect, topic), held_topic(self._dialect), command_of(topics)
        self._state = bus.subscriber(f"{topic}/operating_state", state_kind(self._dialect), latched=True)
        self._sources: dict[str, Subscriber[Any]] = {f"{topic}/operating_state": self._state}
        joints = [f"{place}/{what}" for place in (topic, jaw) for what in ("measured_js", held)]
        self._sources |= {name: bus.subscriber(name, JointState) for name in dict.fromkeys(joints)}
        self._measured, self._setpoint = (self._sources[name] for name in joints[:2])
        self._jaw_measured, self._jaw_setpoint = (self._sources[name] for name in joints[2:])
        keeping: Keeping = {} if raven else {"kept": 1}  # each increment counts, but only the newest position
        self._out = bus.publisher(f"{topic}/{command}", JointState, **keeping)
        self._jaw_out = None if raven else bus.publisher(f"{jaw}/{command}", JointState, **keeping)
        self._others = _commands(bus, topic, jaw, topics)
        self._sent: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)
        self._last, self._jaw_last = np.full(6, np.nan), np.nan  # the last set-point
        self.behind = False  # whether a Raven's increments have not reached the set-point yet
        self._fault: ArmFault | None = None
        self._cut, self._cut_s = False, loop_settings(topics).stale_s  # whether readings were older than this
        self._alone_s = self._new_s = self._looked_s = time.monotonic()
        self._wait_for(topics, jaw, command)
        self._require_enabled()
        assert self._setpoint.last is not None
        self._names = self._require_joints(self._setpoint.last)

    def _wait_for(self, topics: Topics, jaw: str, command: str) -> None:
        topic, begun_s = self._topic, time.monotonic()
        senders: set[Hashable] = set()
        outs = {f"{topic}/{command}": self._out} | ({f"{jaw}/{command}": self._jaw_out} if self._jaw_out else {})
        while True:
            self._take()
            senders.update(self._measured.sent_by)
            silent = [name for name, source in self._sources.items() if source.last is None]
            deaf = [name for name, out in outs.items() if out.readers() < 2]  # one reader is ours, in _others
            waited_s = time.monotonic() - begun_s
            if not (silent or deaf) and waited_s > LISTEN_S:
                break
            if (silent or deaf) and waited_s > CONNECT_S:
                if self._measured.last is not None:
                    self._require_joints(self._measured.last)  # without an instrument, the jaws publish nothing
                said = [f"publishes no {' and no '.join(silent)}"] * bool(silent)
                said += [f"does not subscribe to {' and '.join(deaf)}"] * bool(deaf)
                problem = f"{' and '.join(said)} within {CONNECT_S:g} s on {topics.interface}"
                remedy = "check that it runs, its namespace, interface and domain"
                raise InvalidInput(f"CRTK arm {self._name!r}", problem, remedy)
            time.sleep(0.01)
        if len(senders) > 1:
            who = " and by ".join(sorted(str(self._bus.client(sender)) for sender in senders))
            problem = f"has its readings published by {who}"
            raise InvalidInput(f"CRTK arm {self._name!r}", problem, f"end all but one that publish {topic}/measured_js")
        for source in self._others.values():
            source.take()  # forget what others sent before

    def _require_joints(self, message: JointState) -> tuple[str, ...]:
        return require_joints(self._dialect, message.name, f"CRTK arm {self._name!r}")

    def _take(self) -> None:
        for source in self._sources.values():
            source.take()

    def _require_enabled(self) -> None:
        state = self._state.last
        if state is None or state.state != "ENABLED" or not state.is_homed:
            said = "unknown" if state is None else f"{state.state}, {'homed' if state.is_homed else 'not homed'}"
            raise InvalidInput(f"CRTK arm {self._name!r}", f"is {said}", "enable and home it at its console")
        if self._taken_over(state):
            remedy = "let go of its clutch, or let its motion end"
            raise InvalidInput(f"CRTK arm {self._name!r}", "is busy: a person or its controller moves it", remedy)

    def _taken_over(self, state: OperatingState | OldOperatingState) -> bool:
        """Return whether a dVRK's controller, or a person at the clutch, moves the arm, which is then enabled and busy.

        The arm would still take the next set-point, out of the person's hand. Our own goals make it busy, too, but
        set-points do not.
        """
        return self._dialect is Dialect.DVRK and self._command is Command.SERVO and state.is_busy

    def commanded(self) -> tuple[NDArray[np.float64], float]:
        """Return the joints and jaw angle that the arm's controller holds now."""
        self._take()
        assert self._setpoint.last is not None and self._jaw_setpoint.last is not None
        q, jaw_rad = joints_in(self._dialect, self._setpoint.last), jaw_in(self._jaw_setpoint.last)
        self._last, self._jaw_last = q, jaw_rad
        return q, jaw_rad

    def read(self) -> HardwareReading:
        """Return the encoders' reading, whose age counts from its arrival.

        Raises:
            ArmFault: readings ended or were too old, or the arm is not enabled and homed any more, does not hold what
                it was sent, or is commanded by somebody else.
        """
        self._take()
        self._looked_s = time.monotonic()
        age_s = self._looked_s - min(self._measured.at_s, self._jaw_measured.at_s)
        self._fault = self._fault or self._found(age_s)
        if self._fault is not None:
            raise self._fault
        assert self._measured.last is not None and self._jaw_measured.last is not None
        q, jaw_rad = joints_in(self._dialect, self._measured.last), jaw_in(self._jaw_measured.last)
        return HardwareReading(q, jaw_rad, age_s)

    def _found(self, age_s: float) -> ArmFault | None:
        """Return what is wrong with the arm, or None."""
        for topic, source in self._others.items():
            foreign = [message for message in source.take() if _stamp(message) not in self._sent]
            if foreign:
                word = f", {foreign[0].string!r}" if isinstance(foreign[0], StringStamped) else ""
                return ArmFault(self._name, Fault.OTHERS, f"{topic}{word}")
        unfit = self._unfit()
        if unfit is not None:
            return unfit
        now_s = time.monotonic()
        if age_s <= SILENT_S or (self._measured.senders() and self._jaw_measured.senders()):
            self._alone_s = now_s
        if now_s - self._alone_s > ALONE_S:
            return ArmFault(self._name, Fault.LOST, f"{self._topic}/measured_js, for {age_s:.2f} s")
        self._cut |= age_s > self._cut_s
        if self._cut and age_s <= SILENT_S:
            return ArmFault(self._name, Fault.STALE, "and are again: somebody may have moved it meanwhile")
        silent_s = now_s - min(self._setpoint.at_s, self._jaw_setpoint.at_s)
        if age_s <= SILENT_S and silent_s > max(HEARD_S, self._cut_s):  # its encoders alone do not tell what it heard
            return ArmFault(self._name, Fault.LOST, f"{self._topic}/setpoint_js or the jaws', for {silent_s:.2f} s")
        return self._unheard()

    def _unfit(self) -> ArmFault | None:
        """Return what the arm's controller says is wrong, or None."""
        state = self._state.last
        assert state is not None
        if state.state != "ENABLED":
            known = STATES.get(state.state, Fault.CONTROLLER)
            return ArmFault(self._name, known, f"{self._topic}/operating_state is {state.state}")
        if not state.is_homed:
            return ArmFault(self._name, Fault.UNHOMED)
        if self._taken_over(state):
            return ArmFault(self._name, Fault.OTHERS, f"{self._topic}/operating_state is busy: a person or itself")
        return None

    def _unheard(self) -> ArmFault | None:
        """Return a fault if the arm's controller does not hold the last set-point, which was then lost on its way.

        Near the end of a motion, readings may not show this: a moving arm may lag behind by as much.
        """
        setpoint, jaw = self._setpoint, self._jaw_setpoint
        if self._dialect is Dialect.RAVEN or min(setpoint.at_s, jaw.at_s) < self._new_s + HEARD_S:
            return None
        assert setpoint.last is not None and jaw.last is not None
        off = np.abs(joints_in(self._dialect, setpoint.last) - self._last)
        off_rad, topic = abs(jaw_in(jaw.last) - self._jaw_last), f"{self._topic}/setpoint_js"
        if (off <= HEARD).all() and off_rad <= HEARD_JAW_RAD:
            return None
        worst = int((off / HEARD).argmax())
        joint = f"{joint_names(self._dialect)[worst]} by {off[worst]:.4f} {UNITS[worst]}"
        held = f"{topic} is off what was sent, {joint}, the jaws by {off_rad:.4f} rad"
        if np.isnan([*off, off_rad]).any():
            held = f"{topic} or the jaws' tells no valid position"
        return ArmFault(self._name, Fault.FOLLOWING, f"{held}, {HEARD_S:g} s later")

    def send(self, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: float) -> None:
        """Send a set-point or a Raven's increment each tick, a goal or the jaws' angle only when it changes."""
        del velocity
        if time.monotonic() - self._looked_s > SILENT_S:
            with suppress(ArmFault):  # others may have moved the arm meanwhile; the next reading raises this again
                self.read()
        if self._fault is not None or self._cut:
            self.behind = False  # else the loop would wait for a set-point that is never sent
            return
        if (q != self._last).any() or jaw_rad != self._jaw_last:
            self._new_s = time.monotonic()
        if self._dialect is Dialect.RAVEN:
            self._increment(q, jaw_rad)
            return
        if self._command is Command.SERVO or (q != self._last).any():
            ordered = [float(q[joint_names(self._dialect).index(name)]) for name in self._names]
            self._publish(self._out, self._names, ordered)
            self._last = q
        if jaw_rad != self._jaw_last:
            self._publish(self._jaw_out, ("jaw",), [jaw_rad])
            self._jaw_last = jaw_rad

    def _increment(self, q: NDArray[np.float64], jaw_rad: float) -> None:
        """Send a Raven the largest increment that it takes, or 0: after 10 silent ms it leaves joint control."""
        step = np.clip(q - self._last, -RAVEN_STEP, RAVEN_STEP)
        left = 2 * (RAVEN_STEP[5] - abs(step[5]))  # the wrist's yaw is part of both jaws' joints, and comes first
        jaw_step = float(np.clip(jaw_rad - self._jaw_last, -left, left))
        self._last, self._jaw_last = self._last + step, self._jaw_last + jaw_step
        self._publish(self._out, joint_names(self._dialect), as_positions(self._dialect, step, jaw_step))
        self.behind = bool((np.abs(q - self._last) > ROUNDING).any() or abs(jaw_rad - self._jaw_last) > ROUNDING)

    def _publish(self, publisher: Any, names: Sequence[str], positions: Sequence[float] | NDArray[np.float64]) -> None:
        message = JointState(stamped(), list(names), [float(value) for value in positions])
        self._sent.append(_stamp(message))
        publisher.send(message)

    def close(self) -> None:
        """Send nothing more; the controller holds its last set-point."""


def _commands(bus: Bus, topic: str, jaw: str, topics: Topics) -> dict[str, Subscriber[Any]]:
    """Return subscribers of the topics on which others can command an arm, by their names.

    ``servo_cs`` and ``servo_ci`` of dVRK 2.4 are not among them.
    """
    poses = pose_kind(topics.dialect)
    twists = TransformStamped if topics.dialect is Dialect.RAVEN else TwistStamped  # its servo_cv is a transform
    kinds: dict[str, type[Any]] = {f"{topic}/state_command": StringStamped, f"{topic}/hold": Empty}
    kinds |= {f"{topic}/{what}": JointState for what in ("servo_jp", "servo_jr", "servo_jv", "move_jp", "move_jr")}
    kinds |= {f"{topic}/{what}": poses for what in ("servo_cp", "servo_cr", "move_cp")}
    kinds |= {f"{topic}/move_cr": poses, f"{topic}/servo_cv": twists}
    kinds |= {f"{jaw}/{what}": JointState for what in ("servo_jp", "servo_jr", "servo_jv", "move_jp")}
    kinds |= {f"{topic}/{what}": kind for what, kind in EFFORTS.items()}
    return {name: bus.subscriber(name, kind) for name, kind in kinds.items()}


def _stamp(message: Any) -> tuple[int, int]:
    header = getattr(message, "header", None)
    return (header.stamp.sec, header.stamp.nanosec) if isinstance(header, Header) else (-1, -1)
