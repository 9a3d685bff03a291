"""What the referee saw: simulator truth, for ``Task.score`` alone. No agent may import this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3


@dataclass(frozen=True)
class Collision:
    """One hit of an arm or of the block it holds.

    Attributes:
        time_s: when it began, on the trial's clock.
        arm: whose.
        what: 'arm' or 'held block'.
        against: 'peg 4', or another arm's name.
        force_n: largest force while it lasted.
    """

    time_s: float
    arm: str
    what: str
    against: str
    force_n: float


@dataclass(frozen=True, eq=False)
class Truth:
    """Where everything really was.

    Attributes:
        times_s: (n,) trial clock.
        T_board_blocks: poses (n, blocks) in the board's frame.
        p_board_tips: (n, 3) true tip of each arm in the board's frame, m, by name.
        collisions: in order of time.
    """

    times_s: NDArray[np.float64]
    T_board_blocks: SE3
    p_board_tips: dict[str, NDArray[np.float64]]
    collisions: tuple[Collision, ...]

    def blocks_at(self, time_s: float) -> SE3:
        """Return the blocks' poses at the last sample not after this time."""
        return self.T_board_blocks[max(0, int(np.searchsorted(self.times_s, time_s + 1e-9)) - 1)]


@dataclass(frozen=True, eq=False)
class NeedleTruth:
    """Where the needle and the arm that drives it really were.

    Attributes:
        times_s: (n,) trial clock.
        T_circle_needle: (n,) poses in the circle's frame.
        T_circle_tip: (n,) poses of the arm's true tip in the circle's frame.
        q: (n, 6) its true joints.
        p_needle_tip_m: (3,) the needle's tip in its own frame.
        collisions: none are looked for: the phantom is not solid, and there is one arm.
    """

    times_s: NDArray[np.float64]
    T_circle_needle: SE3
    T_circle_tip: SE3
    q: NDArray[np.float64]
    p_needle_tip_m: NDArray[np.float64]
    collisions: tuple[Collision, ...] = ()

    @property
    def p_circle_needle_tip_m(self) -> NDArray[np.float64]:
        """Return the needle's tip (n, 3) in the circle's frame."""
        return self.T_circle_needle.apply(self.p_needle_tip_m)

    def rows(self, start_s: float, end_s: float) -> slice:
        """Return the rows between two times, both included."""
        first, last = np.searchsorted(self.times_s, [start_s - 1e-9, end_s + 1e-9])
        return slice(int(first), int(last))
