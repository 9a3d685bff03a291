"""Which planner of sutures a command asks for, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.errors import TrocarError
from trocar.sutures.plan import Spacing, SuturePlan
from trocar.sutures.rewards import DexterityMap

if TYPE_CHECKING:
    from trocar.sutures.demonstrations import Demonstrations
    from trocar.sutures.robust import RobustPlan, Scenarios


@dataclass(frozen=True)
class Search:
    """What is searched, and how.

    Attributes:
        count: of sutures.
        spacing: of their places; None for the paper's even spacing.
        exhaustive: enumerate every evenly spaced plan.
        continuous: any angles, with a proven bound.
        robust: over how many random errors the worst case is maximised; None: errors are left out.
        seed: of these errors.
    """

    count: int
    spacing: Spacing | None
    exhaustive: bool = False
    continuous: bool = False
    robust: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        asked = [
            name for name, on in (("--continuous", self.continuous), ("--robust", self.robust is not None)) if on
        ] + ["--exhaustive"] * self.exhaustive
        if len(asked) > 1:
            raise TrocarError(f"{' and '.join(asked)} are different searches; choose one of them")
        if self.exhaustive and self.spacing is not None:
            raise TrocarError("--exhaustive enumerates evenly spaced plans; leave the bounds on gaps and places out")
        if self.seed < 0:
            raise TrocarError(f"seed {self.seed} is negative; give 0 or more")

    def plan(self, map: DexterityMap, recorded: Demonstrations | None) -> tuple[SuturePlan, RobustPlan | None]:
        """Return the best plan of this map, and what it stands where that was asked.

        Args:
            map: what the sutures are worth.
            recorded: the demonstrations that its manipulability comes from, if any.
        """
        if self.continuous:
            return self._continuous(map, recorded), None
        if self.robust is not None:
            from trocar.sutures.robust import plan_robust  # noqa: PLC0415

            robust = plan_robust(map, self._scenarios(), self.on_grid)
            return robust.plan, robust
        return self.on_grid(map), None

    def on_grid(self, map: DexterityMap) -> SuturePlan:
        """Return the best plan on the map's grid."""
        from trocar.sutures.even import plan_even, plan_exhaustive  # noqa: PLC0415
        from trocar.sutures.gaps import plan_gaps  # noqa: PLC0415

        if self.spacing is not None:
            return plan_gaps(map, self.count, self.spacing)
        return plan_exhaustive(map, self.count) if self.exhaustive else plan_even(map, self.count)

    def sensitivity(self, map: DexterityMap) -> dict[str, Any]:
        """Return what becomes, in the same random errors, of the plan made without them, as plain values."""
        from trocar.sutures.robust import sensitivity  # noqa: PLC0415

        return sensitivity(map, self._scenarios(), self.on_grid).summary()

    def _scenarios(self) -> Scenarios:
        """Return the same errors each time."""
        from trocar.sutures.robust import Scenarios  # noqa: PLC0415

        return Scenarios.draw(np.random.default_rng(self.seed), self.robust or 0)

    def _continuous(self, map: DexterityMap, recorded: Demonstrations | None) -> SuturePlan:
        """Return the plan at any angles; if none is found and the circle is partly out of reach, that of the grid."""
        from trocar.sutures.continuous import plan_continuous  # noqa: PLC0415
        from trocar.sutures.enclosure import interpolated_bounds  # noqa: PLC0415

        bounds = interpolated_bounds(recorded.places_rad, recorded.at_places) if recorded else None
        try:
            spacing = self.spacing or Spacing.even(self.count)
            return plan_continuous(map, self.count, spacing, manipulability_bounds=bounds)
        except TrocarError:
            if map.joints.feasible.any(0).all():
                raise
            return self.on_grid(map)
