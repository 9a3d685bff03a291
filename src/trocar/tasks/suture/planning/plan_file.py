"""Suture plans as plain values in SI units, and reading them back from the file that ``trocar plan suture`` saves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ARMS, ArmModel
from trocar.errors import TrocarError
from trocar.files.reading import read_json
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning.drive import Suture
from trocar.tasks.suture.planning.plan import check_count
from trocar.tasks.suture.planning.setup import DIRECTIONS, SutureSetup

RIGID = 1e-6
"""Tolerance of unit length and right angles of a rotation's columns."""

MADE_BY = "give the plan.json of `trocar plan suture --out DIR`"


@dataclass(frozen=True, eq=False)
class PlannedSutures:
    """The part of a plan that is needed to drive it; sutures are driven in this order.

    Attributes:
        setup: the geometry.
        positions_rad: (n,) in [0, 2 pi].
        directions: (n,) each one of ``DIRECTIONS``.
    """

    setup: SutureSetup
    positions_rad: NDArray[np.float64]
    directions: NDArray[np.intp]

    def __post_init__(self) -> None:
        thetas, directions = np.asarray(self.positions_rad, dtype=np.float64), np.asarray(self.directions)
        if thetas.ndim != 1 or directions.shape != thetas.shape:
            raise TrocarError(
                f"a plan has positions {thetas.shape} and directions {directions.shape}; give one of each per suture"
            )
        check_count(len(thetas))
        if not np.all((thetas >= 0) & (thetas <= TURN)):
            raise TrocarError(f"the positions of a plan are {np.degrees(thetas).tolist()} deg; give 0 to 360 deg")
        if not np.isin(directions, DIRECTIONS).all():
            raise TrocarError(
                f"the directions of a plan are {directions.tolist()}; give 1 (clockwise) or -1 (counterclockwise)"
            )
        object.__setattr__(self, "positions_rad", thetas)
        object.__setattr__(self, "directions", directions.astype(np.intp))

    def __repr__(self) -> str:
        return f"<PlannedSutures: {len(self.positions_rad)}, in order at {_degrees(self.positions_rad)} deg>"

    @cached_property
    def sutures(self) -> tuple[Suture, ...]:
        """Return the sutures one by one."""
        both = zip(self.positions_rad.tolist(), self.directions.tolist(), strict=True)
        return tuple(Suture(self.setup, theta, direction) for theta, direction in both)

    def values(self) -> dict[str, Any]:
        """Return the plan as JSON values."""
        return {
            "setup": setup_values(self.setup),
            "positions_rad": self.positions_rad.tolist(),
            "directions": self.directions.tolist(),
        }


def load_plan(path: str | Path) -> PlannedSutures:
    """Return the sutures of a ``plan.json`` that ``trocar plan suture`` saved.

    Raises:
        TrocarError: the file does not exist, or holds no such plan.
    """
    path = Path(path)
    try:
        values = read_json(path)
    except FileNotFoundError:
        raise TrocarError(f"there is no file {str(path)!r}; {MADE_BY}") from None
    except OSError as error:
        raise TrocarError(f"cannot read plan {str(path)!r} ({error.strerror}); {MADE_BY}") from None
    except ValueError:
        raise TrocarError(f"{str(path)!r} is not JSON; {MADE_BY}") from None
    if not isinstance(values, dict):
        raise TrocarError(f"{str(path)!r} holds no plan; {MADE_BY}")
    for key in ("setup", "positions_deg", "directions"):
        if key not in values:
            raise TrocarError(
                f"{str(path)!r} has no key {key!r}: made by an older trocar or not by `trocar plan suture`; plan again"
            )
    try:
        positions = np.radians(_numbers(values["positions_deg"], "positions_deg"))
        directions = np.array(_numbers(values["directions"], "directions"))
        return PlannedSutures(setup_from(values["setup"]), positions, directions)
    except TrocarError as error:
        raise TrocarError(f"plan {str(path)!r}: {error}") from None


def setup_values(setup: SutureSetup) -> dict[str, Any]:
    """Return a setup as JSON values: its arm by name, the rest in SI units."""
    return _plain(setup)


def setup_from(values: object) -> SutureSetup:
    """Return the setup that ``setup_values`` described.

    Raises:
        TrocarError: a key is missing or unknown, or no setup can have one of the values.
    """
    return _made(values, SutureSetup(), "setup")


def _plain(value: Any) -> Any:
    """Return a part of a setup as JSON values."""
    if isinstance(value, ArmModel):
        return value.name
    if isinstance(value, SE3):
        return value.matrix.tolist()
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value


def _made(value: object, like: Any, where: str) -> Any:
    """Return a part of a setup from JSON values.

    Args:
        value: the JSON value.
        like: an example of the part, which gives its type.
        where: its keys, for error sentences.
    """
    if isinstance(like, ArmModel):
        if not isinstance(value, str) or value not in ARMS:
            raise TrocarError(f"{where} is {_short(value)}; choose one of {', '.join(ARMS)}")
        return ARMS[value]
    if isinstance(like, SE3):
        return _pose(value, where)
    if is_dataclass(like):
        names = [field.name for field in fields(like)]
        found = _table(value, names, where)
        parts = {name: _made(found[name], getattr(like, name), f"{where}.{name}") for name in names}
        return type(like)(**parts)  # type: ignore[operator]
    if isinstance(like, float):
        return _number(value, where)
    if not isinstance(value, type(like)) or isinstance(value, bool):
        raise TrocarError(f"{where} is {_short(value)}; give {'a whole number' if isinstance(like, int) else 'a word'}")
    return value


def _table(value: object, names: list[str], where: str) -> Mapping[str, object]:
    """Return a table that has exactly these keys, or raise TrocarError."""
    if not isinstance(value, Mapping):
        raise TrocarError(f"{where} is {_short(value)}; give a table of {', '.join(names)}")
    for what, wrong in (
        ("has no key", [name for name in names if name not in value]),
        ("has an unknown key", [name for name in value if name not in names]),
    ):
        if wrong:
            raise TrocarError(f"{where} {what} {wrong[0]!r}; give {', '.join(names)}")
    return value


def _pose(value: object, where: str) -> SE3:
    """Return a rigid pose, or raise TrocarError."""
    rows = value if isinstance(value, list) else []
    matrix = np.array([_numbers(row, where) for row in rows if isinstance(row, list) and len(row) == 4])
    if len(rows) != 4 or matrix.shape != (4, 4):
        raise TrocarError(f"{where} is {_short(value)}; give a pose, four rows of four numbers")
    R = matrix[:3, :3]
    off = max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(matrix[3] - [0, 0, 0, 1]).max())
    if not off <= RIGID or np.linalg.det(R) < 0:
        raise TrocarError(
            f"{where} is not a rigid pose; give a rotation in its first three rows and columns, and 0, 0, 0, 1 below"
        )
    return SE3(matrix)


def _numbers(value: object, where: str) -> list[float]:
    """Return a list of finite numbers, or raise TrocarError."""
    if not isinstance(value, list):
        raise TrocarError(f"{where} is {_short(value)}; give a list of numbers")
    return [_number(item, where) for item in value]


def _number(value: object, where: str) -> float:
    """Return a finite number, or raise TrocarError."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value) if abs(value) < 1e300 else math.inf
        if math.isfinite(number):
            return number
    raise TrocarError(f"{where} is {_short(value)}; give finite numbers")


def _degrees(angles: NDArray[np.float64]) -> str:
    text = [f"{angle:.0f}" for angle in np.degrees(angles[:12])]
    return ", ".join(text + ["..."] * (len(angles) > 12))


def _short(value: object) -> str:
    """Return a value as shown in an error sentence, shortened if it is long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
