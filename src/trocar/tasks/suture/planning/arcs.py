"""Closed walks round the circle at real angles: steps of bounded length between places in allowed arcs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from trocar.geometry import TURN

ROUNDING = 1e-12
"""Sets are widened by this many rad at every step, so that rounding cannot rule out a walk."""

Piece = tuple[float, float]
UNDECIDED = "undecided"


@dataclass(frozen=True)
class ArcWalks:
    """Closed walks of ``steps`` steps over allowed arcs.

    The places that k steps can reach from an arc of starts are computed exactly, as a union of intervals: each interval
    is shifted by the shortest to the longest step and intersected with the allowed arcs. If after all steps no such
    place lies one turn ahead of the starts, no walk from them closes: this is a proof. If one does, the end that is
    reached may still belong to another start; bisecting the starts decides, down to the width ``finest_rad``.

    Attributes:
        arcs: allowed, disjoint, ascending within [0, 2 pi].
        steps: in a walk.
        min_step_rad: shortest step.
        max_step_rad: longest step.
        through_rad: places that a walk must visit, ascending in [0, 2 pi).
    """

    arcs: tuple[Piece, ...]
    steps: int
    min_step_rad: float
    max_step_rad: float
    through_rad: tuple[float, ...] = ()

    def find(self, finest_rad: float) -> list[float] | str | None:
        """Return a closed walk (steps,), or ``UNDECIDED``, or None if it is proven that there is none."""
        pending = self.starts()
        while pending:
            start = pending.pop()
            ahead = (start[0] + TURN - ROUNDING, start[1] + TURN + ROUNDING)
            closing = cut(self._layers(start)[-1], [ahead])
            if not closing:
                continue
            for low, high in closing:
                if walk := self._walk_from(min(max((low + high) / 2 - TURN, start[0]), start[1])):
                    return walk
            # Only starts that are themselves reached one turn ahead can close: the others are dropped before bisecting.
            low, high = max(start[0], closing[0][0] - TURN), min(start[1], closing[-1][1] - TURN)
            if high - low <= finest_rad:
                return UNDECIDED
            pending += [(low, (low + high) / 2), ((low + high) / 2, high)]
        return None

    def starts(self) -> list[Piece]:
        """Return pieces such that every closed walk has a place in one of them.

        These are the first place to visit or, without one, the allowed part of any arc as long as the longest step,
        which no walk can jump over: of the arcs that begin where an allowed arc ends, the one with the least allowed.
        """
        if self.through_rad:
            first = self.through_rad[0]
            return [(first, first)] if cut(self.arcs, [(first - ROUNDING, first + ROUNDING)]) else []
        choices = [cut(self._around, [(end, end + self.max_step_rad)]) for _, end in self.arcs]
        return min(choices, key=lambda pieces: sum(high - low for low, high in pieces), default=[])

    @cached_property
    def _around(self) -> list[Piece]:
        """Return the allowed arcs, repeated over three turns."""
        return merged((low + k * TURN, high + k * TURN) for k in range(3) for low, high in self.arcs)

    @cached_property
    def _stops(self) -> list[float]:
        """Return the places that a walk must visit, repeated over two turns."""
        return [place + k * TURN for k in range(2) for place in self.through_rad]

    def _layers(self, start: Piece) -> list[list[Piece]]:
        """Return the places reached from the starts after 0, 1, ... and all steps."""
        ahead = cut(self._around, [(start[0], start[1] + TURN + ROUNDING)])
        layers = [[start]]
        for _ in range(self.steps):
            layers.append(cut(merged(self._one_step(layers[-1])), ahead))
        return layers

    def _one_step(self, pieces: list[Piece]) -> Iterable[Piece]:
        """Yield where one step leads from pieces, whatever arcs are allowed; no step passes a stop."""
        for begin, end in pieces:
            low = begin
            for stop in self._stops:
                # A piece that contains a stop is split there: what lies before the stop may reach it, not pass it.
                if low < stop <= end:
                    yield low + self.min_step_rad - ROUNDING, stop
                    low = stop
            past = next((stop for stop in self._stops if stop > low), math.inf)
            yield low + self.min_step_rad - ROUNDING, min(end + self.max_step_rad + ROUNDING, past)

    def _walk_from(self, start: float) -> list[float] | None:
        """Return a closed walk from one place, or None; it keeps to the middle of the widest choice at each step."""
        layers = self._layers((start, start))
        here = start + TURN
        if not cut(layers[-1], [(here - ROUNDING, here + ROUNDING)]):
            return None
        walk = []
        # Backwards: each layer holds only places that the start reaches, so any of them that leads here is good.
        for layer in reversed(layers[:-1]):
            last_stop = max((stop for stop in self._stops if stop < here - ROUNDING), default=-math.inf)
            source = (max(here - self.max_step_rad - 2 * ROUNDING, last_stop), here - self.min_step_rad + 2 * ROUNDING)
            pieces = cut(layer, [source])
            if not pieces:
                return None
            low, high = max(pieces, key=lambda piece: piece[1] - piece[0])
            here = (low + high) / 2
            walk.append(here)
        return walk[::-1]


def merged(pieces: Iterable[Piece]) -> list[Piece]:
    """Return the union of pieces, which must ascend by their begin, as disjoint pieces; empty ones are dropped."""
    found: list[Piece] = []
    for low, high in pieces:
        if low > high:
            continue
        if found and low <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], high))
        else:
            found.append((low, high))
    return found


def cut(some: Iterable[Piece], others: Iterable[Piece]) -> list[Piece]:
    """Return the intersection of two unions of disjoint, ascending pieces."""
    found, some, others = [], list(some), list(others)
    i = j = 0
    while i < len(some) and j < len(others):
        low, high = max(some[i][0], others[j][0]), min(some[i][1], others[j][1])
        if low <= high:
            found.append((low, high))
        if some[i][1] < others[j][1]:
            i += 1
        else:
            j += 1
    return found
