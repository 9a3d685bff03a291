"""The play operator: an exact, rate-independent model of backlash."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError

FEW = 4
"""For up to this many operators, a loop over plain floats is faster than one over small arrays."""


def play_operator(u: ArrayLike, radii: ArrayLike, start: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return the play operator of a sequence, ``P_t = clip(P_{t-1}, u_t - r, u_t + r)``.

    The slack ``u - P`` lies in [-r, r]. It depends on past reversals, not on the rate.

    Args:
        u: (n, ...) inputs over time, in rad.
        radii: half-widths r of the backlash in rad, broadcast against the inputs' trailing shape:
            inputs (n, 3, 1) and radii (3, 4) give (n, 3, 4).
        start: state P before the first sample; None starts without slack.

    Returns:
        (n, ...) outputs P.

    Raises:
        TrocarError: a radius is negative or the inputs are not finite.
    """
    u, r = np.asarray(u, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    if not np.all(np.isfinite(u)):
        raise TrocarError("a play operator needs finite inputs, got NaN or infinity; remove those rows")
    if not np.all(r >= 0):
        raise TrocarError(f"a play operator's radii must be 0 or more, got {r}")
    if u.ndim == 1 and r.ndim == 0:
        return _play_of_one(u, float(r), None if start is None else float(np.asarray(start)))
    low, high = u - r, u + r
    out = np.empty_like(low)
    if 0 < low[:1].size <= FEW:
        return _column_by_column(u, r, start, out)
    if not len(u):
        return out
    state: NDArray[np.float64] = np.broadcast_to(u[0] if start is None else np.asarray(start), low.shape[1:])
    for row, floor, ceiling in zip(out, low, high, strict=True):
        np.maximum(state, floor, out=row)
        np.minimum(row, ceiling, out=row)
        state = row
    return out


def _column_by_column(
    u: NDArray[np.float64], r: NDArray[np.float64], start: ArrayLike | None, out: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fill ``out`` (n, ...) operator by operator, and return it."""
    inputs, radii = np.broadcast_to(u, out.shape), np.broadcast_to(r, out.shape[1:])
    states = inputs[0] if start is None else np.broadcast_to(np.asarray(start, dtype=np.float64), out.shape[1:])
    for index in np.ndindex(*out.shape[1:]):
        out[(slice(None), *index)] = _play_of_one(
            inputs[(slice(None), *index)], float(radii[index]), float(states[index])
        )
    return out


def _play_of_one(u: NDArray[np.float64], r: float, start: float | None) -> NDArray[np.float64]:
    """Return the play operator of one sequence (n,) at one radius; plain floats are ten times faster than arrays."""
    if not len(u):
        return np.empty(0)
    p = float(u[0]) if start is None else start
    out = []
    for low, high in zip((u - r).tolist(), (u + r).tolist(), strict=True):
        if p < low:
            p = low
        elif p > high:
            p = high
        out.append(p)
    return np.array(out)
