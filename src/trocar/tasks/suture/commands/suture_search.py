"""The planner that a suture command asks for, and its results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.errors import TrocarError
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap

if TYPE_CHECKING:
    from trocar.tasks.suture.demonstrations import Demonstrations
    from trocar.tasks.suture.planning.robust import RobustPlan


@dataclass(frozen=True)
class Search:
    """A planning problem and the planner for it.

    Attributes:
        count: number of sutures.
        spacing: constraints on their positions; None for the paper's even spacing.
        exhaustive: enumerate all evenly spaced plans.
        continuous: plan at any angles, with a proven bound.
        robust: maximise the worst case over balanced errors of joints and circle.
        scenarios: number of random errors, other than those, in which the robust plan is assessed.
        seed: seed of these random errors.
    """

    count: int
    spacing: Spacing | None
    exhaustive: bool = False
    continuous: bool = False
    robust: bool = False
    scenarios: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        options = {"--continuous": self.continuous, "--robust": self.robust, "--exhaustive": self.exhaustive}
        asked = [name for name, on in options.items() if on]
        if len(asked) > 1:
            raise TrocarError(f"{' and '.join(asked)} are different searches; choose one of them")
        if self.exhaustive and self.spacing is not None:
            raise TrocarError(
                "--exhaustive enumerates evenly spaced plans; leave out the constraints on gaps and positions"
            )
        if self.seed < 0:
            raise TrocarError(f"seed {self.seed} is negative; give 0 or more")

    def plan(self, map: DexterityMap, recorded: Demonstrations | None) -> tuple[SuturePlan, RobustPlan | None]:
        """Return the best plan of this map, and its robustness if ``robust``.

        Args:
            map: dexterity of the sutures.
            recorded: demonstrations that its manipulability comes from, if any.
        """
        if self.continuous:
            return self._continuous(map, recorded), None
        if self.robust:
            from trocar.tasks.suture.planning.robust import Scenarios, plan_robust

            robust = plan_robust(map, Scenarios.corners(), self.on_grid)
            return robust.plan, robust
        return self.on_grid(map), None

    def on_grid(self, map: DexterityMap) -> SuturePlan:
        """Return the best plan on the map's grid."""
        from trocar.tasks.suture.planning.even import plan_even, plan_exhaustive
        from trocar.tasks.suture.planning.gaps import plan_gaps

        if self.spacing is not None:
            return plan_gaps(map, self.count, self.spacing)
        return plan_exhaustive(map, self.count) if self.exhaustive else plan_even(map, self.count)

    def sensitivity(self, map: DexterityMap, robust: RobustPlan) -> dict[str, Any]:
        """Return how the robust and the nominal plan perform under random errors, as plain values."""
        from trocar.tasks.suture.planning.robust import Scenarios, sensitivity

        errors = Scenarios.draw(np.random.default_rng(self.seed), self.scenarios)
        return {
            name: sensitivity(map, errors, self.on_grid, plan=plan).summary()
            for name, plan in (("robust", robust.plan), ("nominal", robust.nominal))
        }

    def _continuous(self, map: DexterityMap, recorded: Demonstrations | None) -> SuturePlan:
        """Return the best plan at any angles; if none is feasible, the one on the grid to show what is out of reach."""
        from trocar.tasks.suture.planning.continuous import NoPlan, plan_continuous
        from trocar.tasks.suture.planning.enclosure import interpolated_bounds

        bounds = interpolated_bounds(recorded.places_rad, recorded.at_places) if recorded else None
        try:
            spacing = self.spacing or Spacing.even(self.count)
            return plan_continuous(map, self.count, spacing, manipulability_bounds=bounds)
        except NoPlan as none:
            try:
                shown = self.on_grid(map)
            except TrocarError:  # no plan on the grid meets the spacing, feasible or not
                raise none from None
            feasible = "no feasible plan exists" if none.proven else "no feasible plan was found, though one may exist"
            return replace(shown, certified=f"at any angles {feasible}; on the grid, shown here: {shown.certified}")
