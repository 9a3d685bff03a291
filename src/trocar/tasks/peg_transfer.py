"""FLS peg transfer: six triangular blocks from one half of the board to the other, and back (paper, section III)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.scene import Block, Pegboard, Scene
from trocar.scene.truth import Truth

THERE = ((1, 7), (0, 6), (3, 8), (2, 9), (5, 11), (4, 10))
"""(source peg, target peg) of the first six transfers (facts/peg_transfer.md); the other six go back."""

BOARD_SHIFT_M = 2e-3
BOARD_TURN_RAD = np.radians(3.0)
BLOCK_SHIFT_M = 1.6e-3
"""How far a person leaves a block off its peg's middle; the hole's clearance is 2.1 mm."""

LEAST_GAP_M = 0.5e-3
"""Between two blocks as they are laid down at the start."""

REST_S = 0.3
"""A released block is judged after it had this time to fall."""

ENGAGED_M = 8e-3
"""A block is on its peg while its lower face is below this height over the plate, the peg inside its hole."""
UPRIGHT_RAD = np.radians(10.0)


@dataclass(frozen=True)
class TransferScore:
    """One transfer as the referee saw it.

    Attributes:
        source: peg.
        target: peg.
        attempted: a block was there to be moved.
        succeeded: it lies on its target afterwards.
        failure: name of the outcome that ended it, empty after a success.
        start_s: on the trial's clock.
        end_s: likewise.
    """

    source: int
    target: int
    attempted: bool
    succeeded: bool
    failure: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class PegTransfer:
    """The task, apart from how it is done.

    Attributes:
        variant: so far ``unilateral``: one arm does all twelve transfers.
        budget_s: a trial that takes longer is stopped.
    """

    variant: str = "unilateral"
    budget_s: float = 180.0

    name = "peg-transfer"
    variants = ("unilateral",)
    T_world_base = None
    """The arms stand where the cell has them."""
    T_world_board = SE3.identity()
    """Where the board is, nominally."""
    excitation = None
    """A calibration moves as the recorded arms did."""
    stop_at_limits = False
    """What cannot be corrected within a joint's range stays uncorrected."""
    compares_joints = False
    """No joint is compared with what it was asked for."""

    def __post_init__(self) -> None:
        if self.variant not in self.variants:
            raise TrocarError(
                f"variant {self.variant!r} of peg-transfer is unknown; choose one of {', '.join(self.variants)}"
            )

    @property
    def transfers(self) -> tuple[tuple[int, int], ...]:
        """Return all twelve (source, target) pairs in order."""
        return THERE + tuple((target, source) for source, target in THERE)

    @property
    def work(self) -> tuple[tuple[int, int], ...]:
        """Return what a script is asked to do."""
        return self.transfers

    def scene(self, rng: np.random.Generator) -> Scene:
        """Return a board moved by millimetres with a block lying loosely on each of its left six pegs."""
        board, block = Pegboard(), Block()
        shift = np.append(rng.uniform(-BOARD_SHIFT_M, BOARD_SHIFT_M, 2), 0.0)
        T_world_board = SE3.from_parts(SO3.axis("z", rng.uniform(-BOARD_TURN_RAD, BOARD_TURN_RAD)), shift)
        poses: list[SE3] = []
        for peg in board.pegs_m[:6]:
            pose = self._lay(block, peg, rng)
            while any(block.gap_m(pose, other) < LEAST_GAP_M for other in poses):
                pose = self._lay(block, peg, rng)
            poses.append(pose)
        T_board_blocks = SE3(np.stack([pose.matrix for pose in poses]))
        return Scene(board, block, T_world_board, T_world_board @ T_board_blocks)

    @staticmethod
    def _lay(block: Block, peg_m: np.ndarray, rng: np.random.Generator) -> SE3:
        """Return a pose of a block round a peg in the board's frame: any yaw, off the middle."""
        off = BLOCK_SHIFT_M * np.sqrt(rng.uniform())
        angle = rng.uniform(0.0, 2 * np.pi)
        place = peg_m + [off * np.cos(angle), off * np.sin(angle), block.height_m]
        return SE3.from_parts(SO3.axis("x", np.pi) @ SO3.axis("z", rng.uniform(0.0, 2 * np.pi)), place)

    def score(self, events: Sequence[Mapping[str, object]], truth: Truth) -> list[TransferScore]:
        """Return one score for each transfer that the script noted, judged by where the blocks really were."""
        scores = []
        for event in events:
            if event["name"] != "transfer":
                continue
            source, target = int(event["source"]), int(event["target"])  # type: ignore[call-overload]
            start_s, end_s = float(event["start_s"]), float(event["time_s"])  # type: ignore[arg-type]
            outcome = str(event["outcome"])
            moved = on_peg(truth.blocks_at(start_s), source)
            after = on_peg(truth.blocks_at(end_s + REST_S), target)
            succeeded = moved is not None and after == moved
            failure = "" if succeeded else (outcome if outcome != "DONE" else "NOT_PLACED")
            scores.append(TransferScore(source, target, moved is not None, succeeded, failure, start_s, end_s))
        return scores


def on_peg(T_board_blocks: SE3, peg: int, board: Pegboard | None = None, block: Block | None = None) -> int | None:
    """Return which block stands upright round this peg, or None."""
    board, block = board or Pegboard(), block or Block()
    for number, pose in enumerate(T_board_blocks.matrix):
        offset = SE3(pose).inverse().apply(board.pegs_m[peg] + [0, 0, board.peg_height_m / 2])
        inside = np.hypot(*offset[:2]) < block.hole_radius_m(np.arctan2(offset[1], offset[0]))
        upright = -pose[2, 2] > np.cos(UPRIGHT_RAD)
        low = pose[2, 3] - block.height_m < ENGAGED_M
        if inside and upright and low:
            return number
    return None
