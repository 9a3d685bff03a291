"""What really happened in a peg transfer, and which transfers count: simulator truth. No agent may import this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.eval import Score, agent_explanation
from trocar.geometry import SE3
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

ENGAGED_M = 8e-3
"""A block is on a peg if the peg is in the block's hole and the block's lower face is this low over the plate."""
UPRIGHT_RAD = np.radians(10.0)
REST_S = 0.3
"""A released block is judged only after this time, in which it may still fall."""
RETREAT_M = 0.020
"""A released block is judged only once all tips are further away than this: leaving jaws may drag it along."""
FLICKER_S = 0.25
"""A block that is off its peg for less than this has not left it, since closing jaws may lift it for a moment."""


@dataclass(frozen=True, eq=False)
class PegTruth:
    """The true poses of everything.

    Attributes:
        times_s: (n,) trial clock.
        T_board_blocks: poses (n, k) in the board's frame.
        pegs: (n, k) the peg round which each block stands upright, as ``pegs_under`` returns it; -1 if there is none.
        held_by: (n, k) whether both fingers of an arm touch the block, by the arm's name.
        p_board_tips: (n, 3) true tip of each arm in the board's frame, m, by name.
        board: the pegboard's shape.
        block: the blocks' shape.
    """

    times_s: NDArray[np.float64]
    T_board_blocks: SE3
    pegs: NDArray[np.intp]
    held_by: Mapping[str, NDArray[np.bool_]]
    p_board_tips: Mapping[str, NDArray[np.float64]]
    board: Pegboard
    block: Block

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Return when each block was held by any arm (n, k)."""
        return np.any(list(self.held_by.values()), axis=0)


def pegs_under(T_board_blocks: SE3, board: Pegboard, block: Block) -> NDArray[np.intp]:
    """Return the peg inside the hole of a standing block, for each pose (...,); -1 if there is none."""
    poses = T_board_blocks.matrix
    height = poses[..., 2, 3] - block.height_m
    standing = (-poses[..., 2, 2] > np.cos(UPRIGHT_RAD)) & (height < ENGAGED_M)
    middles = board.pegs_m + [0.0, 0.0, board.peg_height_m / 2]
    away = np.linalg.norm(poses[..., None, :2, 3] - middles[:, :2], axis=-1)
    nearest = away.argmin(axis=-1)
    offset = T_board_blocks.inverse().apply(middles[nearest])
    radius = np.hypot(offset[..., 0], offset[..., 1])
    inside = radius < block.hole_radius_m(np.arctan2(offset[..., 1], offset[..., 0]))
    return np.where(standing & inside, nearest, -1)


@dataclass(frozen=True)
class TransferScore(Score):
    """One transfer as the referee saw it.

    Attributes:
        source: peg.
        target: peg.
        available: whether a block ever stood on the source; the paper's denominator counts only these transfers.
    """

    source: int
    target: int
    available: bool


@dataclass(frozen=True)
class Stay:
    """A stay of a block on a peg, from the first to the last row of the truth at which the block is there."""

    block: int
    peg: int
    first: int
    last: int


def score_transfers(
    goals: Sequence[Transfer], truth: PegTruth, events: Sequence[Mapping[str, Any]], handover: bool = False
) -> list[TransferScore]:
    """Return one score for each goal, in order.

    A transfer succeeds if a block went directly from the source to the target, by whatever means, and still stood there
    after its release, once the jaws had gone. With ``handover``, it must also have been in the jaws of two arms on its
    way. The script's ``events`` give only times and explanations of failures.
    """
    stays = [stays_of(truth, block) for block in range(truth.held.shape[1])]
    used: set[Stay] = set()
    scores: list[TransferScore] = []
    for goal in goals:
        moves = [pair for of_block in stays for pair in pairwise(of_block) if (pair[0].peg, pair[1].peg) == goal]
        moves = sorted((pair for pair in moves if pair[1] not in used), key=lambda pair: pair[1].first)
        placed = [(before, after) for before, after in moves if _stays_placed(after, truth)]
        done = next((pair for pair in placed if not handover or _handed_over(*pair, truth)), None)
        at_source = [stay for of_block in stays for stay in of_block if stay.peg == goal.source]
        noted = next((event for event in reversed(events) if _is_of(event, goal)), None)
        start_s = end_s = float(truth.times_s[-1])
        if done is not None:
            before, after = done
            used.add(after)
            start_s, end_s = float(truth.times_s[before.last]), float(truth.times_s[after.first])
        if noted is not None:
            end_s = float(noted["time_s"])
            start_s = float(noted.get("start_s", min(start_s, end_s)))
        failure, reason = "", ""
        if done is None:
            failure, reason = agent_explanation(noted, events) or _why(bool(moves), bool(placed), at_source, truth)
        scores.append(TransferScore(True, done is not None, failure, reason, start_s, end_s, *goal, bool(at_source)))
    return scores


def told_transfers(goals: Sequence[Transfer], events: Sequence[Mapping[str, Any]]) -> list[TransferScore]:
    """Return one score for each goal, in order, from the script's notes alone: on real arms there is no referee."""
    scores: list[TransferScore] = []
    end_s = max((float(event["time_s"]) for event in events), default=0.0)
    for goal in goals:
        noted = next((event for event in reversed(events) if _is_of(event, goal)), None)
        if noted is None:
            failure, reason = agent_explanation(None, events) or (TransferOutcome.NOT_MOVED.name, "nothing was noted")
            scores.append(TransferScore(True, False, failure, reason, end_s, end_s, *goal, available=True))
            continue
        done = noted.get("outcome") == TransferOutcome.DONE.name
        failure, reason = ("", "") if done else agent_explanation(noted, events) or ("", "")
        times = float(noted.get("start_s", noted["time_s"])), float(noted["time_s"])
        seen = failure != TransferOutcome.NO_BLOCK.name
        scores.append(TransferScore(True, done, failure, reason, *times, *goal, available=seen))
    return scores


def stays_of(truth: PegTruth, block: int) -> list[Stay]:
    """Return the stays of one block in order; an absence shorter than ``FLICKER_S`` does not end a stay."""
    peg = truth.pegs[:, block]
    edges = np.flatnonzero(np.diff(peg)) + 1
    found: list[Stay] = []
    for rows in np.split(np.arange(len(peg)), edges):
        stay = Stay(block, int(peg[rows[0]]), int(rows[0]), int(rows[-1]))
        if stay.peg < 0:
            continue
        before = found[-1] if found else None
        brief = before is not None and truth.times_s[stay.first] - truth.times_s[before.last] < FLICKER_S
        if before is not None and before.peg == stay.peg and brief:
            found[-1] = Stay(block, stay.peg, before.first, stay.last)
        else:
            found.append(stay)
    return found


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


def _retreated(block: int, released: int, truth: PegTruth) -> int:
    """Return the first row after a release at which all tips are away from the block, or else the last row."""
    tips = np.stack([tip[released:] for tip in truth.p_board_tips.values()])
    off_m = np.linalg.norm(tips - truth.T_board_blocks.matrix[released:, block, :3, 3], axis=-1).min(axis=0)
    away = off_m > RETREAT_M
    return released + (int(np.argmax(away)) if away.any() else len(away) - 1)


def _handed_over(before: Stay, after: Stay, truth: PegTruth) -> bool:
    """Return whether the last arm to hold a block on its way is not the first one: a mere touch is no handover."""
    way = slice(before.last, after.first + 1)
    rows = {arm: np.flatnonzero(held[way, before.block]) for arm, held in truth.held_by.items()}
    rows = {arm: held for arm, held in rows.items() if len(held)}
    return len(rows) >= 2 and min(rows, key=lambda arm: rows[arm][0]) != max(rows, key=lambda arm: rows[arm][-1])


def _why(moved: bool, placed: bool, at_source: Sequence[Stay], truth: PegTruth) -> tuple[str, str]:
    """Return the name of a failure that the script does not explain, and a sentence."""
    if not at_source:
        return TransferOutcome.NO_BLOCK.name, "no block ever stood on the source"
    if placed:
        return TransferOutcome.NOT_HANDED_OVER.name, "the block reached its target in the jaws of one arm alone"
    if moved:
        return TransferOutcome.NOT_PLACED.name, "the block reached its target and did not stay there"
    if any(stay.last >= len(truth.times_s) - 1 for stay in at_source):
        return TransferOutcome.NOT_MOVED.name, "the block still stood on its source at the end"
    return TransferOutcome.NOT_PLACED.name, "the block left its source and never stood on its target"
