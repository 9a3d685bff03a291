"""Collisions: touches that should not have happened, each counted once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from trocar.sim.world import World

HIT_N = 0.5
"""A touch with less force than this is sliding, not a collision; .5 N does not visibly bend a peg (assumed)."""
APART_S = 0.2
"""A touch that recurs within this time is the same collision."""


class Hit(NamedTuple):
    """What hits what.

    Attributes:
        arm: name of the arm.
        what: ``arm``, or what it holds.
        against: the other arm's name, or the object that is hit.
    """

    arm: str
    what: str
    against: str


@dataclass(frozen=True)
class Collision:
    """One hit of an arm or of what it holds.

    Attributes:
        time_s: when it began, on the trial's clock.
        end_s: when it ended.
        arm: name of the arm.
        what: ``arm``, or what it holds.
        against: another arm's name, or the object that is hit.
        force_n: largest force while it lasted.
        p_world_m: where that was.
    """

    time_s: float
    end_s: float
    arm: str
    what: str
    against: str
    force_n: float
    p_world_m: tuple[float, float, float]


@dataclass
class _Touch:
    first_s: float
    last_s: float
    force_n: float
    p_world_m: tuple[float, float, float]


class ContactMonitor:
    """Watches the contacts of a world, tick by tick.

    Args:
        world: the world.
        hit: returns what hits what for two geoms; None for contacts that do not count.
        counts: whether a contact with this normal (3,) counts.
    """

    def __init__(
        self,
        world: World,
        hit: Callable[[int, int], Hit | None],
        counts: Callable[[Hit, NDArray[np.float64]], bool],
    ):
        self._world, self._hit, self._counts = world, hit, counts
        self._open: dict[Hit, _Touch] = {}
        self._closed: list[Collision] = []

    def observe(self, time_s: float) -> None:
        """Look once."""
        data, owner, names = self._world.data, self._world.geom_arm, self._world.arm_names
        pairs = data.contact.geom[: data.ncon]
        for contact in range(len(pairs)):
            first, second = int(pairs[contact, 0]), int(pairs[contact, 1])
            a, b = int(owner[first]), int(owner[second])
            found = Hit(names[a], "arm", names[b]) if a >= 0 and b >= 0 else self._hit(first, second)
            if found is None:
                continue
            force = np.zeros(6)
            mujoco.mj_contactForce(self._world.model, data, contact, force)
            if force[0] > HIT_N and self._counts(found, data.contact.frame[contact][:3]):
                self._note(found, time_s, float(force[0]), data.contact.pos[contact])

    def _note(self, hit: Hit, now_s: float, force_n: float, place_m: NDArray[np.float64]) -> None:
        place = tuple(np.round(place_m, 6).tolist())
        touch = self._open.get(hit)
        if touch is None or now_s - touch.last_s > APART_S:
            if touch is not None:
                self._closed.append(_collision(hit, touch))
            self._open[hit] = _Touch(now_s, now_s, force_n, place)  # type: ignore[arg-type]
            return
        touch.last_s = now_s
        if force_n > touch.force_n:
            touch.force_n, touch.p_world_m = force_n, place  # type: ignore[assignment]

    def collisions(self) -> tuple[Collision, ...]:
        """Return all so far, in order of time."""
        pending = [_collision(hit, touch) for hit, touch in self._open.items()]
        return tuple(sorted([*self._closed, *pending], key=lambda c: (c.time_s, c.arm, c.against)))


def _collision(hit: Hit, touch: _Touch) -> Collision:
    return Collision(round(touch.first_s, 6), round(touch.last_s, 6), *hit, round(touch.force_n, 3), touch.p_world_m)
