"""One arm of a simulated cell on its CRTK topics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik, limit_violations
from trocar.crtk.bus import Bus, Subscriber
from trocar.crtk.convert import seconds, transform_of
from trocar.crtk.messages import EFFORTS, Bool, Empty, Float64, JointState, PoseStamped, StringStamped, Time
from trocar.crtk.reports import ArmTopics
from trocar.crtk.servo import SetPoints
from trocar.errors import InvalidInput, InvalidValue, TrocarError
from trocar.geometry import SE3
from trocar.motion import move_to
from trocar.motion.following import step_towards
from trocar.robots import TICK_S
from trocar.robots.driver import Completion, Driver
from trocar.sim.laboratory import SimLaboratory

STREAMS = ("servo_jp", "servo_jr", "servo_cp")
MOTIONS: dict[str, type] = {
    **dict.fromkeys(("servo_jp", "servo_jr", "move_jp", "move_jr", "jaw/servo_jp", "jaw/move_jp"), JointState),
    **dict.fromkeys(("servo_cp", "move_cp"), PoseStamped),
}
"""Commands that an enabled arm executes; those by efforts (``EFFORTS``) are refused."""
ANSWER_S = 0.25
"""The state is published again this long after a new reader or a state command comes: rclpy believes that it receives a
topic .1 s before it does (measured)."""
AGAIN_S = (1.0, 2.0, 3.0, 4.0)
"""For a new reader, also this much later: on a busy machine, one missed the state and waited in vain (measured)."""
STEP_TOLERANCE = 1e-6
SAME = 1e-12
"""rad, m, and per second: an arm this close to the last set-point has reached it."""


class ServedArm:
    """One arm on its topics.

    Args:
        name: of the arm.
        model: of the arm.
        laboratory: the cell.
        bus: where its topics are.
        topic: its namespace.
        T_world_base: its base as registered.

    Attributes:
        counts: number of messages that have come, by topic.
    """

    def __init__(self, name: str, model: ArmModel, laboratory: SimLaboratory, bus: Bus, topic: str, T_world_base: SE3):
        self._name, self._model, self._laboratory = name, model, laboratory
        self._driver: Driver = laboratory.driver
        self._limits, self._T_world_base = laboratory.session.station.arms[name].limits, T_world_base
        self._ratio = 1.0
        self._streamed = SetPoints()
        self._goal: NDArray[np.float64] | None = None
        self._asked: NDArray[np.float64] | None = None
        self._state, self._homed, self._busy = "ENABLED", True, 0
        self._told: tuple[str, bool, bool] | None = None
        self._answers_s: list[float] = []
        self._out = ArmTopics(model, bus, topic, T_world_base)
        self._out.ratio(self._ratio)
        kinds = MOTIONS | EFFORTS | {"hold": Empty, "state_command": StringStamped}
        kinds |= {"trajectory_j/set_ratio": Float64, "emulate_tool_present": Bool}
        self._in: dict[str, Subscriber[Any]] = {
            what: bus.subscriber(f"{topic}/{what}", kind) for what, kind in kinds.items()
        }
        self.counts: Counter[str] = Counter()

    @property
    def received(self) -> int:
        """Return how many set-points have been streamed to the arm."""
        return sum(self.counts[what] for what in STREAMS)

    @property
    def operating(self) -> tuple[str, bool, bool]:
        """Return the operating state, whether the arm is homed, and whether it is busy."""
        return self._state, self._homed, self._busy > 0

    def tell(self, now_s: float) -> None:
        """Publish where the arm is; ``now_s`` is the machine's time of this tick."""
        goal = self._driver.setpoint(self._name).q if self._asked is None else self._asked
        self._out.tick(now_s, self._name, self._driver, goal)
        if self.operating != self._told:
            self._tell_state()

    def _tell_state(self) -> None:
        self._told = self.operating
        self._out.state(*self._told)

    def hear(self, nursery: trio.Nursery, now_s: float) -> None:
        """Execute the commands since the last tick; ``now_s`` is the machine's time of this tick."""
        if self._answers_s and now_s >= self._answers_s[0]:
            self._answers_s.pop(0)
            self._tell_state()
        if self._out.has_new_readers():
            self._answers_s = [now_s + later_s for later_s in (ANSWER_S, *AGAIN_S)]
        come = {what: messages for what, source in self._in.items() if (messages := source.take())}
        for what, messages in come.items():
            if what in EFFORTS and not self.counts[what]:  # only once: efforts may come as a stream
                self._refuse(what, "the simulated arm is driven by positions alone")
            self.counts[what] += len(messages)
        for message in come.get("state_command", ()):
            self._command(message.string)
            self._answers_s = sorted([now_s + ANSWER_S, *self._answers_s])
        for message in come.get("trajectory_j/set_ratio", ()):
            self._set_ratio(message.data)
        obeys = self._state == "ENABLED" and self._homed
        if obeys:
            self._execute(come, nursery)
        if "hold" in come:  # after motions of the same tick: which came first is unknown, and to stop is safe
            self._hold()
        if obeys:
            self._follow(now_s)

    def _execute(self, come: Mapping[str, list[Any]], nursery: trio.Nursery) -> None:
        """Start the motions that came, and of each kind of goal only the last; refuse what the arm cannot do."""
        for what in MOTIONS:
            messages = come.get(what, [])
            for message in messages if what in STREAMS else messages[-1:]:
                try:
                    self._do(what, message, nursery)
                except TrocarError as error:
                    self._refuse(what, str(error))

    def _refuse(self, what: str, reason: str) -> None:
        self._laboratory.log.event("refused", arm=self._name, topic=what, reason=reason)

    def _do(self, what: str, message: Any, nursery: trio.Nursery) -> None:
        if what.startswith("jaw/"):
            if len(message.position) != 1 or not np.isfinite(message.position[0]):
                raise InvalidInput("the jaws' position", f"is {list(message.position)}", "give one finite angle")
            jaw = self._model.jaw
            completion = self._driver.start_jaw(self._name, min(max(message.position[0], jaw.lower), jaw.upper))
            if what == "jaw/move_jp":
                self._busy_until(completion, nursery)
            return
        now = self._driver.setpoint(self._name)
        if what.endswith("_cp"):
            goal = ik(self._model, self._T_world_base.inverse() @ transform_of(message.pose), now.q)
        else:
            goal = self._model.configurations(message.position)
            if what.endswith("_jr"):
                goal = goal + (now.q if self._asked is None else self._asked)
        if what in STREAMS:
            self._stream(now.q, goal, message.header.stamp)
        else:
            self._streamed.clear()
            scaled = self._limits.scaled(self._ratio)
            limits = scaled if np.all(np.abs(now.velocity) < scaled.velocity) else self._limits
            if wrong := limit_violations(self._model, goal):
                raise InvalidInput("the goal", f"is out of range: {'; '.join(wrong)}", "give one inside")
            started = self._driver.start({self._name: move_to(now.q, now.velocity, goal, limits)})
            self._asked = goal
            self._busy_until(started[self._name], nursery)

    def _busy_until(self, completion: Completion, nursery: trio.Nursery) -> None:
        """Be busy until a motion is over; publish this at once, since it may be over within a tick."""
        self._busy += 1
        self._tell_state()

        async def wait() -> None:
            try:
                await completion.over.wait()
            finally:
                self._busy -= 1

        nursery.start_soon(wait)

    def _stream(self, now: NDArray[np.float64], goal: NDArray[np.float64], stamp: Time) -> None:
        """Take a set-point of a stream, which is played back a little later."""
        self._asked = goal = np.clip(goal, self._model.lower, self._model.upper)
        stamp_s = seconds(stamp) if stamp.sec else None
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
            motion = step_towards(goal, goal_velocity, now.q, now.velocity, self._limits, TICK_S)
            self._driver.start({self._name: motion})

    def _hold(self) -> None:
        self._streamed.clear()
        self._asked = None
        self._driver.hold(self._name)

    def _set_ratio(self, ratio: float) -> None:
        """Take another share of the limits for the arm's own motions."""
        if 0 < ratio <= 1:
            self._ratio = ratio
            self._out.ratio(ratio)
        else:
            self._refuse("trajectory_j/set_ratio", str(InvalidValue("the ratio", ratio, "give more than 0, at most 1")))

    def _command(self, word: str) -> None:
        """Change the operating state as CRTK's state machine does."""
        changes: Mapping[str, Mapping[str, str]] = {
            "enable": dict.fromkeys(("DISABLED", "FAULT", "ENABLED"), "ENABLED"),
            "disable": dict.fromkeys(("ENABLED", "PAUSED", "FAULT", "DISABLED"), "DISABLED"),
            "pause": {"ENABLED": "PAUSED"},
            "resume": {"PAUSED": "ENABLED"},
            "home": dict.fromkeys(("DISABLED", "ENABLED"), "ENABLED"),
            "unhome": dict.fromkeys(("ENABLED", "DISABLED"), "DISABLED"),
        }
        after = changes.get(word, {}).get(self._state)
        if after is None:
            self._refuse("state_command", f"{word!r} does nothing when {self._state}")
        else:
            self._state, self._homed = after, word == "home" or (self._homed and word != "unhome")
            if after != "ENABLED":
                self._hold()
