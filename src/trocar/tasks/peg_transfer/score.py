"""The outcome of each transfer, from what really happened. No agent may import this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.eval import Score, agent_explanation
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.truth import PegTruth

REST_S = 0.3
"""A released block is judged after this time, in which it may fall."""
RETREAT_M = 0.020
"""It is judged again once no tip is this close to it any more: the jaws have gone without dragging it along."""
FLICKER_S = 0.25
"""A block that is off its peg for less than this has not left it, since closing jaws may lift it for a moment."""


@dataclass(frozen=True)
class TransferScore(Score):
    """One transfer as the referee saw it.

    Attributes:
        source: peg.
        target: peg.
        available: a block stood on the source, free to be moved: the paper's denominator counts only these.
    """

    source: int
    target: int
    available: bool


@dataclass(frozen=True)
class Stay:
    """A stay of a block on a peg.

    Attributes:
        block: which block.
        peg: which peg.
        first: first row of the truth at which it is there.
        last: last row at which it is there.
    """

    block: int
    peg: int
    first: int
    last: int


def score_transfers(
    goals: Sequence[Transfer], truth: PegTruth, events: Sequence[Mapping[str, Any]], handover: bool = False
) -> list[TransferScore]:
    """Return one score for each goal.

    A transfer has succeeded if a block went from the source straight to the target, by whatever means, stood there
    after it was released, and still stood there when the jaws had gone.

    Args:
        goals: in order.
        truth: what happened.
        events: what the script noted.
        handover: whether the block must also have been in the jaws of two arms on its way.
    """
    stays = [stays_of(truth, block) for block in range(truth.held.shape[1])]
    used: set[tuple[int, int]] = set()
    return [_score(goal, stays, used, truth, events, handover) for goal in goals]


def stays_of(truth: PegTruth, block: int) -> list[Stay]:
    """Return the stays of one block in order; a flicker does not end one."""
    peg = truth.pegs()[:, block]
    edges = np.flatnonzero(np.diff(peg)) + 1
    runs = [(int(rows[0]), int(rows[-1])) for rows in np.split(np.arange(len(peg)), edges)]
    found: list[Stay] = []
    for first, last in runs:
        if peg[first] < 0:
            continue
        before = found[-1] if found else None
        brief = before is not None and truth.times_s[first] - truth.times_s[before.last] < FLICKER_S
        if before is not None and before.peg == peg[first] and brief:
            found[-1] = Stay(block, before.peg, before.first, last)
        else:
            found.append(Stay(block, int(peg[first]), first, last))
    return found


def _score(
    goal: Transfer,
    stays: Sequence[Sequence[Stay]],
    used: set[tuple[int, int]],
    truth: PegTruth,
    events: Sequence[Mapping[str, Any]],
    handover: bool,
) -> TransferScore:
    moves = [
        (block, number, before, after)
        for block, of_block in enumerate(stays)
        for number, (before, after) in enumerate(pairwise(of_block))
        if (before.peg, after.peg) == goal and (block, number) not in used
    ]
    moves.sort(key=lambda move: move[3].first)
    placed = [move for move in moves if _stays_placed(move[3], truth)]
    done = next((move for move in placed if not handover or _handed_over(move[2], move[3], truth)), None)
    at_source = [stay for of_block in stays for stay in of_block if stay.peg == goal.source]
    noted = next((e for e in reversed(events) if _is_of(e, goal)), None)
    end = float(truth.times_s[-1])
    if done is not None:
        used.add(done[:2])
        start_s, end_s = float(truth.times_s[done[2].last]), float(truth.times_s[done[3].first])
    else:
        start_s = end_s = end
    if noted is not None:
        end_s = float(noted["time_s"])
        start_s = float(noted.get("start_s", min(start_s, end_s)))
    failure, reason = ("", "") if done else _why(noted, moves, placed, at_source, truth, events)
    return TransferScore(True, done is not None, failure, reason, start_s, end_s, *goal, bool(at_source))


def _is_of(event: Mapping[str, Any], goal: Transfer) -> bool:
    return event["name"] == "transfer" and (event.get("source"), event.get("target")) == goal


def _stays_placed(stay: Stay, truth: PegTruth) -> bool:
    """Return whether a block was released on a peg, and still stood there after resting and the jaws' retreat."""
    free = np.flatnonzero(~truth.held[stay.first :, stay.block])
    if not len(free):
        return False
    released = stay.first + int(free[0])
    rested = int(np.searchsorted(truth.times_s, truth.times_s[released] + REST_S - 1e-9))
    judged = max(rested, _retreated(stay.block, released, truth))
    return stay.last >= min(judged, len(truth.times_s) - 1)


def _handed_over(before: Stay, after: Stay, truth: PegTruth) -> bool:
    """Return whether two arms held a block on its way, one after the other or together."""
    way = slice(before.last, after.first + 1)
    return sum(bool(held[way, before.block].any()) for held in truth.held_by.values()) >= 2


def _retreated(block: int, released: int, truth: PegTruth) -> int:
    """Return the first row from a release on at which every tip is away from the block."""
    tips = np.stack([tip[released:] for tip in truth.p_board_tips.values()])
    away = np.linalg.norm(tips - truth.T_board_blocks.matrix[released:, block, :3, 3], axis=-1).min(axis=0)
    return released + _first(away > RETREAT_M)


def _first(rows: NDArray[np.bool_]) -> int:
    """Return the index of the first true row; of the last if none is true."""
    return int(np.argmax(rows)) if rows.any() else len(rows) - 1


def _why(
    noted: Mapping[str, Any] | None,
    moves: Sequence[Any],
    placed: Sequence[Any],
    at_source: Sequence[Stay],
    truth: PegTruth,
    events: Sequence[Mapping[str, Any]],
) -> tuple[str, str]:
    """Return the name of the failure, and a sentence: the script's own if it gave one, else from the truth."""
    said = agent_explanation(noted, events)
    if said is not None:
        return said
    if not at_source:
        return TransferOutcome.NO_BLOCK.name, "no block ever stood on the source"
    if placed:
        return TransferOutcome.NOT_HANDED_OVER.name, "the block reached its target in the jaws of one arm alone"
    if moves:
        return TransferOutcome.NOT_PLACED.name, "the block reached its target and did not stay there"
    last = len(truth.times_s) - 1
    if any(stay.last >= last for stay in at_source):
        return TransferOutcome.NOT_MOVED.name, "the block still stood on its source at the end"
    return TransferOutcome.NOT_PLACED.name, "the block left its source and never stood on its target"
