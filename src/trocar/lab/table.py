"""Tables of a TOML file: every key is read and checked; a key that is not read is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3

RIGID = 1e-3
"""Printed rotations have four digits; within this they are made exact; beyond it they are not rotations."""
MAX_M = 5.0


class Table:
    """A TOML table whose keys are read one by one; keys that were not read are unknown.

    Args:
        values: what the file has there.
        where: its name in error messages.

    Attributes:
        where: likewise.
    """

    def __init__(self, values: object, where: str):
        if not isinstance(values, Mapping):
            raise TrocarError(f"{where} is {values!r}; give a table")
        self._values, self.where = dict(values), where
        self._asked: list[str] = []

    def has(self, key: str) -> bool:
        """Return whether a key is present; it then counts as read."""
        self._asked.append(key)
        return key in self._values

    def _get(self, key: str, default: Any) -> Any:
        if not self.has(key):
            if default is None:
                raise TrocarError(f"{self.where} has no key {key!r}; add it")
            return default
        return self._values[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string that is not empty."""
        value = self._get(key, default)
        if not isinstance(value, str) or not value.strip():
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a string")
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """Return a string that is one of these words."""
        value = self.text(key, default)
        if value not in choices:
            raise TrocarError(f"{self.where}.{key} is {value!r}; choose one of {', '.join(choices)}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise TrocarError(f"{self.where}.{key} is {value!r}; give true or false")
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a number within bounds."""
        return self._number(self._get(key, default), key, low, high)

    def _number(self, value: object, key: str, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a number from {low:g} to {high:g}")
        return float(value)

    def numbers(
        self, key: str, count: int, low: float, high: float, default: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return numbers (count,) within bounds."""
        value = self._get(key, default)
        if isinstance(value, np.ndarray):
            return value
        if not isinstance(value, list) or len(value) != count:
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a list of {count} numbers")
        return np.array([self._number(item, key, low, high) for item in value])

    def rows(self, key: str, rows: int, columns: int) -> NDArray[np.float64]:
        """Return numbers (rows, columns)."""
        value = self._get(key, None)
        if (
            not isinstance(value, list)
            or len(value) != rows
            or any(not isinstance(row, list) or len(row) != columns for row in value)
        ):
            raise TrocarError(f"{self.where}.{key} is {value!r}; give {rows} lists of {columns} numbers")
        return np.array([[self._number(item, key, -1e4, 1e4) for item in row] for row in value])

    def table(self, key: str) -> Table:
        """Return a table; empty if there is none."""
        return Table(self._get(key, {}), f"{self.where}.{key}")

    def tables(self, key: str) -> dict[str, Table]:
        """Return the tables in a table, by name."""
        table = self.table(key)
        return {str(name): Table(value, f"{table.where}.{name}") for name, value in table._values.items()}

    def close(self) -> None:
        """Refuse keys that were not read."""
        unknown = [key for key in self._values if key not in self._asked]
        if unknown:
            known = ", ".join(dict.fromkeys(self._asked))
            raise TrocarError(f"{self.where} has an unknown key {unknown[0]!r}; known are {known}")


def box(table: Table, key: str) -> NDArray[np.float64] | None:
    """Return lower and upper corner (2, 3) in m of a box in mm; None if there is none."""
    if not table.has(key):
        return None
    corners = 1e-3 * table.rows(key, 2, 3)
    if not (corners[0] < corners[1]).all():
        raise TrocarError(f"{table.where}.{key} is not a box; give [lower corner, upper corner], lower < upper")
    return corners


def pose(table: Table) -> SE3:
    """Return a pose: ``xyz_mm`` with ``rpy_deg`` (Rz(yaw) Ry(pitch) Rx(roll)) or ``rotation``, three rows."""
    place = 1e-3 * table.numbers("xyz_mm", 3, -1e3 * MAX_M, 1e3 * MAX_M, default=np.zeros(3))
    if table.has("rotation"):
        given = table.rows("rotation", 3, 3)
        if np.abs(given @ given.T - np.eye(3)).max() > RIGID or np.linalg.det(given) < 0:
            raise TrocarError(f"{table.where}.rotation is not a rotation; give three orthonormal rows, determinant +1")
        u, _, vt = np.linalg.svd(given)
        turn = SO3.unchecked(u @ vt)
    else:
        roll, pitch, yaw = np.radians(table.numbers("rpy_deg", 3, -360.0, 360.0, default=np.zeros(3)))
        turn = SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)
    table.close()
    return SE3.from_parts(turn, place)
