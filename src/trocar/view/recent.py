"""What a live page has shown in the last seconds: the path of a tip, the joints."""

from __future__ import annotations

from collections import deque
from typing import TypeVar

APART_S = 0.025
"""Least time between two entries; at real time, moments are further apart."""

What = TypeVar("What")
Recent = deque[tuple[float, What]]
"""What was shown, with its time in s on the cell's clock."""


def add_recent(recent: Recent[What], time_s: float, what: What, kept_s: float) -> None:
    """Add what is shown at a time, and remove what is more than ``kept_s`` older, except for the last two.

    The newest entry is replaced while it is less than ``APART_S`` after the one before: the clock stands, or is slow.
    """
    if len(recent) > 1 and recent[-1][0] - recent[-2][0] < APART_S:
        recent.pop()
    recent.append((time_s, what))
    while len(recent) > 2 and recent[0][0] < time_s - kept_s:
        recent.popleft()
