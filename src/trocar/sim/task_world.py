"""What a task puts into the simulated world: bodies, what acts on them, what its referee watches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from trocar.sim.touches import Hit

if TYPE_CHECKING:
    from trocar.sim.record import Record
    from trocar.sim.world import World


class TaskWorld:
    """A task's side of the simulator. By itself it is an empty world; a task overrides what it needs.

    Attributes:
        sleeps: whether bodies that lie still may be left out of the physics until something touches them.
    """

    sleeps = False

    def add(self, world: Element, assets: Element) -> None:
        """Add bodies to MuJoCo's ``worldbody`` and ``asset``; helpers stand in ``trocar.sim.elements``.

        A body with a free joint is recorded and replayed by its name.
        """

    def start(self, world: World) -> None:
        """Look up what is needed in the finished world; called once, with the arms in their places."""

    def act(self) -> None:
        """Do what MuJoCo does not know of; called before every few steps of the physics."""

    def hit(self, first: int, second: int) -> Hit | None:
        """Return who hits what if a contact between these two geoms counts as a collision, else None.

        Two arms are looked at already.
        """
        del first, second
        return None

    def counts(self, hit: Hit, normal: NDArray[np.float64]) -> bool:
        """Return whether a contact with this normal (3,) counts; asked only of hits with some force."""
        del hit, normal
        return True

    def observe(self, time_s: float) -> None:
        """Look once; called after each tick of the controller, before contacts are asked about with ``hit``."""

    def truth(self, record: Record) -> Any:
        """Return what really happened, for the task's score alone."""
        return record

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return what a trial keeps for the task's own pictures, beside joints and poses."""
        del record
        return {}

    def assistants(self) -> Mapping[str, Any]:
        """Return the people beside the robot, by what they do."""
        return {}
