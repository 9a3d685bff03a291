"""Make a cell from a station: simulated, or on hardware with the same scripts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Literal, Protocol, overload

import numpy as np

from trocar.cell import Cell
from trocar.errors import InvalidValue
from trocar.lab import Station, load_station
from trocar.registry import Lazy, Registry

if TYPE_CHECKING:
    from trocar.sim.laboratory import SimLaboratory


class Laboratory(Protocol):
    """Something that runs scripts in a cell."""

    @property
    def cell(self) -> Cell:
        """Return the cell that scripts are given."""
        ...

    def run(self, script: Callable[[Cell], Awaitable[Any]], budget_s: float) -> bool:
        """Run a script; return whether it ended within its budget. Afterwards every arm is at rest."""
        ...


BACKENDS: Registry[Callable[[Station, np.random.Generator], Laboratory]] = Registry(
    "backend", "trocar.backends", {"sim": Lazy("trocar.sim.laboratory:simulated")}
)
"""Functions of (station, random generator) to a :class:`Laboratory`, by name."""


@overload
def build_cell(station: Station | str, backend: Literal["sim"] = "sim", seed: int = 0) -> SimLaboratory: ...


@overload
def build_cell(station: Station | str, backend: str, seed: int = 0) -> Laboratory: ...


def build_cell(station: Station | str, backend: str = "sim", seed: int = 0) -> Laboratory:
    """Return a laboratory whose ``cell`` has the station's arms and cameras, and whose ``run`` runs scripts in it.

    In simulation a session is drawn, with the registration and cable errors of one particular day.

    Args:
        station: a station, its name, or the path of its TOML file.
        backend: name in ``BACKENDS``.
        seed: seed of all random numbers.

    Raises:
        InvalidInput: station or backend are unknown, or the seed is negative.

    Example:
        lab = build_cell("raven-pair", seed=3)

        async def script(cell):
            print(await cell.robot.jaw("left", 1.0))

        lab.run(script, budget_s=10.0)
    """
    if seed < 0:
        raise InvalidValue("the seed", seed, "give 0 or more")
    station = station if isinstance(station, Station) else load_station(station)
    return BACKENDS.pick(backend)(station, np.random.default_rng(seed))
