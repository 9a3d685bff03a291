"""The least distance of moving arms from each other and from obstacles, guaranteed between the samples too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from trocar.checks import require_numbers
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import nearest_m
from trocar.motion.bodies import Bodies, MovingArm, Obstacle
from trocar.motion.problem import MotionProblem
from trocar.trajectory import Trajectory

COARSE_S, COARSE = 0.04, 64  # longest interval between the first samples, and the most intervals for any span
STRETCH = 8  # intervals examined together for a pair of capsules, or skipped if its bounding boxes are far apart
SPLIT = 8  # number of parts into which an interval is cut if it may hide a smaller distance
MERGED_S = 1e-9  # samples closer than this count as one


@dataclass(frozen=True)
class Clearance:
    """How close moving things come: the least distance lies between ``distance_m`` and ``sampled_m``.

    Attributes:
        distance_m: lower bound of the distance, also between the samples; infinite if nothing can meet, below 0 if
            things may overlap.
        sampled_m: the least distance of all samples.
        time_s: time of that sample.
        between: the two closest parts, as in ``("psm1 left finger", "table")``.
        arms: names of the arms that these parts belong to.
    """

    distance_m: float
    sampled_m: float
    time_s: float
    between: tuple[str, str]
    arms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_numbers(self)


def swept_clearance(
    arms: Mapping[str, MovingArm],
    *,
    others: Mapping[str, MovingArm] | None = None,
    obstacles: Mapping[str, Obstacle] | None = None,
    span_s: tuple[float, float] | None = None,
    enough_m: float = inf,
    too_near_m: float = -inf,
    resolution_m: float = 1e-4,
) -> Clearance:
    """Return a guaranteed lower bound of the least distance between moving arms, and to what is in their way.

    Each arm of ``arms`` is compared with the other ones of them, with ``others`` and with ``obstacles``; parts of one
    arm are not compared with each other, nor ``others`` among themselves.

    Branch and bound over time: every pair of capsules has a lower bound of its distance in every interval between two
    samples. An interval that may hide a smaller distance than the samples show is cut into parts.

    >>> going = MovingArm(arm, trajectory, T_world_left)
    >>> waiting = MovingArm.resting(arm, q_now, T_world_right)
    >>> clear = swept_clearance({"psm1": going, "psm2": waiting}, enough_m=1e-3)
    >>> clear.distance_m >= 1e-3
    True

    Args:
        arms: by name, on one clock.
        others: by name, on the same clock.
        obstacles: by name.
        span_s: from when to when; default: from the first start to the last end of them all.
        enough_m: larger distances need not be known more precisely.
        too_near_m: a sample with a smaller distance than this ends the search.
        resolution_m: how far the bound may lie below the samples, if these are less than ``enough_m``.
    """
    if not resolution_m > 0:
        raise InvalidInput("distances", f"cannot be resolved to {resolution_m} m", "give a resolution above 0")
    bodies = Bodies.of(arms, others or {}, obstacles or {})
    if not len(bodies.pairs):
        return Clearance(inf, inf, 0.0, ("", ""))
    knots = _first_samples(bodies, span_s)
    ends, bends = bodies.ends_m(knots), bodies.accelerations(knots[:-1], knots[1:])
    pair, stretch, apart_m = _near(bodies, knots, ends, bends, enough_m)
    where = _stretches(len(knots))[stretch]
    times = knots[where]
    bend = bends[np.minimum(where[:, :-1], len(bends) - 1)[:, None], bodies.pairs[pair][..., None]].sum(axis=1)
    floor, best, when_s, which = apart_m, inf, 0.0, 0
    while True:
        distances, bounds = _measured(bodies, times, ends[where[..., None], bodies.pairs[pair][:, None]], pair, bend)
        row, sample = np.unravel_index(np.argmin(distances), distances.shape)
        if distances[row, sample] < best:
            best, when_s, which = float(distances[row, sample]), float(times[row, sample]), int(pair[row])
        hiding = bounds < min(best - resolution_m, enough_m)
        floor = min(floor, best, float(bounds[~hiding].min(initial=inf)))
        row, part = np.nonzero(hiding)
        if not len(row) or best < too_near_m:
            floor = min(floor, float(bounds[hiding].min(initial=inf)))
            break
        # an interval's parts inherit its bound of the acceleration
        pair, bend = pair[row], np.broadcast_to(bend, bounds.shape)[row, part][:, None]
        begin, end = times[row, part, None], times[row, part + 1, None]
        times = begin + (end - begin) * np.linspace(0.0, 1.0, SPLIT + 1)
        moments, where = np.unique(times, return_inverse=True)
        where, ends = where.reshape(times.shape), bodies.ends_m(moments)
    first, second = bodies.pairs[which]
    between = bodies.names[first], bodies.names[second]
    return Clearance(floor, best, when_s, between, bodies.arms_of(bodies.pairs[which]))


def clearance_of(
    problem: MotionProblem, motions: Sequence[Trajectory], resolution_m: float, too_near_m: float = -inf
) -> Clearance:
    """Return how close the arms of a problem come to each other and to everything else, until all rest.

    The motions are those of the arms in order; if nothing else moves, they may be paths with any common timing.
    """
    arms = {
        name: MovingArm(arm.model, motion, arm.T_world_base, jaw_rad=arm.jaw_rad)
        for (name, arm), motion in zip(problem.arms.items(), motions, strict=True)
    }
    others, obstacles, enough_m = problem.others, problem.obstacles, problem.min_distance_m
    span_s = 0.0, max(arm.end_s for arm in (*arms.values(), *others.values()))
    wanted = {"enough_m": enough_m, "too_near_m": too_near_m, "resolution_m": resolution_m}
    return swept_clearance(arms, others=others, obstacles=obstacles, span_s=span_s, **wanted)


def _first_samples(bodies: Bodies, span_s: tuple[float, float] | None) -> Array:
    """Return times over the span, all knots among them: between two of them every joint follows one polynomial."""
    begin = min(arm.start_s for arm in bodies.movers) if span_s is None else float(span_s[0])
    end = max(arm.end_s for arm in bodies.movers) if span_s is None else float(span_s[1])
    if not (np.isfinite([begin, end]).all() and begin <= end):
        raise InvalidInput("distances", f"are asked for from {begin} to {end} s", "give two finite times in order")
    knots = np.concatenate([arm.knots_s for arm in bodies.movers])
    even = np.linspace(begin, end, min(COARSE, max(1, ceil((end - begin) / COARSE_S))) + 1)
    times = np.unique(np.concatenate([even, knots[(knots > begin) & (knots < end)]]))
    times = times[np.diff(times, prepend=-inf) > MERGED_S]
    return times if len(times) > 1 else np.repeat(times, 2)


def _stretches(samples: int) -> NDArray[np.intp]:
    """Return which samples belong to which stretch of the span: (stretches, STRETCH + 1); the last is repeated."""
    first = np.arange(0, max(1, samples - 1), STRETCH)
    return np.minimum(first[:, None] + np.arange(STRETCH + 1), samples - 1)


def _near(
    bodies: Bodies, knots: Array, ends: Array, bends: Array, enough_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], float]:
    """Return the pairs of capsules, and the stretches, in which they may be closer than ``enough_m``.

    Within a stretch, a capsule stays in the bounding box of its samples, widened by how much its path may bend between
    them. ``knots`` (n,) are the times of the samples, ``ends`` (n, bodies, 2, 3) those of the capsules there, ``bends``
    (n - 1, bodies) bounds of the accelerations between them. The result is (rows,) index of the pair, (rows,) index of
    the stretch, and a lower bound of the distance in all other rows, m.
    """
    where = _stretches(len(knots))
    hidden_m = bends * np.diff(knots)[:, None] ** 2 / 8
    wider = bodies.radii_m + hidden_m[np.minimum(where[:, :-1], len(hidden_m) - 1)].max(axis=1)
    low = ends.min(axis=2)[where].min(axis=1) - wider[..., None]
    high = ends.max(axis=2)[where].max(axis=1) + wider[..., None]
    a, b = bodies.pairs.T
    between = np.maximum(0.0, np.maximum(low[:, a] - high[:, b], low[:, b] - high[:, a]))
    apart_m = np.sqrt(np.einsum("...i,...i->...", between, between))
    nearest = np.unravel_index(np.argmin(apart_m), apart_m.shape)
    kept = (apart_m < enough_m) | (apart_m <= 0.0)  # overlapping boxes give no bound
    kept[nearest] = True  # so that there is always a sample
    stretch, pair = np.nonzero(kept)
    return pair, stretch, float(apart_m[~kept].min(initial=inf))


def _measured(bodies: Bodies, times: Array, ends: Array, pair: NDArray[np.intp], bend: Array) -> tuple[Array, Array]:
    """Return distances (rows, samples) of pairs of capsules, and lower bounds (rows, samples - 1) in between, m.

    Assume first that both capsules move straight between two samples. Then there are two bounds. First, the vector
    between any two of their points changes by no more than the vector between some two of their ends; the mean of both
    sampled distances minus half of this change is a bound. Second, along the direction of the shortest vector at one
    sample, no two points are closer at the other sample than some pair of ends. The better bound is used, minus the
    bend of the true paths.

    Each row is about a pair (rows,) with times (rows, samples), ends (rows, samples, 2 capsules, 2 ends, 3) and the sum
    ``bend`` of both accelerations' bounds, (rows, samples - 1) or (rows, 1), m/s^2.
    """
    p, q, (a, b) = ends[:, :, 0], ends[:, :, 1], bodies.pairs[pair].T[..., None]
    radii = bodies.radii_m[a] + bodies.radii_m[b]
    gaps, _, _ = nearest_m(p[..., 0, :], p[..., 1, :], q[..., 0, :], q[..., 1, :])
    lengths = np.sqrt(np.einsum("...i,...i->...", gaps, gaps))
    ways = gaps / np.where(lengths > 0, lengths, 1.0)[..., None]
    between = p[..., :, None, :] - q[..., None, :, :]  # (rows, samples, 2 ends of one, 2 of the other, 3)
    change = np.diff(between, axis=1)
    change_m = np.sqrt(np.einsum("...i,...i->...", change, change).max((-2, -1)))
    even = (lengths[:, :-1] + lengths[:, 1:] - change_m) / 2
    ahead = np.einsum("...jki,...i->...jk", between[:, 1:], ways[:, :-1]).min((-2, -1))
    back = np.einsum("...jki,...i->...jk", between[:, :-1], ways[:, 1:]).min((-2, -1))
    seen = np.maximum(np.minimum(lengths[:, :-1], ahead), np.minimum(lengths[:, 1:], back))
    straight = np.maximum(even, seen)
    return lengths - radii, straight - radii - bend * np.diff(times, axis=1) ** 2 / 8
