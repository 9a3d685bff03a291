"""Agents of the peg transfer, one for each variant, and their settings."""

from __future__ import annotations

from dataclasses import dataclass

from trocar.eval import Agent, AgentContext
from trocar.registry import Lazy
from trocar.robots.coordinator import Margins
from trocar.tasks.peg_transfer.grasps import DEPTH_M

AGENTS = {
    "unilateral": Lazy("trocar.tasks.peg_transfer.agents.unilateral:Unilateral"),
    "bilateral": Lazy("trocar.tasks.peg_transfer.agents.two_arms:Bilateral"),
    "handover": Lazy("trocar.tasks.peg_transfer.agents.two_arms:Handover"),
}


def agent_of(context: AgentContext) -> Agent:
    """Return the agent for the variant in this context."""
    return AGENTS[context.nominal.variant].load()(context)


@dataclass(frozen=True)
class Settings:
    """How the agents work; lengths in m, angles in rad, times on the cell's clock in s."""

    # Declared times of computations, and the rest after a motion before the jaws act.
    perception_budget_s: float = 0.098  # for finding a block and planning its grasp (paper)
    survey_budget_s: float = 0.25  # for registering the board, and for the last look at all blocks
    planning_budget_s: float = 0.103  # for planning a motion (paper)
    traffic_budget_s: float = 0.02  # for checking a motion against what the other arm does
    sighting_budget_s: float = 0.12  # for finding the wrist in an image (``bench_sighting.py``)
    fit_budget_s: float = 0.6  # for fitting the cables on all looks
    settle_s: float = 0.06

    # Jaws. To take a block from the other arm they have to open wide: with a true opening below 0.31 rad, 10 of 107
    # tries ended on top of the wall, but only 3 of 217 above 0.33 rad. Jaws that close further than ``jaw_empty_rad``
    # hold nothing, or too little of a block, unless the walls turn out to be thin (``WallOpening``): on a wall they
    # stall at 0.14 to 0.30 rad; a block held at 0.12 was lost.
    jaw_open_rad: float = 0.40  # widest opening round the wall of a block, against the clearance in its hole
    release_rad: float = 0.32  # least opening there
    taking_rad: float = 0.36  # opening of jaws that approach a block in the other arm's jaws
    jaw_closed_rad: float = -0.17  # target that lets the drive press empty jaws together
    jaw_grip_rad: float = -0.17  # target that lets it press on a wall (full force: .14 rad beyond the wall)
    jaw_play_rad: float = 0.06  # by how much open jaws are narrower than their encoder says (``PegHand``)
    jaw_empty_rad: float = 0.15

    # Where the tip goes.
    depth_m: float = DEPTH_M  # under the block's top face
    clear_height_m: float = 27e-3  # over the plate when it travels empty; the pegs are 20 mm tall
    lift_m: float = 26e-3  # how far a held block is raised: its lower face clears the pegs
    drop_m: float = 2e-3  # height of a block's lower face over the plate when it is released

    # Looking, learning and trying again. With ``fixed_wrist``, wrist joints keep still while the tip goes straight
    # down or up, so that the errors of their cables do not change; without, the tool does not turn. In a handover, only
    # arms that look before placing keep the wrist still over the target: the receiving arm holds a block at any angle,
    # and turning it further costs clearance.
    fixed_wrist: bool = False
    waits_for_jaws: bool = True  # until they are at rest; else arms go on while they act, and they loosen early
    looks_ahead: bool = True  # look at the next block, and plan, while the arm still moves; else only at rest
    looks_before_placing: bool = False  # stop over the target, look how the block hangs in the jaws, lower it like that
    learns_offset: bool = False  # correct where the tip is by looks at blocks in the jaws
    looks: int = 5  # how often an arm looks for a block that the other arm may hide
    teaching_looks: int = 0  # looks at its own wrist before the first transfer; 0: it does not learn its cables
    retries: int = 1  # how often a failed pick is tried again

    # Two arms. They meet 11 mm above the height at which a block is carried (the paper's arms: 10 to 13).
    margin_m: float = 4e-3  # kept between two arms, and between what they hold
    min_margin_m: float = 2e-3  # the same for an arm that would otherwise be stuck
    meeting_margin_m: float = 1.3e-3  # kept between two arms that hold one block
    meeting_m: tuple[float, float, float] = (-2.5e-3, 0.0, 37e-3)  # middle of the lower face of a block handed over
    waits_above_m: float = 13e-3  # height of the receiving arm over its grasp, before it comes down (facts)
    parts_m: float = 10e-3  # how far the giving arm rises before it goes away (facts)
    patience_s: float = 3.0  # an arm that could not move for this long does something else
    pace_s: float = 1.5  # how long one arm waits for the other to come as far
    detours: int = 2  # how often it then gives way and tries again, before it gives its transfer up
    rounds: int = 2  # how often a transfer is tried that the other arm blocks, or in which it does not take the block

    @property
    def margins(self) -> Margins:
        """Return what the coordinator keeps between the arms."""
        return Margins(self.margin_m, self.min_margin_m, self.patience_s, self.traffic_budget_s)


def compensated() -> Settings:
    """Return the settings of arms with compensated cables, whose remaining errors come mostly from a turning wrist."""
    return Settings(fixed_wrist=True)


def patient() -> Settings:
    """Return the settings for the paper's SQP, which takes 0.3 s per motion, at times 0.4 s (``bench_planning.py``)."""
    return Settings(planning_budget_s=0.4, fixed_wrist=True)


def quick() -> Settings:
    """Return the settings that declare the measured p95 of each computation on one shared core.

    A run reports if a machine needs longer (``missed_budgets``). Jaws act as soon as a motion has ended: by the time
    that their fingers touch something, the tip has come to rest (within .03 mm, .05 s after the end). While nothing is
    known of the walls, jaws must stall at .18 rad: on the rim of a usual wall they stall at .15, and lose the block.
    """
    return Settings(
        perception_budget_s=0.085, planning_budget_s=0.06, settle_s=0.02, fixed_wrist=True, waits_for_jaws=False,
        jaw_grip_rad=0.0, jaw_empty_rad=0.18, learns_offset=True, retries=2, rounds=3,
    )  # fmt: skip


def learning() -> Settings:
    """Return the settings of arms that learn their cables while they work."""
    return Settings(teaching_looks=36, fixed_wrist=True, looks_before_placing=True)
