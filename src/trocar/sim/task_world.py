"""A task's part of the simulated world: bodies, what acts on them, what its referee observes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from trocar.sim.contacts import Hit

if TYPE_CHECKING:
    from trocar.sim.record import Record
    from trocar.sim.world import World


class TaskWorld:
    """A task's side of the simulator. The base class is an empty world; a task overrides what it needs.

    Attributes:
        sleeps: whether bodies at rest may be left out of the physics until something touches them.
    """

    sleeps = False

    def add(self, world: Element, assets: Element) -> None:
        """Add bodies to MuJoCo's ``worldbody`` and ``asset``; helpers stand in ``trocar.sim.elements``.

        A body with a free joint is recorded and replayed by its name.
        """

    def start(self, world: World) -> None:
        """Look up ids in the finished world; called once, with the arms in their places."""

    def act(self) -> None:
        """Apply effects that MuJoCo does not model; called before every few steps of the physics."""

    def hit(self, first: int, second: int) -> Hit | None:
        """Return who hits what if a contact between these two geoms counts as a collision, else None.

        Contacts between two arms are already handled.
        """
        del first, second
        return None

    def counts(self, hit: Hit, normal: NDArray[np.float64]) -> bool:
        """Return whether a contact with this normal (3,) counts; asked only of hits with some force."""
        del hit, normal
        return True

    def observe(self, time_s: float) -> None:
        """Observe the world; called after each tick of the controller, before ``hit`` is called for contacts."""

    def truth(self, record: Record) -> Any:
        """Return what really happened, only for the task's score."""
        return record

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return what is saved for the task's own pictures, beside joints and poses."""
        del record
        return {}

    def assistants(self) -> Mapping[str, Any]:
        """Return the people beside the robot, by what they do."""
        return {}
