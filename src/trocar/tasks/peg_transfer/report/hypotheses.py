"""H1 to H4 of the paper (section V-C), tested between our own conditions; people only beside them, as published."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from trocar.eval.comparison import Difference, holm, rate_difference, session_difference
from trocar.eval.study import Results
from trocar.tasks.peg_transfer.report.trial_row import Row, successes, transfer_time_s

MARGIN = 0.05
"""Success rates that differ by less are called similar."""
ALPHA = 0.05

HELD, REJECTED, OPEN = "holds", "does not hold", "undecided"


@dataclass(frozen=True)
class Finding:
    """The result of one comparison.

    Attributes:
        hypothesis: H1 to H4.
        variant: of the task.
        claim: in words.
        sessions: that both conditions have.
        difference: mean, first minus second.
        low: end of the interval; None for a single session.
        high: likewise.
        p: one-sided and exact, before adjustment; None if the interval decides.
        p_adjusted: by Holm, over all that were tested in the study.
        verdict: whether the claim holds.
    """

    hypothesis: str
    variant: str
    claim: str
    sessions: int
    difference: float
    low: float | None
    high: float | None
    p: float | None
    p_adjusted: float | None
    verdict: str


@dataclass(frozen=True)
class _Claim:
    hypothesis: str
    first: str
    second: str
    what: str
    value: Callable[[Row], float]
    less: bool


CLAIMS = (
    *(
        _Claim(
            "H1", method, "uncalibrated", "success rate, of 1", lambda row: row.succeeded / row.attempted, less=False
        )
        for method in ("calibrated", "optimized", "best")
    ),
    _Claim("H2", "optimized", "calibrated", "mean transfer time, s", transfer_time_s, less=True),
    _Claim("H2", "best", "optimized", "mean transfer time, s", transfer_time_s, less=True),
    _Claim("H3", "calibrated", "uncalibrated", "collisions per trial", lambda row: float(row.collisions), less=True),
    _Claim("H3", "optimized", "uncalibrated", "collisions per trial", lambda row: float(row.collisions), less=True),
    _Claim("H4", "optimized", "calibrated", "distance per trial, m", lambda row: row.path_m, less=True),
    _Claim("H4", "best", "optimized", "distance per trial, m", lambda row: row.path_m, less=True),
)
"""What is expected; the paper's "optimised" is our ``optimized``. If a study lacks a method, its claims are left
out."""

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
    found: list[Finding] = []
    by_variant: dict[str, dict[str, Results[Row]]] = {}
    for result in results:
        by_variant.setdefault(result.condition.name, {})[result.condition.method] = result
    for variant, methods in by_variant.items():
        found += [_similar(variant, methods[a], methods[b]) for a, b in SIMILAR if a in methods and b in methods]
        found += [
            _tested(variant, claim, methods) for claim in CLAIMS if claim.first in methods and claim.second in methods
        ]
    return _adjusted(sorted(found, key=lambda finding: finding.hypothesis))


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
    d: Difference = session_difference(first.by_session(claim.value), second.by_session(claim.value), less=claim.less)
    words = f"{claim.first} {'below' if claim.less else 'above'} {claim.second}: {claim.what}"
    return Finding(claim.hypothesis, variant, words, d.sessions, d.mean, d.low, d.high, d.p, None, OPEN)


def _adjusted(found: Sequence[Finding]) -> list[Finding]:
    """Return the findings with Holm's p-values and their verdicts."""
    tested = [place for place, finding in enumerate(found) if finding.p is not None]
    adjusted = dict(zip(tested, holm([float(found[place].p or 0.0) for place in tested]), strict=True))
    done = []
    for place, finding in enumerate(found):
        if place not in adjusted:
            done.append(finding)
            continue
        p = adjusted[place]
        below = " below " in finding.claim
        against = (
            finding.low is not None and finding.high is not None and (finding.low > 0 if below else finding.high < 0)
        )
        done.append(replace(finding, p_adjusted=p, verdict=HELD if p < ALPHA else REJECTED if against else OPEN))
    return done
