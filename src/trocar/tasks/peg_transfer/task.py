"""FLS peg transfer: move six triangular blocks to the other half of the board and back (Hwang et al. 2022, III)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval import Method, Task, check_budget, option
from trocar.lab import Station
from trocar.registry import Lazy
from trocar.tasks.peg_transfer.goals import GOALS, PegSet, Transfer
from trocar.tasks.peg_transfer.scene import PegScene, draw_scene
from trocar.tasks.peg_transfer.truth import PegTruth, TransferScore, score_transfers, told_transfers

if TYPE_CHECKING:
    from trocar.sim.world import TaskWorld

VARIANTS = tuple(GOALS)
TWO_ARMS = ("bilateral", "handover")

_AGENTS = "trocar.tasks.peg_transfer.agents"


def _method(about: str, settings: str, **how: Any) -> Method:
    """Return a method that runs this task's agents with the settings of this name."""
    agent, settings_of = Lazy(f"{_AGENTS}:agent_of"), Lazy(f"{_AGENTS}:{settings}")
    return Method(about, agent, settings_of, perception="depth", **how)


@dataclass(frozen=True)
class PegTransfer(Task):
    """Twelve transfers of loosely placed blocks on a slightly displaced board."""

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
        "calibrated": _method(
            "cables compensated by a model that was fitted in this session", "compensated", calibrated=True
        ),
        "uncalibrated": _method("encoder readings taken at face value", "Settings"),
        "adaptive": _method(
            "no recording: cables are learned from looks at the wrist, before the first transfer and at each one",
            "learning",
            learns=True,
        ),
        "optimized": _method(
            "calibrated, the paper's SQP refining its splines", "patient", calibrated=True, planner="sqp"
        ),
        "best": _method(
            "calibrated, each motion as short as the limits allow, budgets as short as the computations",
            "quick",
            calibrated=True,
            planner="optimal",
        ),
    }
    perceptions: ClassVar = {"depth": Lazy("trocar.tasks.peg_transfer.perception:DepthView")}
    objects = Lazy("trocar.tasks.peg_transfer.perception.objects:PegObjects")
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
        """Return the station, after a check that it has a board and enough arms.

        Raises:
            InvalidInput: the board or an arm is missing.
        """
        if "board" not in station.T_world_fixture:
            raise InvalidInput(
                f"station {station.name!r}", "has no fixture 'board', which peg-transfer needs", "add it"
            )
        if self.variant in TWO_ARMS and len(station.arms) < 2:
            problem = f"has one arm, and peg-transfer --variant {self.variant} needs two"
            raise InvalidInput(f"station {station.name!r}", problem, "add one")
        return station

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the names of the first arm or, for variants with two arms, of the first two."""
        return tuple(station.arms)[: 2 if self.variant in TWO_ARMS else 1]

    def goals(self) -> tuple[Transfer, ...]:
        """Return the transfers in order."""
        return GOALS[self.variant][: self.transfers]

    def nominal(self) -> PegSet:
        """Return the shapes of board and blocks, and the variant."""
        return PegSet(variant=self.variant)

    def scene(self, rng: np.random.Generator, station: Station) -> PegScene:
        """Return a board displaced by millimetres, with a block lying loosely on each of its six left pegs."""
        return draw_scene(rng, station)

    def world(self, scene: PegScene) -> TaskWorld:
        """Return board, blocks and referee."""
        return Lazy("trocar.tasks.peg_transfer.world:PegWorld").load()(scene)

    def score(self, truth: PegTruth, events: Sequence[Mapping[str, Any]]) -> list[TransferScore]:
        """Return one score for each of the transfers."""
        return score_transfers(self.goals(), truth, events, handover=self.variant == "handover")

    def told(self, events: Sequence[Mapping[str, Any]]) -> list[TransferScore]:
        """Return one score for each of the transfers, from the events that the script noted."""
        return told_transfers(self.goals(), events)
