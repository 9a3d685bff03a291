"""Table I of Kehoe et al. 2014: execution time and failure modes, as published, and ours beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rich import box
from rich.table import Table
from scipy.stats import beta

from trocar.report.tables import figure

PARTS = ("perception", "planning", "motion", "waiting")  # the parts of the time per fragment in Table I

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
    """One column of Table I."""

    who: str  # the condition
    fragments: int  # in all trials; all were cleared (VI-A)
    s_per_fragment: float  # average time per fragment
    shares: dict[str, float] = field(default_factory=dict)  # of that time, in %, by part
    replans: float | None = None  # average per fragment; None if nothing was planned
    failures: dict[str, float] = field(default_factory=dict)  # rate of each mode that occurred, in %

    @property
    def parts_s(self) -> dict[str, float]:
        """Return the time in s per fragment by part; empty where it was not published."""
        return {part: self.s_per_fragment * self.shares[part] / 100.0 for part in PARTS if part in self.shares}

    def rate(self, mode: str) -> float:
        """Return the rate of a failure mode, as a fraction."""
        return self.failures.get(mode, 0.0) / 100.0

    def interval(self, mode: str) -> tuple[float, float]:
        """Return the 95 % interval of that rate (Clopper and Pearson 1934), as if it referred to all fragments.

        The paper gives rates without counts. The robot's rates fit 1 to 4 events out of 52 to 58, close enough to the
        number of fragments. Fragments are treated as independent.
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
        "robot, one arm, 1 cm/s",
        60,
        91.8,
        {"perception": 12.1, "planning": 32.8, "motion": 55.1},
        11.06,
        {"fragment_false_negatives": 1.9, "grasp_failures": 3.5, "multiple_grasps": 5.2},
    ),
    "two-arms": Column(
        "robot, two arms, 1 cm/s",
        60,
        60.3,
        {"perception": 10.0, "planning": 36.6, "motion": 45.7, "waiting": 7.7},
        10.58,
        {"pickup_false_positives": 3.6, "grasp_failures": 3.6, "multiple_grasps": 7.1, "drops_en_route": 1.8},
    ),
}
"""The robot's columns, by variant of the task."""

SPEEDUP = 1.5  # the two-arm system was faster than the one-arm system by this factor on average (VI-A)

HEAD = ("", "person", "paper", "ours", "within")


def lines_of(variant: str, ours: Mapping[str, Any]) -> list[list[str]]:
    """Return the lines of Table I: name, the person's figure, the robot's, ours, and whether our rate agrees."""
    paper, seconds = TABLE_1[variant], ours["s_per_fragment"]
    return [
        ["fragments", str(PERSON.fragments), str(paper.fragments), f"{ours['cleared']} of {ours['fragments']}", ""],
        ["s per fragment", *map(_tenths, (PERSON.s_per_fragment, paper.s_per_fragment)), estimated(seconds, 1), ""],
        *([f"{part}, %", "-", _tenths(paper.shares.get(part)), _share(ours, part), ""] for part in PARTS),
        ["replans per fragment", "-", figure(paper.replans), estimated(ours["replans_per_fragment"], 1), ""],
        *(_failure_line(variant, mode, ours) for mode in MODES),
        ["at the first attempt, %", "", "", rated(ours["first_attempt"]), ""],
        ["contacts a trial", "", "", estimated(ours["contacts_per_trial"], 1), ""],
        ["recoveries", "", "", str(ours["recoveries"]), ""],
    ]


def table_one(variant: str, ours: Mapping[str, Any], title: str) -> Table:
    """Return Table I of one variant, to be printed in 80 columns."""
    table = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, 1, 0, 0),
        title=title,
        caption="ours simulated, 95 % intervals count sessions; paper and person: Table I as published, rates with "
        "Clopper-Pearson intervals of its fragments; within: our rate lies in the paper's",
    )
    for name in HEAD:
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    for line in lines_of(variant, ours):
        table.add_row(*line)
    return table


def estimated(estimate: Mapping[str, Any] | None, digits: int) -> str:
    """Return a figure with its interval; a dash where there is none."""
    if estimate is None:
        return "-"
    text = f"{estimate['mean']:.{digits}f}"
    return text if estimate["low"] is None else f"{text} [{estimate['low']:.{digits}f}, {estimate['high']:.{digits}f}]"


def rated(rate: Mapping[str, Any]) -> str:
    """Return a rate in % with its interval and counts; a dash where nothing was counted."""
    if rate["rate"] is None:
        return "-"
    low, high = rate["ci95"]
    return f"{100 * rate['rate']:.1f} [{100 * low:.0f}, {100 * high:.0f}] {rate['count']}/{rate['of']}"


def within(variant: str, mode: str, ours: Mapping[str, Any]) -> str:
    """Return ``yes`` if our rate of a failure mode lies in the interval of the paper's, else ``below`` or ``above``.

    A dash where nothing was counted.
    """
    rate = ours["failure_modes"][mode]["rate"]
    if rate is None:
        return "-"
    low, high = TABLE_1[variant].interval(mode)
    return "below" if rate < low else "above" if rate > high else "yes"


def _failure_line(variant: str, mode: str, ours: Mapping[str, Any]) -> list[str]:
    paper = TABLE_1[variant]
    low, high = paper.interval(mode)
    return [
        f"{MODES[mode]}, %",
        f"{100 * PERSON.rate(mode):.1f}",
        f"{100 * paper.rate(mode):.1f} [{100 * low:.1f}, {100 * high:.1f}]",
        rated(ours["failure_modes"][mode]),
        within(variant, mode, ours),
    ]


def _tenths(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _share(ours: Mapping[str, Any], part: str) -> str:
    share, seconds = ours["table_parts_share"][part], ours["table_parts_s"][part]
    text = _tenths(None if share is None else 100 * share)
    return text if seconds is None else f"{text} ({seconds:.1f} s)"
