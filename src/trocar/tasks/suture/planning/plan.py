"""A plan of sutures round the circle, the constraints on it, and the files that ``trocar plan suture`` saves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ARMS, ArmModel
from trocar.counting import counted
from trocar.errors import BadFile, InvalidInput, InvalidValue
from trocar.files.reading import read_json
from trocar.geometry import SE3, TURN, shown
from trocar.geometry.arrays import finite
from trocar.notebook import table
from trocar.tasks.suture.planning.primitive import Suture, sutures_at
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS, SutureSetup
from trocar.tasks.suture.planning.waypoints import waypoints

MAX_SUTURES = 360
SAME = 1e-6
"""Numbers of waypoints (m, rad, s) that differ by less are the same: saving a plan's angles in degrees rounds them."""
MADE_BY = "give the plan.json of `trocar plan suture --out DIR`"
PLAN = "plan.json"


@dataclass(frozen=True, eq=False)
class SuturePlan:
    """Where the sutures lie and in which direction each is driven.

    Attributes:
        positions_rad: (n,) ascending, in [0, 2 pi).
        directions: (n,) each one of ``DIRECTIONS``.
        rewards: (n,) dexterity of each suture.
        feasible: whether in every suture the joints stay within their limits, the wrist is deep enough, and the
            instrument stays clear of the tissue and, if there are any, of body wall and second arm.
        bound: proven upper bound on the ``reward`` of all plans on the grid; infinite for plans at any angles. If no
            plan is feasible although the reward puts feasibility first, it bounds the worst infeasible suture.
        certified: which plans ``bound`` covers, in words.
        spacing: the constraints on the positions; None: evenly spaced, and no others.
    """

    positions_rad: NDArray[np.float64]
    directions: NDArray[np.intp]
    rewards: NDArray[np.float64]
    feasible: bool
    bound: float
    certified: str
    spacing: Spacing | None = None

    def __repr__(self) -> str:
        kept = "within the limits" if self.feasible else "BEYOND the limits"
        count = len(self.positions_rad)
        return f"<SuturePlan of {counted(count, 'suture')}: reward {self.reward:.4f}, bound {self.bound:.4f}, {kept}>"

    def _repr_html_(self) -> str:
        columns = zip(self.positions_rad, self.directions, self.rewards, strict=True)
        rows = (
            (number, shown(theta, "rad"), DIRECTION_NAMES[int(direction)], f"{reward:.4f}")
            for number, (theta, direction, reward) in enumerate(columns, start=1)
        )
        return table(self, ("suture", "position", "direction", "dexterity"), rows)

    @property
    def reward(self) -> float:
        """Return the dexterity of the worst suture (paper, III-D3)."""
        return float(self.rewards.min())

    @property
    def gaps_rad(self) -> NDArray[np.float64]:
        """Return the gap (n,) from each suture to the next; gaps add up to a whole turn."""
        return np.diff(self.positions_rad, append=self.positions_rad[0] + TURN)


Planner = Callable[[DexterityMap], SuturePlan]
"""Makes the best plan of a map."""


@dataclass(frozen=True)
class Spacing:
    """Constraints on the positions of the sutures.

    Attributes:
        min_gap_rad: smallest gap between neighbours.
        max_gap_rad: largest gap between neighbours.
        forbidden_rad: arcs (from, to), counterclockwise, without sutures; their ends are allowed.
        fixed_rad: positions that must hold a suture.
    """

    min_gap_rad: float
    max_gap_rad: float
    forbidden_rad: tuple[tuple[float, float], ...] = ()
    fixed_rad: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        low, high = self.min_gap_rad, self.max_gap_rad
        if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high <= TURN):
            raise InvalidInput(
                "the gaps between sutures",
                f"are bounded by {shown(low, 'rad', 'g')} and {shown(high, 'rad', 'g')}",
                "give a smallest gap above 0 and at most the largest, and a largest gap of at most 360 deg",
            )
        object.__setattr__(self, "forbidden_rad", tuple(_arc(arc) for arc in self.forbidden_rad))
        fixed = finite("the fixed positions in rad", self.fixed_rad, "n") % TURN
        object.__setattr__(self, "fixed_rad", tuple(sorted(set(fixed.tolist()))))

    @staticmethod
    def even(count: int) -> Spacing:
        """Return the spacing of the paper: all gaps equal."""
        return Spacing(TURN / count, TURN / count)

    def allows(self, thetas_rad: ArrayLike) -> NDArray[np.bool_]:
        """Return which positions (n,) lie outside all forbidden arcs."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        allowed = np.ones(thetas.shape, dtype=bool)
        for start, end in self.forbidden_rad:
            into = np.mod(thetas - start, TURN)
            allowed &= (into <= 1e-9) | (into >= (end - start) - 1e-9)
        return allowed

    def check(self, count: int) -> None:
        """Raise InvalidInput if ``count`` gaps cannot add up to a turn, or the fixed positions contradict the rest."""
        check_count(count)
        low, high = math.degrees(self.min_gap_rad), math.degrees(self.max_gap_rad)
        if not count * low <= 360 * (1 + 1e-9) or not count * high >= 360 * (1 - 1e-9):
            raise InvalidInput(
                f"{count} gaps of {low:g} to {high:g} deg",
                f"add up to {count * low:g} to {count * high:g} deg, not to 360",
                f"give a smallest gap of at most {360 / count:g} deg and a largest gap of at least that, or another "
                "number of sutures",
            )
        fixed = self.fixed_rad
        if len(fixed) > count:
            raise InvalidInput(
                f"{len(fixed)} positions", f"are fixed, but only {count} sutures are planned", "plan more"
            )
        if blocked := [angle for angle, allowed in zip(fixed, self.allows(fixed), strict=True) if not allowed]:
            position = f"the fixed position {shown(blocked[0], 'rad', 'g')}"
            raise InvalidInput(position, "lies in a forbidden arc", "move one of the two")


def check_count(count: int) -> None:
    """Raise InvalidValue unless ``count`` sutures can be planned."""
    if count not in range(1, MAX_SUTURES + 1):
        raise InvalidValue("the number of sutures", count, f"give a whole number from 1 to {MAX_SUTURES}")


def _arc(arc: Sequence[float]) -> tuple[float, float]:
    """Return a forbidden arc with 0 <= from < 2 pi and from < to < from + 2 pi."""
    angles = finite("the ends of a forbidden arc in rad", arc, 2)
    start, length = float(angles[0] % TURN), float((angles[1] - angles[0]) % TURN)
    if length == 0.0 or abs(angles[1] - angles[0]) > TURN:
        ends = f"goes from {shown(angles[0], 'rad', 'g')} to {shown(angles[1], 'rad', 'g')}"
        raise InvalidInput("a forbidden arc", ends, "its ends must differ by less than a whole turn")
    return start, start + length


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
            shapes = f"has positions {thetas.shape} and directions {directions.shape}"
            raise InvalidInput("a plan", shapes, "give one of each per suture")
        check_count(len(thetas))
        if not np.all((thetas >= 0) & (thetas <= TURN)):
            raise InvalidInput("a plan", f"has positions {np.degrees(thetas).tolist()} deg", "give 0 to 360 deg")
        if not np.isin(directions, DIRECTIONS).all():
            found = f"has directions {directions.tolist()}"
            raise InvalidInput("a plan", found, "give 1 (clockwise) or -1 (counterclockwise)")
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
        positions, directions = self.positions_rad.tolist(), self.directions.tolist()
        return {"setup": setup_values(self.setup), "positions_rad": positions, "directions": directions}


def load_plan(path: str | Path) -> PlannedSutures:
    """Return the sutures of a ``plan.json`` or ``waypoints.json`` that ``trocar plan suture`` saved, or of its folder.

    Raises:
        BadFile: the file cannot be read, holds no such plan, or holds waypoints that are not those of its plan.
    """
    path = Path(path) / PLAN if Path(path).is_dir() else Path(path)
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
        plan = PlannedSutures(setup_from(values["setup"]), positions, directions)
    except InvalidInput as error:
        raise BadFile(path, f"holds no plan: {error}", kind="plan") from None
    if "stitches" in values and not _same(values["stitches"], [waypoints(suture).values() for suture in plan.sutures]):
        remedy = "an arm follows the plan and corrects it: change the plan, and save its waypoints anew"
        raise BadFile(path, "holds waypoints that are not those of its plan", remedy, kind="plan")
    return plan


def _same(found: object, expected: object) -> bool:
    """Return whether two JSON values are the same, numbers up to rounding."""
    if isinstance(expected, dict):
        if not isinstance(found, dict) or found.keys() != expected.keys():
            return False
        return all(_same(found[key], value) for key, value in expected.items())
    if isinstance(expected, list):
        return isinstance(found, list) and len(found) == len(expected) and all(map(_same, found, expected))
    if isinstance(expected, float):
        return isinstance(found, int | float) and abs(found - expected) <= SAME
    return found == expected


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
    return _part_from(values, SutureSetup(), "setup")


def _part_from(value: object, like: Any, where: str) -> Any:
    """Return a part of a setup from JSON values: of the type of ``like``, named ``where`` in errors."""
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
    parts = {name: _part_from(value[name], getattr(like, name), f"{where}.{name}") for name in names}
    return type(like)(**parts)  # type: ignore[operator]


def _pose(value: object, where: str) -> SE3:
    rows = value if isinstance(value, list) else []
    matrix = np.array([_numbers(row, where) for row in rows if isinstance(row, list) and len(row) == 4])
    if len(rows) != 4 or matrix.shape != (4, 4):
        raise InvalidValue(where, _short(value), "give a pose, four rows of four numbers")
    try:
        return SE3(matrix)
    except InvalidInput:
        remedy = "give a rotation in its first three rows and columns, and 0, 0, 0, 1 below"
        raise InvalidInput(where, "is not a rigid pose", remedy) from None


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
