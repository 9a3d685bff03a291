"""Suture plans as plain values in SI units, and reading them back from the file that ``trocar plan suture`` saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ARMS, ArmModel
from trocar.errors import BadFile, InvalidInput, InvalidValue
from trocar.files.reading import read_json
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning.plan import check_count
from trocar.tasks.suture.planning.primitive import Suture, sutures_at
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
            raise InvalidInput(
                "a plan",
                f"has positions {thetas.shape} and directions {directions.shape}",
                "give one of each per suture",
            )
        check_count(len(thetas))
        if not np.all((thetas >= 0) & (thetas <= TURN)):
            raise InvalidInput("a plan", f"has positions {np.degrees(thetas).tolist()} deg", "give 0 to 360 deg")
        if not np.isin(directions, DIRECTIONS).all():
            raise InvalidInput(
                "a plan", f"has directions {directions.tolist()}", "give 1 (clockwise) or -1 (counterclockwise)"
            )
        object.__setattr__(self, "positions_rad", thetas)
        object.__setattr__(self, "directions", directions.astype(np.intp))

    def __repr__(self) -> str:
        angles = ", ".join(f"{angle:.0f}" for angle in np.degrees(self.positions_rad[:12]))
        more = ", ..." if len(self.positions_rad) > 12 else ""
        return f"<PlannedSutures: {len(self.positions_rad)}, in order at {angles}{more} deg>"

    @cached_property
    def sutures(self) -> tuple[Suture, ...]:
        """Return the sutures one by one."""
        return sutures_at(self.setup, self.positions_rad, self.directions)

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
        BadFile: the file cannot be read, or holds no such plan.
    """
    try:
        values = read_json(path)
    except OSError as error:
        raise BadFile(path, f"cannot be read ({error.strerror})", MADE_BY, kind="plan") from None
    except ValueError:
        raise BadFile(path, "is not JSON", MADE_BY, kind="plan") from None
    if not isinstance(values, dict):
        raise BadFile(path, "holds no plan", MADE_BY, kind="plan")
    for key in ("setup", "positions_deg", "directions"):
        if key not in values:
            raise BadFile(path, f"has no key {key!r}", "plan again with `trocar plan suture --out DIR`", kind="plan")
    try:
        positions = np.radians(_numbers(values["positions_deg"], "positions_deg"))
        directions = np.array(_numbers(values["directions"], "directions"))
        return PlannedSutures(setup_from(values["setup"]), positions, directions)
    except InvalidInput as error:
        raise BadFile(path, f"holds no plan: {error}", kind="plan") from None


def setup_values(value: Any) -> Any:
    """Return a setup, or a part of one, as JSON values: its arm by name, the rest in SI units."""
    if isinstance(value, ArmModel):
        return value.name
    if isinstance(value, SE3):
        return value.matrix.tolist()
    if is_dataclass(value):
        return {field.name: setup_values(getattr(value, field.name)) for field in fields(value)}
    return value


def setup_from(values: object) -> SutureSetup:
    """Return the setup that ``setup_values`` described.

    Raises:
        InvalidInput: a key is missing or unknown, or no setup can have one of the values.
    """
    return _made(values, SutureSetup(), "setup")


def _made(value: object, like: Any, where: str) -> Any:
    """Return a part of a setup from JSON values.

    Args:
        value: the JSON value.
        like: an example of the part, which gives its type.
        where: its keys, for error sentences.
    """
    if isinstance(like, ArmModel):
        if not isinstance(value, str) or value not in ARMS:
            raise InvalidValue(where, _short(value), f"choose one of {', '.join(ARMS)}")
        return ARMS[value]
    if isinstance(like, SE3):
        return _pose(value, where)
    if isinstance(like, float):
        return _number(value, where)
    if not is_dataclass(like):
        if not isinstance(value, type(like)) or isinstance(value, bool):
            raise InvalidValue(where, _short(value), f"give {'a whole number' if isinstance(like, int) else 'a word'}")
        return value
    names = [field.name for field in fields(like)]
    if not isinstance(value, Mapping):
        raise InvalidValue(where, _short(value), f"give a table of {', '.join(names)}")
    for what, wrong in (("has no key", set(names) - set(value)), ("has an unknown key", set(value) - set(names))):
        if wrong:
            raise InvalidInput(where, f"{what} {min(wrong)!r}", f"give {', '.join(names)}")
    parts = {name: _made(value[name], getattr(like, name), f"{where}.{name}") for name in names}
    return type(like)(**parts)  # type: ignore[operator]


def _pose(value: object, where: str) -> SE3:
    rows = value if isinstance(value, list) else []
    matrix = np.array([_numbers(row, where) for row in rows if isinstance(row, list) and len(row) == 4])
    if len(rows) != 4 or matrix.shape != (4, 4):
        raise InvalidValue(where, _short(value), "give a pose, four rows of four numbers")
    R = matrix[:3, :3]
    off = max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(matrix[3] - [0, 0, 0, 1]).max())
    if not off <= RIGID or np.linalg.det(R) < 0:
        raise InvalidInput(
            where,
            "is not a rigid pose",
            "give a rotation in its first three rows and columns, and 0, 0, 0, 1 below",
        )
    return SE3(matrix)


def _numbers(value: object, where: str) -> list[float]:
    if not isinstance(value, list):
        raise InvalidValue(where, _short(value), "give a list of numbers")
    return [_number(item, where) for item in value]


def _number(value: object, where: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        return float(value)
    raise InvalidValue(where, _short(value), "give finite numbers")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
