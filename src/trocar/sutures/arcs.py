"""Closed walks round the circle in the continuum: steps of bounded length between places in allowed arcs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

TURN = 2 * math.pi
ROUNDING = 1e-12
"""Sets are widened by this many rad at every step, so that rounding hides no walk."""

Piece = tuple[float, float]
UNDECIDED = "undecided"


@dataclass(frozen=True)
class ArcWalks:
    """Closed walks of ``steps`` steps over allowed arcs.

    The places that k steps can reach from an arc of starts are computed exactly, as a union of intervals: each is
    stretched by the shortest and the longest step and cut with the allowed arcs. If after all steps none of it lies one
    turn ahead of the starts, no walk from them closes: a proof. If some does, the starts may still differ from the ends
    that they reach; halving the starts decides, down to the width ``finest``.

    Attributes:
        arcs: allowed, disjoint, ascending within [0, 2 pi].
        steps: in a walk.
        least: step, rad.
        most: step, rad.
        through: places that a walk must stand on, ascending in [0, 2 pi).
    """

    arcs: tuple[Piece, ...]
    steps: int
    least: float
    most: float
    through: tuple[float, ...] = ()

    def find(self, finest: float) -> list[float] | str | None:
        """Return a closed walk (steps,), ``UNDECIDED``, or None: there is none."""
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
            low, high = max(start[0], closing[0][0] - TURN), min(start[1], closing[-1][1] - TURN)
            if high - low <= finest:
                return UNDECIDED
            pending += [(low, (low + high) / 2), ((low + high) / 2, high)]
        return None

    def starts(self) -> list[Piece]:
        """Return pieces in one of which every closed walk has a place.

        That is the first place to stand on, or else what is allowed of any arc of the longest step: here the arc,
        from where an allowed arc ends, with the least of it.
        """
        if self.through:
            first = self.through[0]
            return [(first, first)] if cut(self.arcs, [(first - ROUNDING, first + ROUNDING)]) else []
        choices = [cut(self._around, [(end, end + self.most)]) for _, end in self.arcs]
        return min(choices, key=lambda pieces: sum(high - low for low, high in pieces), default=[])

    @cached_property
    def _around(self) -> list[Piece]:
        """Return the allowed arcs of three turns."""
        return merged((low + k * TURN, high + k * TURN) for k in range(3) for low, high in self.arcs)

    @cached_property
    def _stops(self) -> list[float]:
        """Return the places of two turns on which a walk must stand."""
        return [place + k * TURN for k in range(2) for place in self.through]

    def _layers(self, start: Piece) -> list[list[Piece]]:
        """Return what 0, 1, ... all steps reach from the starts."""
        ahead = cut(self._around, [(start[0], start[1] + TURN + ROUNDING)])
        layers = [[start]]
        for _ in range(self.steps):
            layers.append(cut(merged(self._stretched(layers[-1])), ahead))
        return layers

    def _stretched(self, pieces: list[Piece]) -> Iterable[Piece]:
        """Yield where one step leads from pieces, but for the allowed arcs; never past a stop."""
        for begin, end in pieces:
            low = begin
            for stop in self._stops:
                if low < stop <= end:
                    yield low + self.least - ROUNDING, stop
                    low = stop
            past = next((stop for stop in self._stops if stop > low), math.inf)
            yield low + self.least - ROUNDING, min(end + self.most + ROUNDING, past)

    def _walk_from(self, start: float) -> list[float] | None:
        """Return a closed walk from one place, in the middle of what is possible step by step."""
        layers = self._layers((start, start))
        here = start + TURN
        if not cut(layers[-1], [(here - ROUNDING, here + ROUNDING)]):
            return None
        walk = []
        for layer in reversed(layers[:-1]):
            last_stop = max((stop for stop in self._stops if stop < here - ROUNDING), default=-math.inf)
            source = (max(here - self.most - 2 * ROUNDING, last_stop), here - self.least + 2 * ROUNDING)
            pieces = cut(layer, [source])
            if not pieces:
                return None
            low, high = max(pieces, key=lambda piece: piece[1] - piece[0])
            here = (low + high) / 2
            walk.append(here)
        return walk[::-1]


def merged(pieces: Iterable[Piece]) -> list[Piece]:
    """Return the union of pieces, which ascend by their begin, as disjoint ones; empty ones are left out."""
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
