"""Which moments of a trial are worth a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trocar.trials.log import Span

MOST_FAILURES = 3
UNSHOWN = ("lower", "withdraw")
"""Steps of a suture without a picture."""


Notes = Sequence[Mapping[str, Any]]
Moments = Callable[[Notes, Sequence[Span], Notes], list[tuple[str, float]]]


def suture_moments(sutures: Notes, spans: Sequence[Span], events: Notes) -> list[tuple[str, float]]:
    """Return (caption, time in s): the end of each step of the first suture, then of each suture."""
    del spans
    steps = [e for e in events if e["name"] == "step" and e["suture"] == 0]
    ends = [e["time_s"] for e in steps[1:]] + [s["end_s"] for s in sutures[:1]]
    found = [(str(step["step"]), end) for step, end in zip(steps, ends, strict=False) if step["step"] not in UNSHOWN]
    for number, suture in enumerate(sutures, start=1):
        how = suture["failure"].lower().replace("_", " ") or "driven"
        if number > 1 or suture["failure"]:
            found.append((f"suture {number} at {suture['theta_deg']:.0f} deg: {how}", suture["end_s"]))
    return sorted(found, key=lambda item: item[1])


def transfer_moments(transfers: Notes, spans: Sequence[Span], events: Notes) -> list[tuple[str, float]]:
    """Return (caption, time in s): the first transfer step by step, halves of the trial, failures, the end."""
    del events
    found: list[tuple[str, float]] = [("start", 0.0)]
    if transfers:
        found += _first_transfer(transfers[0], spans)
    for number, transfer in enumerate(transfers, start=1):
        if number % 3 == 0:
            found.append((f"{number} transfers done", transfer["end_s"]))
    failed = [t for t in transfers if t["failure"]][:MOST_FAILURES]
    found += [
        (f"peg {t['source']} to {t['target']}: {t['failure'].lower().replace('_', ' ')}", t["end_s"]) for t in failed
    ]
    return sorted(found, key=lambda item: item[1])


def _first_transfer(transfer: Mapping[str, Any], spans: Sequence[Span]) -> list[tuple[str, float]]:
    inside = [s for s in spans if transfer["start_s"] <= s.start_s and s.end_s <= transfer["end_s"]]
    motions = [s for s in inside if s.name == "motion"]
    steps = []
    if motions:
        steps.append((f"jaws round the wall on peg {transfer['source']}", motions[0].end_s))
    if len(motions) > 1 and not transfer["failure"]:
        carry = motions[-1]
        length = carry.end_s - carry.start_s
        steps += [
            ("lifted", carry.start_s + 0.35 * length),
            ("over the target", carry.start_s + 0.65 * length),
        ]
        steps.append((f"released on peg {transfer['target']}", transfer["end_s"]))
    return steps


MOMENTS: dict[str, Moments] = {"peg-transfer": transfer_moments, "suture": suture_moments}
"""Of each task: from its scores, its spans and its events."""
