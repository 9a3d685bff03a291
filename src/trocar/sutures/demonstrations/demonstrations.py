"""What recorded sutures say about manipulability round the circle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, manipulability
from trocar.errors import TrocarError

TURN = 2 * math.pi
SAME_PLACE_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Mean squared manipulability of each arm at places round the circle, from recorded sutures.

    At a place it is the mean over the recordings there, each counted alike however long it is; in between it is
    interpolated linearly between the two closest places, round the circle (paper, IV-A2).

    Attributes:
        places_rad: (p,) ascending, in [0, 2 pi), counterclockwise from x of the circle as everywhere.
        per_arm: (arms, p) mean of ``|J J^T|`` over a recording's rows, in m^4.
        recordings: (p,) how many there are at each place.
        arms: names of the arms, one a row of ``per_arm``.
        source: where they come from, and what was assumed to read them, in words.
    """

    places_rad: NDArray[np.float64]
    per_arm: NDArray[np.float64]
    recordings: NDArray[np.intp]
    arms: tuple[str, ...]
    source: str

    @property
    def breakpoints(self) -> NDArray[np.float64]:
        """Return the angles (p,) at which the slope of M changes; between neighbours M is linear."""
        return self.places_rad

    @cached_property
    def at_places(self) -> NDArray[np.float64]:
        """Return M (p,) at the places: both arms count alike (paper, III-D2)."""
        return self.per_arm.mean(0)

    def manipulability_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return M (n,) at any angles (n,): what ``dexterity`` takes for ``manipulability_at``."""
        return np.interp(np.asarray(thetas_rad, dtype=np.float64), self.places_rad, self.at_places, period=TURN)

    def per_arm_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return each arm's share (arms, n) at any angles (n,); their mean is M (paper, Fig. 6)."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        return np.stack([np.interp(thetas, self.places_rad, row, period=TURN) for row in self.per_arm])


def demonstrations_from_joints(
    thetas_rad: ArrayLike, joints: Sequence[NDArray[np.float64]], arms: Sequence[ArmModel], source: str
) -> Demonstrations:
    """Return the demonstrations in joint states.

    Args:
        thetas_rad: (r,) where each recorded suture stands; recordings at one place are averaged.
        joints: r recordings (n, arms, 6), rad and m.
        arms: whose.
        source: where they come from, in words.

    Raises:
        TrocarError: there are fewer than two places.
    """
    thetas = np.mod(np.asarray(thetas_rad, dtype=np.float64), TURN)
    thetas[TURN - thetas < SAME_PLACE_RAD] = 0.0
    squares = np.array([[(manipulability(arm, q[:, a]) ** 2).mean() for a, arm in enumerate(arms)] for q in joints])
    order = np.argsort(thetas, kind="stable")
    place = np.cumsum(np.diff(thetas[order], prepend=-1.0) > SAME_PLACE_RAD) - 1
    if len(place) == 0 or place[-1] == 0:
        raise TrocarError(
            f"the demonstrations stand at {len(set(place.tolist()))} place(s) of the circle; record sutures at two "
            "or more, for manipulability to be interpolated between them (the paper: eight)"
        )
    counts = np.bincount(place)
    per_arm = np.stack([np.bincount(place, column) / counts for column in squares[order].T])
    return Demonstrations(
        thetas[order][np.flatnonzero(np.diff(place, prepend=-1))],
        per_arm,
        counts,
        tuple(arm.name for arm in arms),
        source,
    )
