"""What an arm's time was spent on, counting every moment once, however spans overlap."""

from __future__ import annotations

from collections.abc import Sequence

from trocar.log import Span

OTHER = "other"
"""Name of the time in which a script noted nothing."""


def parts_of(spans: Sequence[Span], arm: str, duration_s: float) -> dict[str, float]:
    """Return the time in s that one arm spent on each part; they add up to the duration.

    Where spans of the arm overlap, such as when jaws open during a motion, the moment counts for the one that began
    first (of those that began together, the longest).

    Args:
        spans: of all arms.
        arm: the arm.
        duration_s: of the trial.
    """
    mine = sorted(
        (max(0.0, s.start_s), -min(s.end_s, duration_s), s.name) for s in spans if s.arm == arm and s.end_s > s.start_s
    )
    parts: dict[str, float] = {}
    counted_s = 0.0
    for start_s, minus_end_s, name in mine:
        seconds = -minus_end_s - max(start_s, counted_s)
        if seconds > 0:
            parts[name] = parts.get(name, 0.0) + seconds
            counted_s = -minus_end_s
    parts[OTHER] = max(0.0, duration_s - sum(parts.values()))  # sums of floats leave -1e-15 s
    return parts
