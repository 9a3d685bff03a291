"""Settings of the methods: how fast, how often it looks and plans again, and how long its computations may take."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Settings:
    """Settings of a method; the defaults are those of ``best``.

    Attributes:
        estimator: of the gripper's pose: ``field`` or ``paper``.
        centralised: whether one plan is made for both arms once both have asked (V-C.1), instead of one at a time
            beside what the other arm does.
        tip_speed_m_s: greatest speed of the tips; 1 cm/s in the paper's laboratory, up to 10 cm/s by surgeons.
        descent_speed_m_s: greatest speed on the last piece to a fragment.
        limits_share: share of the joints' limits that plans use; the rest is for corrections.
        astray_m: an arm that is found this far from where its motion should be stops and plans again; with 1 m it never
            does.
        step_m: an arm stops, looks and plans again after this distance at most (V-B: 2.5 cm).
        reached_m: a grasp counts as reached within this distance on each horizontal axis; 8 mm in their program.
        reached_high_m: the same in height.
        arrived_m: places in the air count as reached within this distance on each axis; 6 mm in their program.
        close_m: or after more than ``max_visits`` visits within this distance; 15 mm in their program.
        max_visits: see ``close_m``.
        open_rad: of the jaws at a fragment.
        hug_m: the jaws open by this much more than the fragment is wide, if that is less; 0: always ``open_rad``.
        turns: whether the gripper is turned about the vertical to close across a fragment and beside its neighbours.
        close_s: duration of the jaws' closing; 0: as fast as they can.
        above_m: the tip stops this high over a grasp, along the approach, and looks again. The paper's program passed a
            place 3 cm back without a stop; from a stop there, steps of 2.5 cm would end 5 mm over every grasp.
        lift_m: height of the straight lift after closing; 5 cm in their program.
        lifts_on_the_way: whether the arm goes on from there without a stop, and the pickup is checked meanwhile.
        hold_high_m: height of tips over the work surface while travelling.
        drop_high_m: height of the tip over the work surface when the jaws open over the receptacle.
        margin_m: between the arms, and to the receptacle. V-B has 1 mm, at which the guard stops an arm here: plans
            keep half a millimetre more, for estimates that change on the way.
        confirms_above: whether the camera has to confirm the position over a fragment before the tip goes down; the
            grasp's position always has to be confirmed.
        holds_first: whether an arm goes to its place beside the receptacle before it asks for the token.
        checks_release: whether an arm checks if a fragment clings to the open jaws.
        remembers: whether a fragment counts as present while an arm hides it from the camera.
        vision_lag_s: rest before every plan to a fragment, for the images to catch up; 2 s in their program.
        watch_s: time between two images of a gripper.
        watch_binning: this many by this many pixels are combined in them.
        fragments_budget_s: declared for finding fragments in a pair of images.
        gripper_budget_s: declared for finding a gripper in a window.
        plan_budget_s: declared for one plan.
        settle_s: rest before an image on whose estimate a decision depends.
        fresh_s: a gripper that was not seen for longer does not go down to a fragment.
        apart_m: fragments this close to the other arm's are not allocated.
    """

    estimator: str = "field"
    centralised: bool = False
    tip_speed_m_s: float = 0.05
    descent_speed_m_s: float = 0.025
    limits_share: float = 0.85
    astray_m: float = 0.006
    step_m: float = 0.15
    reached_m: float = 0.0015
    reached_high_m: float = 0.0012
    arrived_m: float = 0.010
    close_m: float = 0.004
    max_visits: int = 2
    open_rad: float = 1.2
    hug_m: float = 0.010
    turns: bool = True
    close_s: float = 0.0
    above_m: float = 0.013
    lift_m: float = 0.018
    lifts_on_the_way: bool = True
    hold_high_m: float = 0.040
    drop_high_m: float = 0.038
    margin_m: float = 0.004
    confirms_above: bool = False
    holds_first: bool = False
    checks_release: bool = True
    remembers: bool = True
    vision_lag_s: float = 0.0
    watch_s: float = 0.1
    watch_binning: int = 2
    fragments_budget_s: float = 0.12
    gripper_budget_s: float = 0.03
    plan_budget_s: float = 0.05
    settle_s: float = 0.05
    fresh_s: float = 0.5
    apart_m: float = 0.028


def best() -> Settings:
    """Return the settings of ``best``: 5 cm/s."""
    return Settings()


def slow() -> Settings:
    """Return the settings of ``best`` at the paper's 1 cm/s."""
    return replace(Settings(), tip_speed_m_s=0.01, descent_speed_m_s=0.01)


def paper() -> Settings:
    """Return the settings of the paper and of its program (facts/debridement.md, What their system did)."""
    return Settings(
        estimator="paper",
        centralised=True,
        tip_speed_m_s=0.01,
        descent_speed_m_s=0.01,
        astray_m=1.0,
        step_m=0.025,
        reached_m=0.008,
        reached_high_m=0.008,
        arrived_m=0.006,
        close_m=0.015,
        max_visits=7,
        hug_m=0.0,
        turns=False,
        close_s=2.5,
        above_m=0.024,
        lift_m=0.050,
        lifts_on_the_way=False,
        margin_m=0.0015,
        confirms_above=True,
        holds_first=True,
        checks_release=False,
        remembers=False,
        vision_lag_s=2.0,
        watch_s=0.25,
        fragments_budget_s=0.3,
        gripper_budget_s=0.1,
        plan_budget_s=2.4,
        limits_share=0.75,
        settle_s=0.1,
        fresh_s=2.0,
        apart_m=0.030,
    )
