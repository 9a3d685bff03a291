"""The outcome of each suture, from where needle and jaws really were: simulator truth. No agent may import this."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.eval import Score, agent_explanation
from trocar.geometry import SE3
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import Suture

ON_TARGET_M = 1.0e-3
"""Allowed error of entry and exit (assumed; FLS penalises sutures that miss their dots by the millimetre)."""
TOUCH_M = 0.5e-3
"""The tip has gone in once it is deeper than this."""
SLIP_M, SLIP_RAD = 0.5e-3, math.radians(10.0)
"""A needle that moves more than this in closed jaws has slipped (assumed)."""
SETTLED_S = 0.25
"""Closing jaws turn and centre the needle for this long; movement after that is slip."""
FLICKER_S = 0.05
"""Fingers that press too little for no longer than this have not released the needle."""
MEANT_M = 0.010
"""A needle that goes in within this distance of a planned entry was meant for it."""


@dataclass(frozen=True, eq=False)
class NeedleTruth:
    """Where the needle and the arm that drives it really were.

    Attributes:
        times_s: (n,) trial clock.
        T_circle_needle: (n,) poses in the circle's frame.
        T_circle_tip: (n,) poses of the arm's true tip in the circle's frame.
        gripped: (n,) whether both fingers of the arm press on the needle, and no other arm's do.
        in_hand: (n,) whether the needle is held ready for this arm: by a person, or, outside of the tissue, by a
            second arm or a stand.
        p_needle_tip_m: (3,) the needle's tip in its own frame.
        by_two_arms: whether a second arm has to pull the needle through.
    """

    times_s: NDArray[np.float64]
    T_circle_needle: SE3
    T_circle_tip: SE3
    gripped: NDArray[np.bool_]
    in_hand: NDArray[np.bool_]
    p_needle_tip_m: NDArray[np.float64]
    by_two_arms: bool = False

    @property
    def p_circle_needle_tip_m(self) -> NDArray[np.float64]:
        """Return the needle's tip (n, 3) in the circle's frame."""
        return self.T_circle_needle.apply(self.p_needle_tip_m)


@dataclass(frozen=True)
class SutureScore(Score):
    """One suture as the referee saw it; lengths in m.

    Attributes:
        theta_deg: where on the circle.
        direction: 1 clockwise, -1 counterclockwise.
        entry_error_m: distance from the planned to the true point of entry; None if the needle never went in.
        exit_error_m: likewise of the exit.
        tip_rms_m: RMS distance of the needle's tip from its planned path while it was driven; None if it was not.
        tip_max_m: the largest such distance.
        slip_m: largest movement of the grasped point in closed jaws.
        slip_rad: largest rotation of the needle in closed jaws.
        driven_s: first and last time at which the needle was driven; None if it was not.
    """

    theta_deg: float
    direction: int
    entry_error_m: float | None
    exit_error_m: float | None
    tip_rms_m: float | None
    tip_max_m: float | None
    slip_m: float
    slip_rad: float
    driven_s: tuple[float, float] | None


@dataclass(frozen=True)
class Loading:
    """One use of the needle, from one time that it is held ready to the next, as rows of the truth.

    Attributes:
        first: first row in which the needle is no longer held ready.
        last: row before the needle is held ready again, or the last row of all.
        entry: row before the tip goes in; None if it never does.
        exit: row before the tip comes out again; None if it does not.
    """

    first: int
    last: int
    entry: int | None
    exit: int | None


def score_sutures(
    sutures: Sequence[Suture], truth: NeedleTruth, events: Sequence[Mapping[str, Any]]
) -> list[SutureScore]:
    """Return one score for each planned suture; of several attempts near its entry, the last one counts."""
    tips = truth.p_circle_needle_tip_m
    loadings = loadings_of(truth, tips)
    meant = {number: loading for loading in loadings if (number := _nearest(sutures, tips, loading)) is not None}
    return [_score(k, suture, meant.get(k), truth, tips, events) for k, suture in enumerate(sutures)]


def loadings_of(truth: NeedleTruth, tips_m: NDArray[np.float64]) -> list[Loading]:
    """Return the uses of the needle, separated by the times at which it was held ready."""
    free = np.flatnonzero(~truth.in_hand)
    if not len(free):
        return []
    runs = np.split(free, np.flatnonzero(np.diff(free) > 1) + 1)
    found = []
    for run in runs:
        entry, exit_ = crossings(tips_m[run])
        at = [None if row is None else int(run[0]) + row for row in (entry, exit_)]
        found.append(Loading(int(run[0]), int(run[-1]), *at))
    return found


def crossings(tips_m: NDArray[np.float64]) -> tuple[int | None, int | None]:
    """Return the rows before the tip's path (n, 3) first goes below z = 0, and before it comes up again.

    A dip shallower than ``TOUCH_M`` is not an entry: between two steps the tip may rest on the surface and tremble.
    """
    below = tips_m[:, 2] < 0.0
    down = np.flatnonzero(~below[:-1] & below[1:])
    up = np.flatnonzero(below[:-1] & ~below[1:])
    for start in down:
        later = up[up > start]
        end = int(later[0]) if len(later) else len(tips_m) - 1
        if tips_m[start : end + 1, 2].min() < -TOUCH_M:
            return int(start), (end if len(later) else None)
    return None, None


def at_surface(tips_m: NDArray[np.float64], row: int) -> NDArray[np.float64]:
    """Return where (3,) a path crosses z = 0 between a row and the next."""
    first, second = tips_m[row], tips_m[row + 1]
    return first + (second - first) * first[2] / (first[2] - second[2])


def _nearest(sutures: Sequence[Suture], tips_m: NDArray[np.float64], loading: Loading) -> int | None:
    """Return the number of the suture that a needle was meant for; None if it never went in near one."""
    if loading.entry is None:
        return None
    entry = at_surface(tips_m, loading.entry)
    away = [float(np.linalg.norm(entry - suture.entry_m)) for suture in sutures]
    number = int(np.argmin(away))
    return number if away[number] <= MEANT_M else None


def _score(
    number: int,
    suture: Suture,
    loading: Loading | None,
    truth: NeedleTruth,
    tips: NDArray[np.float64],
    events: Sequence[Mapping[str, Any]],
) -> SutureScore:
    noted = next((e for e in reversed(events) if e["name"] == "suture" and e.get("suture") == number), None)
    entry = exit_ = None
    off, slipped, driven = np.zeros(0), (0.0, 0.0), None
    if loading is not None and loading.entry is not None:
        entry = float(np.linalg.norm(at_surface(tips, loading.entry) - suture.entry_m))
        if loading.exit is not None and suture.exit_m is not None:
            exit_ = float(np.linalg.norm(at_surface(tips, loading.exit) - suture.exit_m))
        grips = grips_of(truth, loading)
        if grips:
            slipped = tuple(max(each) for each in zip(*(slip(truth, *grip) for grip in grips), strict=True))
        rows = [np.arange(max(first, loading.entry), last + 1) for first, last in grips if last > loading.entry]
        off = np.concatenate([path_distance_m(tips[r], suture.needle_path_m) for r in rows]) if rows else off
        if rows:
            driven = float(truth.times_s[rows[0][0]]), float(truth.times_s[rows[-1][-1]])
    on_target = entry is not None and entry <= ON_TARGET_M
    on_target &= suture.exit_m is None or (exit_ is not None and exit_ <= ON_TARGET_M)
    held = slipped[0] <= SLIP_M and slipped[1] <= SLIP_RAD
    pulled = not truth.by_two_arms or (loading is not None and loading.last + 1 < len(truth.in_hand))
    succeeded = on_target and held and pulled
    wrong = SutureOutcome.NEEDLE_SLIPPED
    if held:
        wrong = SutureOutcome.NOT_PULLED if on_target else SutureOutcome.OFF_TARGET
    failure, reason = ("", "") if succeeded else _why(noted, loading, wrong, events)
    end = float(truth.times_s[-1])
    start_s, end_s = driven or (end, end)
    if noted is not None:
        end_s = float(noted["time_s"])
        start_s = float(noted.get("start_s", min(start_s, end_s)))
    return SutureScore(
        attempted=True,
        succeeded=succeeded,
        failure=failure,
        reason=reason,
        start_s=start_s,
        end_s=end_s,
        theta_deg=round(math.degrees(suture.theta_rad), 6),
        direction=suture.direction,
        entry_error_m=entry,
        exit_error_m=exit_,
        tip_rms_m=float(np.sqrt(np.mean(off**2))) if len(off) else None,
        tip_max_m=float(off.max()) if len(off) else None,
        slip_m=slipped[0],
        slip_rad=slipped[1],
        driven_s=driven,
    )


def _why(
    noted: Mapping[str, Any] | None, loading: Loading | None, wrong: SutureOutcome, events: Sequence[Mapping[str, Any]]
) -> tuple[str, str]:
    """Return the failure's name and a sentence: the script's own if it gave one, else what the truth shows."""
    said = agent_explanation(noted, events)
    if said is not None:
        return said
    outcome = SutureOutcome.NOT_DRIVEN if loading is None else wrong
    return outcome.name, outcome.value


def grips_of(truth: NeedleTruth, loading: Loading) -> list[tuple[int, int]]:
    """Return (first, last) row of each grip of the needle; a gap of up to ``FLICKER_S`` does not end a grip."""
    rows = loading.first + np.flatnonzero(truth.gripped[loading.first : loading.last + 1])
    if not len(rows):
        return []
    gaps = np.flatnonzero(np.diff(truth.times_s[rows]) > FLICKER_S) + 1
    return [(int(run[0]), int(run[-1])) for run in np.split(rows, gaps)]


def slip(truth: NeedleTruth, first: int, last: int) -> tuple[float, float]:
    """Return how far the needle moved (at the jaws, m) and turned (rad) in a grip, once the jaws had settled."""
    first = int(np.searchsorted(truth.times_s, truth.times_s[first] + SETTLED_S - 1e-9))
    if last - first < 1:
        return 0.0, 0.0
    rows = slice(first, last + 1)
    T_tip_needle = truth.T_circle_tip[rows].inverse() @ truth.T_circle_needle[rows]
    # the point of the needle that was at the jaws' tip at first, followed in the jaws' frame
    p_needle = T_tip_needle[0].inverse().apply([0.0, 0.0, 0.0])
    moved = np.linalg.norm(T_tip_needle.apply(p_needle), axis=-1)
    turned = np.linalg.norm((T_tip_needle[0].rotation.inverse() @ T_tip_needle.rotation).log(), axis=-1)
    return float(moved.max()), float(turned.max())


def path_distance_m(points_m: NDArray[np.float64], path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (n,) of points (n, 3) from the polyline through points (k, 3)."""
    start, step = path_m[:-1], np.diff(path_m, axis=0)
    since = points_m[:, None] - start
    share = np.clip((since * step).sum(-1) / np.maximum((step * step).sum(-1), 1e-30), 0.0, 1.0)
    return np.linalg.norm(since - share[..., None] * step, axis=-1).min(axis=1)
