"""The study of the peg transfer beside Tables II to IV and Figures 9 to 11 of Hwang et al. 2022."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from trocar.eval.comparison import holm, rate_difference, session_difference, session_estimate
from trocar.eval.statistics import session_interval, wilson_interval
from trocar.eval.study import Results, RowKind, TableData, TaskStudy
from trocar.eval.trial import Trial
from trocar.motion.analysis import analyse_joints
from trocar.report.tables import failure_counts, figure, rated
from trocar.tasks.peg_transfer.goals import GOALS
from trocar.tasks.peg_transfer.report import PAPER
from trocar.tasks.peg_transfer.report.study_figures import COLLISIONS, KINDS, draw_motion, draw_paths, draw_performance

TABLES = {"unilateral": "Table II", "bilateral": "Table III", "handover": "Table IV"}
HEAD = ("method", "transfers", "success %", "of available", "transfer s", "path m", "collisions")
MARGIN = 0.05
"""Success rates that differ by less are called similar."""
ALPHA = 0.05
HELD, REJECTED, OPEN = "holds", "does not hold", "undecided"


@dataclass(frozen=True)
class Row:
    """One trial."""

    fingerprint: str  # of its run
    session: int  # number
    index: int  # of the trial in its session
    attempted: int  # transfers that the task set
    available: int  # those of them whose block stood on its source: the paper's denominator
    succeeded: int  # transfers
    duration_s: float  # of the whole trial
    collisions: int  # of arms and blocks with pegs, board and each other
    failures: dict[str, int]  # names with their number
    path_m: float  # length of the tips' paths, all working arms together
    joints: dict[str, float]  # RMS of velocity, acceleration, jerk of the turning joints, rad/s and so on
    tip: dict[str, float]  # RMS of the size of velocity, acceleration, jerk of the tip, m/s and so on
    wall_s: float  # real time of the trial; 0 if it was lost

    @property
    def success_rate(self) -> float:
        """Return the share of the transfers that succeeded."""
        return self.succeeded / self.attempted

    @property
    def transfer_time_s(self) -> float:
        """Return the completion time over the number of transfers, as in the paper's tables."""
        return self.duration_s / self.attempted


def row_of(trial: Trial) -> Row:
    """Return a trial's row; motions are estimated from the measured joints of its working arms."""
    about, scores = trial.about, [score for score in trial.scores if score["attempted"]]
    found = [
        analyse_joints(
            trial.scenery.arms[arm], trial.arrays[f"measured_{arm}"][:, :6].astype(np.float64), trial.scenery.tick_s
        )
        for arm in about["arms"]
    ]
    turning = [~np.array([joint.prismatic for joint in trial.scenery.arms[arm].joints]) for arm in about["arms"]]
    return Row(
        fingerprint=about["fingerprint"],
        session=about["session"],
        index=about["index"],
        attempted=len(scores),
        available=sum(bool(score["available"]) for score in scores),
        succeeded=sum(bool(score["succeeded"]) for score in scores),
        duration_s=trial.duration_s,
        collisions=len(trial.collisions),
        failures=dict(failure_counts(scores)),
        path_m=sum(one.path_m for one in found),
        joints={
            kind: _rms([one.joints.rms()[kind][t] for one, t in zip(found, turning, strict=True)]) for kind in KINDS
        },
        tip={kind: _rms([np.linalg.norm(getattr(one.tip, kind), axis=1) for one in found]) for kind in KINDS},
        wall_s=trial.wall_s,
    )


def _rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


KIND = RowKind(Row, row_of)


def successes(results: Results[Row]) -> tuple[list[int], list[int]]:
    """Return how many transfers succeeded and how many were set, by session."""
    done = results.by_session(lambda row: row.succeeded)
    tried = results.by_session(lambda row: row.attempted)
    return [int(sum(values)) for values in done.values()], [int(sum(values)) for values in tried.values()]


def _by_session(results: Results[Row], value: str) -> dict[int, list[float]]:
    return results.by_session(lambda row: float(getattr(row, value)))


@dataclass(frozen=True)
class Finding:
    """The result of one comparison."""

    hypothesis: str  # H1 to H4
    variant: str  # of the task
    claim: str  # in words
    sessions: int  # that both conditions have
    difference: float  # mean, first minus second
    low: float | None  # end of the interval; None for a single session
    high: float | None  # likewise
    p: float | None  # one-sided and exact, before adjustment; None if the interval decides
    p_adjusted: float | None  # by Holm, over all that were tested in the study
    verdict: str  # whether the claim holds


@dataclass(frozen=True)
class _Claim:
    hypothesis: str
    first: str
    second: str
    what: str
    value: str  # of a row
    less: bool


CLAIMS = (
    _Claim("H1", "calibrated", "uncalibrated", "success rate, of 1", "success_rate", less=False),
    _Claim("H1", "optimized", "uncalibrated", "success rate, of 1", "success_rate", less=False),
    _Claim("H1", "best", "uncalibrated", "success rate, of 1", "success_rate", less=False),
    _Claim("H2", "optimized", "calibrated", "mean transfer time, s", "transfer_time_s", less=True),
    _Claim("H2", "best", "optimized", "mean transfer time, s", "transfer_time_s", less=True),
    _Claim("H3", "calibrated", "uncalibrated", "collisions per trial", "collisions", less=True),
    _Claim("H3", "optimized", "uncalibrated", "collisions per trial", "collisions", less=True),
    _Claim("H4", "optimized", "calibrated", "distance per trial, m", "path_m", less=True),
    _Claim("H4", "best", "optimized", "distance per trial, m", "path_m", less=True),
)
"""The expected differences; the paper's "optimised" is our ``optimized``. Claims about methods that a study lacks are
left out."""
SIMILAR = (("optimized", "calibrated"), ("best", "optimized"))
"""H1: pairs whose success rates are expected to be similar."""
NOTES = (
    "H1 to H4 are tested between simulated methods only; for people the paper publishes means but no raw data, so they "
    "are shown beside ours and nothing is tested against them",
    "differences: the same sessions and scenes in both conditions, one difference per session; p-values count sign "
    "patterns of the sessions (exact up to 14 sessions), one-sided, adjusted by Holm over the study; intervals are "
    "Student's t over sessions",
    f"similar: the 90 % interval of the difference of rates (beta-binomial over sessions) lies within "
    f"{100 * MARGIN:.0f} points (two one-sided tests)",
)


def findings(results: Sequence[Results[Row]]) -> list[Finding]:
    """Return the study's findings on H1 to H4, variant by variant."""
    found: list[tuple[Finding, bool]] = []
    by_variant: dict[str, dict[str, Results[Row]]] = {}
    for result in results:
        by_variant.setdefault(result.condition.name, {})[result.condition.method] = result
    for variant, methods in by_variant.items():
        for first, second in SIMILAR:
            if first in methods and second in methods:
                found.append((_similar(variant, methods[first], methods[second]), False))
        for claim in CLAIMS:
            if claim.first in methods and claim.second in methods:
                found.append((_tested(variant, claim, methods), claim.less))
    found.sort(key=lambda one: one[0].hypothesis)
    adjusted = iter(holm([finding.p for finding, _ in found if finding.p is not None]))
    return [one if one.p is None else _judged(one, next(adjusted), claims_less) for one, claims_less in found]


def _similar(variant: str, first: Results[Row], second: Results[Row]) -> Finding:
    one, two = successes(first), successes(second)
    low, high = rate_difference(one, two, 1.0 - 2.0 * ALPHA)
    rates = [sum(done) / sum(tried) for done, tried in (one, two)]
    apart = low > MARGIN or high < -MARGIN
    verdict = HELD if low > -MARGIN and high < MARGIN else REJECTED if apart else OPEN
    claim = f"{first.condition.method} as successful as {second.condition.method} within {100 * MARGIN:.0f} points"
    sessions = min(len(one[0]), len(two[0]))
    return Finding("H1", variant, claim, sessions, rates[0] - rates[1], low, high, None, None, verdict)


def _tested(variant: str, claim: _Claim, methods: Mapping[str, Results[Row]]) -> Finding:
    first, second = methods[claim.first], methods[claim.second]
    d = session_difference(*(_by_session(one, claim.value) for one in (first, second)), less=claim.less)
    words = f"{claim.first} {'below' if claim.less else 'above'} {claim.second}: {claim.what}"
    return Finding(claim.hypothesis, variant, words, d.sessions, d.mean, d.low, d.high, d.p, None, OPEN)


def _judged(finding: Finding, p_adjusted: float, claims_less: bool) -> Finding:
    """Return a tested finding with Holm's p-value and its verdict."""
    low, high = finding.low, finding.high
    against = low is not None and high is not None and (low > 0 if claims_less else high < 0)
    verdict = HELD if p_adjusted < ALPHA else REJECTED if against else OPEN
    return replace(finding, p_adjusted=p_adjusted, verdict=verdict)


class PegStudy(TaskStudy[Row]):
    """Every method on every variant."""

    varied = "variant"
    values = tuple(GOALS)
    kind = KIND
    notes = NOTES
    captions: ClassVar = {
        "paths.png": "Paths of the tips over the board, first trial of each condition (like Fig. 9 of the paper)",
        "performance.png": "Success, distance, collisions, completion time (like Fig. 10); people as published",
        "motion.png": "Velocity, acceleration, jerk from the measured joints (like Fig. 11)",
    }

    def figures(self, results: Results[Row]) -> dict[str, Any]:
        """Return the figures of a condition."""
        rows, (done, tried) = results.rows, successes(results)
        failures = sum((Counter(row.failures) for row in rows), Counter[str]())
        return {
            "attempted": sum(tried),
            "available": sum(row.available for row in rows),
            "succeeded": sum(done),
            "success_rate": sum(done) / sum(tried),
            "success_ci95": list(session_interval(done, tried)),
            "mean_time_s": _estimate(results, "transfer_time_s"),
            "completion_time_s": _estimate(results, "duration_s"),
            "path_m": _estimate(results, "path_m"),
            "collisions_per_trial": _estimate(results, "collisions"),
            "failures": dict(failures),
            "joints_rms": _means([row.joints for row in rows]),
            "tip_rms": _means([row.tip for row in rows]),
            "wall_s_per_trial": float(np.mean([row.wall_s for row in rows])),
        }

    def summary(self, results: Sequence[Results[Row]], cells: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the number of transfers, and what was found on H1 to H4."""
        found = [asdict(finding) for finding in findings(results)]
        return {"transfers": sum(cell["attempted"] for cell in cells), "hypotheses": found}

    def about(self, summary: Mapping[str, Any]) -> str:
        """Return a line below the title."""
        return (
            f"Simulated, {summary['transfers']} transfers in {summary['trials']} trials. The paper's rows (Hwang et "
            "al. 2022) are as published."
        )

    def tables(self, summary: Mapping[str, Any]) -> list[TableData]:
        """Return a table for each variant, and that of the hypotheses."""
        found = summary["hypotheses"]
        lines = [
            (
                one["hypothesis"],
                one["variant"],
                one["claim"],
                f"{one['difference']:.3g}" + ("" if one["low"] is None else f" [{one['low']:.3g}, {one['high']:.3g}]"),
                "-" if one["p_adjusted"] is None else f"{one['p_adjusted']:.2g}",
                one["verdict"],
            )
            for one in found
        ]
        head = ("", "variant", "claim", "difference", "p, Holm", "verdict")
        variants = dict.fromkeys(cell["variant"] for cell in summary["cells"])
        tables = [_variant_table(variant, summary["cells"]) for variant in variants]
        return tables + ([TableData("H1 to H4 between our conditions", head, lines)] if found else [])

    def pictures(self, folder: Path, results: Sequence[Results[Row]], summary: Mapping[str, Any]) -> list[Path]:
        """Draw figures like Figs. 9 to 11."""
        return [
            draw_performance(results, summary["cells"], folder / "performance.png"),
            draw_motion(results, folder / "motion.png"),
            draw_paths(results, folder / "paths.png"),
        ]


def _variant_table(variant: str, cells: Sequence[Mapping[str, Any]]) -> TableData:
    """Return our conditions of a variant, then the paper's rows as published."""
    ours = [cell for cell in cells if cell["variant"] == variant]
    lines = [
        (
            cell["method"],
            f"{cell['succeeded']} of {cell['attempted']}",
            rated(cell["success_rate"], cell["success_ci95"]),
            f"{cell['succeeded']} of {cell['available']}",
            *(_with_interval(cell[key]) for key in ("mean_time_s", "path_m", "collisions_per_trial")),
        )
        for cell in ours
    ]
    for row in PAPER.get(variant, ()):
        median = COLLISIONS.get(row.who)
        lines.append(
            (
                f"paper: {row.who}",
                f"{row.succeeded} of {row.attempted}",
                rated(row.succeeded / row.attempted, wilson_interval(row.succeeded, row.attempted)),
                "",
                figure(row.mean_time_s),
                "",
                "" if median is None else f"median {median}",
            )
        )
    title = f"{TABLES.get(variant, '')} {variant}: {ours[0]['trials']} trials in {ours[0]['sessions']} sessions each"
    caption = (
        "simulated; the paper's rows as published. 95 % intervals count sessions; those of the paper's rows count "
        "attempts. A trial that fails early is short: times of methods that fail are not comparable"
    )
    return TableData(title.strip(), HEAD, lines, caption, page_only=("of available",))


def _with_interval(estimate: Mapping[str, Any]) -> str:
    """Return a mean with half the width of its interval."""
    if estimate["low"] is None:
        return figure(estimate["mean"])
    return f"{estimate['mean']:.2f} ± {(estimate['high'] - estimate['low']) / 2:.2f}"


def _estimate(results: Results[Row], value: str) -> dict[str, Any]:
    values = [float(getattr(row, value)) for row in results.rows]
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else None
    over_sessions = asdict(session_estimate(_by_session(results, value)))
    return {**over_sessions, "sd": sd, "median": float(np.median(values))}


def _means(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {kind: float(np.mean([row[kind] for row in rows])) for kind in rows[0]}
