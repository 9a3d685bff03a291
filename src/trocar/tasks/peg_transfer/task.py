"""FLS peg transfer: six triangular blocks from one half of the board to the other, and back (paper, section III)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval import Method, Task, check_budget, option
from trocar.geometry import SE3, SO3, TURN
from trocar.lab import Station
from trocar.registry import Lazy
from trocar.tasks.peg_transfer.goals import GOALS, PegSet, Transfer
from trocar.tasks.peg_transfer.scene import PRINT, PegScene
from trocar.tasks.peg_transfer.score import TransferScore, score_transfers
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from trocar.tasks.peg_transfer.truth import PegTruth

if TYPE_CHECKING:
    from trocar.sim.world import TaskWorld

BOARD_SHIFT_M = 2e-3
BOARD_TURN_RAD = np.radians(3.0)
BLOCK_SHIFT_M = 1.6e-3
"""How far off its peg's middle a person lays a block; the hole's clearance is 2.1 mm."""

BESIDE_PEG_M = 0.2e-3
"""Least gap between a block as laid down and its peg."""
MOST_OFF_M = 0.5e-3
"""Prints with larger errors are not used."""
MIN_GAP_M = 0.5e-3
"""Least gap between two blocks as laid down at the start."""

VARIANTS = tuple(GOALS)
TWO_ARMS = ("bilateral", "handover")

_SETTINGS = "trocar.tasks.peg_transfer.agents.settings"
_AGENT = {
    "agent": Lazy("trocar.tasks.peg_transfer.agents:agent_of"),
    "settings": Lazy(f"{_SETTINGS}:Settings"),
    "perception": "depth",
}
_WORLD = Lazy("trocar.tasks.peg_transfer.world:PegWorld")


@dataclass(frozen=True)
class PegTransfer(Task):
    """Twelve transfers on a slightly displaced board, with blocks that lie loosely."""

    variant: str = option(
        "unilateral",
        "Which arms do it: one does all, two do transfers in parallel, or one hands every block over to the other.",
        choices=VARIANTS,
    )
    transfers: int = option(12, "Only the first N of the twelve transfers.", metavar="N")
    budget_s: float = option(180.0, "A trial that takes longer is stopped.", flag="budget", metavar="S")

    name = "peg-transfer"
    about = "six blocks from peg to peg and back, twelve transfers (Hwang et al. 2022)"
    goal_noun = "transfer"
    station = "peg-transfer"
    methods: ClassVar = {
        "calibrated": Method(
            "cables compensated by a model that was fitted in this session",
            calibrated=True,
            **{**_AGENT, "settings": Lazy(f"{_SETTINGS}:compensated")},
        ),
        "uncalibrated": Method("encoder readings taken at face value", **_AGENT),
        "adaptive": Method(
            "no recording: cables are learned from looks at the wrist, before the first transfer and at each one",
            learns=True,
            **{**_AGENT, "settings": Lazy(f"{_SETTINGS}:learning")},
        ),
        "optimized": Method(
            "calibrated, the paper's SQP refining its splines",
            calibrated=True,
            **{**_AGENT, "settings": Lazy(f"{_SETTINGS}:patient")},
            planner="sqp",
        ),
        "best": Method(
            "calibrated, each motion as short as the limits allow, budgets as short as the computations",
            calibrated=True,
            **{**_AGENT, "settings": Lazy(f"{_SETTINGS}:quick")},
            planner="optimal",
        ),
    }
    perceptions: ClassVar = {"depth": Lazy("trocar.tasks.peg_transfer.perception:DepthView")}
    report = Lazy("trocar.tasks.peg_transfer.report:PegReport")
    study = Lazy("trocar.tasks.peg_transfer.report.study:PegStudy")

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise UnknownName("variant of peg-transfer", self.variant, VARIANTS)
        most = len(GOALS[self.variant])
        if not 1 <= self.transfers <= most:
            raise InvalidValue("the number of transfers", self.transfers, f"give 1 to {most} with --transfers")
        check_budget(self.budget_s)

    def at(self, station: Station) -> Station:
        """Return the station, if a board is fixed there."""
        if "board" not in station.T_world_fixture:
            raise InvalidInput(
                f"station {station.name!r}", "has no fixture 'board', which peg-transfer needs", "add it"
            )
        if self.variant in TWO_ARMS and len(station.arms) < 2:
            problem = f"has one arm, and peg-transfer --variant {self.variant} needs two"
            raise InvalidInput(f"station {station.name!r}", problem, "add one")
        return station

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the first arm, or the first two."""
        return tuple(station.arms)[: 2 if self.variant in TWO_ARMS else 1]

    def goals(self) -> tuple[Transfer, ...]:
        """Return the transfers in order."""
        return GOALS[self.variant][: self.transfers]

    def nominal(self) -> PegSet:
        """Return the shapes of board and blocks, and the variant."""
        return PegSet(variant=self.variant)

    def scene(self, rng: np.random.Generator, station: Station) -> PegScene:
        """Return a board moved by millimetres with a block lying loosely on each of its left six pegs, as printed."""
        (sd_m,) = station.difficulty.values(PRINT)
        board, block = printed(self.nominal().board, self.nominal().block, float(sd_m), rng.spawn(1)[0])
        shift = np.append(rng.uniform(-BOARD_SHIFT_M, BOARD_SHIFT_M, 2), 0.0)
        turn = SO3.axis("z", rng.uniform(-BOARD_TURN_RAD, BOARD_TURN_RAD))
        T_world_board = station.T_world_fixture["board"] @ SE3.from_parts(turn, shift)
        room_m = float(block.hole_radius_m(np.linspace(0.0, TURN, 61)).min()) - board.peg_radius_m
        shift_m, poses = min(BLOCK_SHIFT_M, room_m - BESIDE_PEG_M), list[SE3]()
        for peg in board.pegs_m[:6]:
            pose = _lay(block, peg, shift_m, rng)
            while any(block.gap_m(pose, other) < MIN_GAP_M for other in poses):
                pose = _lay(block, peg, shift_m, rng)
            poses.append(pose)
        T_board_blocks = SE3.unchecked(np.stack([pose.matrix for pose in poses]))
        return PegScene(T_world_board, T_world_board @ T_board_blocks, board, block)

    def world(self, scene: PegScene) -> TaskWorld:
        """Return board, blocks and referee."""
        return _WORLD.load()(scene)

    def score(self, truth: PegTruth, events: Sequence[Mapping[str, Any]]) -> list[TransferScore]:
        """Return one score for each of the transfers."""
        return score_transfers(self.goals(), truth, events, handover=self.variant == "handover")


def printed(board: Pegboard, block: Block, sd_m: float, rng: np.random.Generator) -> tuple[Pegboard, Block]:
    """Return a board and its blocks as printed: positions and sizes with errors of this SD, at most .5 mm.

    All pegs have the same thickness and height, and all blocks the same shape.
    """

    def off(*shape: int) -> np.ndarray:
        return np.clip(sd_m * rng.standard_normal(shape), -MOST_OFF_M, MOST_OFF_M)

    thicker, taller, side, corner, height, wider = off(6).tolist()
    pegs = tuple(map(tuple, off(len(board.pegs_m), 2).tolist()))
    board = replace(
        board, peg_radius_m=board.peg_radius_m + thicker, peg_height_m=board.peg_height_m + taller, pegs_off_m=pegs
    )
    block = replace(
        block,
        side_m=block.side_m + side,
        corner_m=block.corner_m + corner,
        height_m=block.height_m + height,
        hole_wider_m=wider,
    )
    return board, block


def _lay(block: Block, peg_m: np.ndarray, shift_m: float, rng: np.random.Generator) -> SE3:
    """Return a pose of a block round a peg in the board's frame: any yaw, off the middle."""
    off = shift_m * np.sqrt(rng.uniform())
    angle = rng.uniform(0.0, TURN)
    place = peg_m + [off * np.cos(angle), off * np.sin(angle), block.height_m]
    return SE3.from_parts(SO3.axis("x", np.pi) @ SO3.axis("z", rng.uniform(0.0, TURN)), place)
