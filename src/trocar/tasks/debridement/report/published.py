"""Table I of Kehoe et al. 2014: execution time and failure modes, as published."""

from __future__ import annotations

from dataclasses import dataclass, field

from scipy.stats import beta

PARTS = ("perception", "planning", "motion", "waiting")
"""The parts of the time per fragment in Table I."""

MODES = {
    "fragment_false_negatives": "fragment false negative",
    "fragment_false_positives": "fragment false positive",
    "pickup_false_negatives": "pickup false negative",
    "pickup_false_positives": "pickup false positive",
    "grasp_failures": "grasp failure",
    "multiple_grasps": "multiple grasp",
    "pickup_failures": "pickup failure",
    "drops_en_route": "drop en route",
    "dropoff_failures": "dropoff failure",
}
"""The nine failure modes of section III-B: field of a fragment's score, and description."""

TAIL = 0.025


@dataclass(frozen=True)
class Column:
    """One column of Table I.

    Attributes:
        who: the condition.
        fragments: in all trials; all were cleared (VI-A).
        s_per_fragment: average time per fragment.
        shares: of that time, in %, by part.
        replans: average number of replanning steps per fragment; None if nothing was planned.
        failures: rate of each mode that occurred, in %.
    """

    who: str
    fragments: int
    s_per_fragment: float
    shares: dict[str, float] = field(default_factory=dict)
    replans: float | None = None
    failures: dict[str, float] = field(default_factory=dict)

    @property
    def parts_s(self) -> dict[str, float]:
        """Return the time in s per fragment by part; empty where it was not published."""
        return {part: self.s_per_fragment * self.shares[part] / 100.0 for part in PARTS if part in self.shares}

    def rate(self, mode: str) -> float:
        """Return the rate of a failure mode, as a fraction."""
        return self.failures.get(mode, 0.0) / 100.0

    def interval(self, mode: str) -> tuple[float, float]:
        """Return the 95 % interval of that rate (Clopper and Pearson 1934), as if it referred to all fragments.

        The paper gives rates without counts. Those of the robot fit 1 to 4 events in 52 to 58, close enough to the
        number of fragments; fragments are treated as independent.
        """
        return clopper_pearson(self.rate(mode) * self.fragments, self.fragments)


def clopper_pearson(count: float, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate of independent attempts; the count may come from a rounded rate."""
    low = float(beta.ppf(TAIL, count, of - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(1.0 - TAIL, count + 1, of - count)) if count < of else 1.0
    return low, high


PERSON = Column("person, teleoperating", 30, 29.0, failures={"grasp_failures": 5.0})
TABLE_1 = {
    "one-arm": Column(
        "robot, one arm",
        60,
        91.8,
        {"perception": 12.1, "planning": 32.8, "motion": 55.1},
        11.06,
        {"fragment_false_negatives": 1.9, "grasp_failures": 3.5, "multiple_grasps": 5.2},
    ),
    "two-arms": Column(
        "robot, two arms",
        60,
        60.3,
        {"perception": 10.0, "planning": 36.6, "motion": 45.7, "waiting": 7.7},
        10.58,
        {"pickup_false_positives": 3.6, "grasp_failures": 3.6, "multiple_grasps": 7.1, "drops_en_route": 1.8},
    ),
}
"""The robot's columns, by variant of the task."""

SPEEDUP = 1.5
"""The two-arm system was faster than the one-arm system by this factor on average (VI-A)."""
