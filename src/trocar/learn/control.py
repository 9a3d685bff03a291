"""What a policy observes, and how its actions move the arms; shared by environments and agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real

import numpy as np
import trio
from numpy.typing import ArrayLike, NDArray

from trocar.arms import MotionLimits, fk, ik
from trocar.cell import Cell, Robot
from trocar.errors import InvalidInput, InvalidValue, MotionRefused, OutOfReach, UnknownName
from trocar.geometry import SE3, SO3
from trocar.learn.poses import WIDTH, action_names, state_names, turn_beside
from trocar.motion.following import step_towards
from trocar.perception.image import CameraModel, Image, Intrinsics, RgbdImage, whole_window
from trocar.robots import TICK_S, Compensated
from trocar.robots.shaken import Shaken

JOINTS, CARTESIAN, ABSOLUTE = "joints", "cartesian", "cartesian-absolute"
ACTIONS = (JOINTS, CARTESIAN, ABSOLUTE)
STATE, OBJECTS, IMAGES, PRIVILEGED = "state", "objects", "images", "privileged"
OBSERVATIONS = (STATE, OBJECTS, IMAGES, PRIVILEGED)

SPEED_M, SPEED_RAD = 0.2, 3.0
"""Largest Cartesian increment per second, on each axis (m, rad)."""
REACH_M = 1.0
"""Bound of a tip's position on each axis of the world, m."""
OVER = 0.3
"""How far readings may lie outside the joints' ranges (rad, m): jaws and drives yield."""
SAME_RAD = 1e-9


@dataclass
class Answer:
    """The outcome of an action, by arm.

    Attributes:
        slowed: required velocity or change of velocity, divided by what the limits allow; only ratios above 1. The arm
            moves as fast as it may, and the next action begins where it is.
        refused: why the arm did not move: out of reach, or refused by its guard.
    """

    slowed: dict[str, float] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def require_actions(action: str, rate_hz: float) -> None:
    """Raise UnknownName for an unknown kind of action, InvalidValue for an impossible rate."""
    if action not in ACTIONS:
        raise UnknownName("action", action, ACTIONS)
    if not (isinstance(rate_hz, Real) and 1.0 <= rate_hz <= 1 / TICK_S):
        raise InvalidValue("the rate of actions", f"{rate_hz!r} Hz", f"give 1 to {1 / TICK_S:.0f}")


class Control:
    """Moves arms by actions that come at a fixed rate.

    A cell ticks every 10 ms. At 30 Hz, a step therefore lasts three or four ticks, but the mean rate is exact.

    Args:
        cell: the cell. If its robot compensates the cables, actions refer to the true joints, else to the encoders.
        arms: names of the working arms, in order.
        action: kind of action, one of ``ACTIONS``.
        rate_hz: actions per second.

    Attributes:
        names: names of an action's numbers.
        low: their lower bounds.
        high: their upper bounds.
    """

    def __init__(self, cell: Cell, arms: Sequence[str], action: str, rate_hz: float = 30.0):
        require_actions(action, rate_hz)
        self._cell, self.arms, self._kind, self._rate_hz = cell, tuple(arms), action, rate_hz
        self.names = _action_names(self.arms, action, cell)
        bounds = [_bounds(cell, arm, action, rate_hz) for arm in self.arms]
        self.low, self.high = (np.hstack(side) for side in zip(*bounds, strict=True))
        self._steps, self._at_tick, self._lasts_s = 0, 0, TICK_S
        self._begins_s = cell.clock.now_s()
        self._goals = {arm: cell.robot.setpoint(arm).q for arm in self.arms}
        self._held: dict[str, SO3] = {}  # orientations in the world, kept by increments without a rotation
        self._jaws: dict[str, float] = {}
        self._turns: dict[str, NDArray[np.float64]] = {}

    def next_step_s(self) -> float:
        """Begin the next step and return its duration: whole ticks, which average to the rate."""
        self._steps += 1
        at_tick = int(self._steps / self._rate_hz / TICK_S + 1e-6)
        self._lasts_s, self._at_tick = (at_tick - self._at_tick) * TICK_S, at_tick
        return self._lasts_s

    async def step(self) -> None:
        """Wait until the next step is over; steps that begin late catch up."""
        self.next_step_s()
        ends_s = self._begins_s + self._at_tick * TICK_S  # half a tick early, since a sleep may end a tick late
        await self._cell.clock.sleep(max(0.0, ends_s - TICK_S / 2 - self._cell.clock.now_s()))

    def observe(self) -> dict[str, NDArray[np.float32]]:
        """Return the readings: ``joints`` (six and the jaw of each arm) and ``state`` (tips' poses and jaws)."""
        rows, poses = [], []
        for arm in self.arms:
            reading = self._cell.robot.read(arm)
            q = reading.q + _untold(self._cell.robot, arm)
            tip = self._cell.T_world_base_registered[arm] @ fk(self._cell.arms[arm], q)
            self._turns[arm] = turn = turn_beside(tip.rotation.as_quaternion()[[1, 2, 3, 0]], self._turns.get(arm))
            rows += [q, [reading.jaw_rad]]
            poses += [tip.translation_m, turn, [reading.jaw_rad]]
        return {"joints": np.hstack(rows).astype(np.float32), "state": np.hstack(poses).astype(np.float32)}

    def checked(self, action: ArrayLike) -> NDArray[np.float64]:
        """Return an action as numbers.

        Raises:
            InvalidInput: it has the wrong shape, or is not finite.
        """
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            problem = f"is {type(action).__name__}, not numbers"
            raise InvalidInput("the action", problem, f"give {len(self.names)} numbers") from None
        if values.shape != self.low.shape:
            remedy = f"give {len(self.names)} numbers: {', '.join(self.names)}"
            raise InvalidInput("the action", f"has the shape {values.shape}", remedy)
        wrong = ~np.isfinite(values)
        if wrong.any():
            raise InvalidValue(f"{self.names[int(wrong.argmax())]} of the action", values[wrong][0], "give a number")
        return values

    def require_inside(self, values: NDArray[np.float64]) -> None:
        """Raise unless an action keeps its bounds."""
        outside = (values < self.low - 1e-6) | (values > self.high + 1e-6)
        if outside.any():
            at = int(outside.argmax())
            bounds = f"give {self.low[at]:.6g} to {self.high[at]:.6g}, as gymnasium.wrappers.ClipAction does"
            raise InvalidValue(f"{self.names[at]} of the action", f"{values[at]:.6g}", bounds)

    async def act(self, values: NDArray[np.float64], answer: Answer) -> None:
        """Start an action and write its outcome into ``answer``; return when no arm follows it any more.

        Args:
            values: as ``checked`` returns them, inside their bounds.
            answer: complete when this function first waits.
        """
        async with trio.open_nursery() as nursery:
            for arm, part in zip(self.arms, np.split(values, len(self.arms)), strict=True):
                jaw = self._cell.arms[arm].jaw
                jaw_rad = float(np.clip(part[-1], jaw.lower, jaw.upper))
                if abs(jaw_rad - self._jaws.get(arm, np.inf)) > SAME_RAD:
                    self._jaws[arm] = jaw_rad
                    nursery.start_soon(self._cell.robot.jaw, arm, jaw_rad)
                nursery.start_soon(self._follow, arm, part[:-1], answer)

    async def _follow(self, arm: str, part: NDArray[np.float64], answer: Answer) -> None:
        model, limits, now = self._cell.arms[arm], self._cell.limits[arm], self._cell.robot.setpoint(arm)
        before, period_s = self._goals[arm], self._lasts_s
        try:
            goal = np.clip(self._goal(arm, part), model.lower, model.upper)
            velocity = np.clip(now.velocity, -limits.velocity, limits.velocity)
            point = now.q + velocity * period_s / 2  # control point of the B-spline: see step_towards
            asked, moves = (goal - point) / period_s, (goal - before) / period_s
            shares = np.abs(asked) / limits.velocity, np.abs(asked - velocity) / (limits.acceleration * period_s)
            factor = float(np.max(shares))
            if self._kind == CARTESIAN:
                moves = slowed_together(asked, velocity, limits, period_s)
                goal = point + moves * period_s
                if part[3:6].any():  # a rotation that was cut short is not made up for
                    del self._held[arm]
            motion = step_towards(goal, moves, now.q, velocity, limits, period_s)
            self._goals[arm] = goal
            if factor > 1.0 + 1e-6:
                answer.slowed[arm] = round(factor, 3)
                if self._kind != CARTESIAN:
                    self._goals[arm] = motion(motion.times_s[-1])  # not reached: go on from where the motion ends
            robot = self._cell.robot
            await (
                robot.follow({arm: motion}, period_s)
                if isinstance(robot, Compensated)
                else robot.replace({arm: motion})
            )
        except MotionRefused as error:
            answer.refused[arm] = str(error)
            self._goals[arm] = self._cell.robot.setpoint(arm).q

    def _goal(self, arm: str, part: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (6,) that an arm's part of an action asks for."""
        if self._kind == JOINTS:
            return part
        model, near, T_world_base = self._cell.arms[arm], self._goals[arm], self._cell.T_world_base_registered[arm]
        if self._kind == CARTESIAN:
            tip = T_world_base @ fk(model, near)
            turned = SO3.exp(part[3:6]) @ self._held.setdefault(arm, tip.rotation)
            wanted = SE3.from_parts(turned, tip.translation_m + part[:3])
        elif np.linalg.norm(part[3:7]) < 1e-6:
            raise OutOfReach(f"the orientation of arm {arm!r} is no quaternion: all four are 0", arm=arm)
        else:
            wanted = SE3.from_parts(SO3.from_quaternion(part[[6, 3, 4, 5]]), part[:3])
        return ik(model, T_world_base.inverse() @ wanted, near)


def slowed_together(
    asked: NDArray[np.float64], velocity: NDArray[np.float64], limits: MotionLimits, period_s: float
) -> NDArray[np.float64]:
    """Return the velocity (joints,) after a period: as near to the requested one as the limits allow.

    All joints are slowed by the same factor. The result is then a weighted mean of the present and the requested joint
    velocity, and so is the tip's velocity: the tip nearly keeps its line and its orientation.

    Args:
        asked: (joints,) requested velocity.
        velocity: (joints,) velocity now, within limits.
        limits: of the arm.
        period_s: time until another velocity is requested.
    """
    asked = asked / max(1.0, float((np.abs(asked) / limits.velocity).max()))
    change = asked - velocity
    return velocity + change / max(1.0, float((np.abs(change) / (limits.acceleration * period_s)).max()))


def observation_bounds(cell: Cell, arms: Sequence[str]) -> dict[str, tuple[NDArray, NDArray, list[str]]]:
    """Return lower bounds, upper bounds and names of what ``Control.observe`` returns."""
    models = [cell.arms[arm] for arm in arms]
    low = np.hstack([np.append(m.lower, m.jaw.lower) for m in models]) - OVER
    high = np.hstack([np.append(m.upper, m.jaw.upper) for m in models]) + OVER
    sides = [np.tile([side] * 3 + [side * 1.001] * 4 + [0.0], len(arms)) for side in (-REACH_M, REACH_M)]
    for side, joints in zip(sides, (low, high), strict=True):
        side[WIDTH - 1 :: WIDTH] = joints[6::7]
    return {
        "joints": (low, high, _action_names(arms, JOINTS, cell, "")),
        "state": (sides[0], sides[1], state_names(arms)),
    }


def _action_names(arms: Sequence[str], action: str, cell: Cell, mark: str = "_sp") -> list[str]:
    if action == ABSOLUTE:
        return action_names(arms)
    axes = [f"{what}.{axis}" for what in ("position", "rotation") for axis in "xyz"]
    return [
        name
        for arm in arms
        for name in (
            *(f"{arm}{mark}.{joint.name}" for joint in cell.arms[arm].joints if action == JOINTS),
            *(f"{arm}_cr.{axis}" for axis in axes if action == CARTESIAN),
            f"{arm}_jaw{mark}",
        )
    ]


def _bounds(cell: Cell, arm: str, action: str, rate_hz: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower and upper bounds of an arm's part of an action."""
    model = cell.arms[arm]
    low, high = model.lower, model.upper
    if action != JOINTS:
        cartesian = np.array([SPEED_M] * 3 + [SPEED_RAD] * 3) / rate_hz
        high = cartesian if action == CARTESIAN else np.array([REACH_M] * 3 + [1.0] * 4)
        low = -high
    return np.append(low, model.jaw.lower), np.append(high, model.jaw.upper)


def _untold(robot: Robot, arm: str) -> NDArray[np.float64] | float:
    """Return the offset (6,) of an arm by injected noise (``Shaken``) that the compensation above it does not know.

    The compensation estimates the joints near the requested ones, but the push has moved the arm away from there.
    """
    below = robot.robot if isinstance(robot, Compensated) else None
    return below.push(arm) if isinstance(below, Shaken) else 0.0


class Eyes:
    """The cameras of a cell, each with its last image; ``watch`` takes images in turn."""

    def __init__(self, cell: Cell):
        self._cell = cell
        self.last: dict[str, Image] = {}

    async def watch(self) -> None:
        """Take images, camera by camera, until cancelled."""
        while True:
            for name, camera in self._cell.cameras.items():
                self.last[name] = await camera.capture(whole_window(camera.model))  # a windowed image is not kept

    def observe(self) -> dict[str, NDArray[np.uint8]]:
        """Return each camera's last image (height, width, 3), black before the first; stereo images side by side."""
        found = {}
        for name, camera in self._cell.cameras.items():
            image = self.last.get(name)
            if image is None:
                found[f"{IMAGES}_{name}"] = np.zeros(image_shape(camera.model), np.uint8)
            else:
                color = image.color if isinstance(image, RgbdImage) else np.hstack([image.left, image.right])
                found[f"{IMAGES}_{name}"] = np.array(color, dtype=np.uint8)  # a copy: the receiver may draw on it
        return found


def image_shape(model: CameraModel) -> tuple[int, int, int]:
    """Return height, width and 3 of a camera's image; stereo images lie side by side."""
    eyes = [model] if isinstance(model, Intrinsics) else [model.left, model.right]
    return eyes[0].height, sum(eye.width for eye in eyes), 3
