"""Manipulability round the circle, from recorded sutures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, manipulability
from trocar.errors import InvalidInput
from trocar.geometry import TURN

SAME_PLACE_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Mean squared manipulability of each arm at places round the circle, from recorded sutures.

    At a place it is the mean over the recordings there, each with equal weight whatever its length; between places it
    is interpolated linearly from the two neighbours, round the circle (paper, IV-A2).

    Attributes:
        places_rad: (p,) ascending, in [0, 2 pi), counterclockwise from x of the circle. Between neighbours M is linear.
        per_arm: (arms, p) mean of ``|J J^T|`` over a recording's rows, in m^4.
        recordings: (p,) number of recordings at each place.
        arms: names of the arms, one per row of ``per_arm``.
        source: origin of the recordings, and what was assumed in reading them, in words.
    """

    places_rad: NDArray[np.float64]
    per_arm: NDArray[np.float64]
    recordings: NDArray[np.intp]
    arms: tuple[str, ...]
    source: str

    @cached_property
    def at_places(self) -> NDArray[np.float64]:
        """Return M (p,) at the places: the mean over the arms (paper, III-D2)."""
        return self.per_arm.mean(0)

    def manipulability_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return M (n,) at any angles (n,)."""
        return np.interp(np.asarray(thetas_rad, dtype=np.float64), self.places_rad, self.at_places, period=TURN)

    def per_arm_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return each arm's manipulability (arms, n) at any angles (n,); their mean is M (paper, Fig. 6)."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        return np.stack([np.interp(thetas, self.places_rad, row, period=TURN) for row in self.per_arm])


def demonstrations_from_joints(
    thetas_rad: ArrayLike, joints: Sequence[NDArray[np.float64]], arms: Sequence[ArmModel], source: str
) -> Demonstrations:
    """Return the demonstrations made of recorded joint states.

    Args:
        thetas_rad: (r,) position of each recorded suture; recordings at the same place are averaged.
        joints: r recordings (n, arms, 6), rad and m.
        arms: the recorded arms.
        source: origin of the recordings, in words.

    Raises:
        InvalidInput: there are fewer than two places.
    """
    thetas = np.mod(np.asarray(thetas_rad, dtype=np.float64), TURN)
    thetas[TURN - thetas < SAME_PLACE_RAD] = 0.0
    squares = np.array([[(manipulability(arm, q[:, a]) ** 2).mean() for a, arm in enumerate(arms)] for q in joints])
    order = np.argsort(thetas, kind="stable")
    place = np.cumsum(np.diff(thetas[order], prepend=-1.0) > SAME_PLACE_RAD) - 1
    if len(place) == 0 or place[-1] == 0:
        raise InvalidInput(
            "the demonstrations",
            f"cover {len(set(place.tolist()))} place(s) of the circle",
            "record sutures at two or more, so that manipulability can be interpolated between them (the paper: eight)",
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
