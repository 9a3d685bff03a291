"""Settings of the methods: how fast, how often it looks and plans again, and how long its computations may take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of a method; the defaults are those of ``best``."""

    estimator: str = "field"  # of the gripper's pose: ``field`` or ``paper``
    centralised: bool = False  # one plan for both arms once both have asked (V-C.1), or one arm beside the other
    ahead: bool = True  # arms choose fragments such that they get least in each other's way, or the outermost (V-C.2)
    token: bool = False  # an arm goes beside the receptacle and waits for its token (V-C.2), or each uses its own half

    # Speeds. The paper's laboratory used 1 cm/s; surgeons reach 10 cm/s.
    tip_speed_m_s: float = 0.05
    descent_speed_m_s: float = 0.025  # on the last piece to a fragment
    limits_share: float = 0.88  # of the joints' limits that plans use; the rest is for corrections

    # Steps. An arm stops, looks and plans again after ``step_m`` (V-B: 2.5 cm), and if it is seen ``astray_m`` from
    # where its motion should be (1 m: never).
    astray_m: float = 0.006
    step_m: float = 0.15
    reached_m: float = 0.0025  # a grasp counts as reached this close on each horizontal axis; 8 mm in their program
    reached_high_m: float = 0.0017  # the same above it
    reached_low_m: float = 0.0013  # the same below it, where closed jaws end 1.5 mm over the work surface
    further_share: float = 0.5  # corrections at a grasp aim further than it by this share of what is missing
    arrived_m: float = 0.010  # the same on each axis for places in the air; 6 mm in their program
    close_m: float = 0.004  # or after more than ``max_visits`` visits within this distance; 15 mm in their program
    max_visits: int = 2

    # Grasp and lift.
    open_rad: float = 1.2  # of the jaws at a fragment
    hug_m: float = 0.010  # or this much wider than the fragment, if that is less; 0: always ``open_rad``
    ends_above_m: tuple[float, ...] = (1.5e-3, 1.0e-3, 0.4e-3)  # height at which closed jaws end (+)
    turns: bool = True  # about the vertical: across a fragment, beside neighbours; deeper after a failure
    close_s: float = 0.0  # duration of the jaws' closing; 0: as fast as they can
    above_m: float = 0.013  # the tip stops this high over a grasp, along the approach, and looks again (*)
    lift_m: float = 0.008  # straight lift after closing; 5 cm in their program
    flows: bool = True  # no stop over a grasp or after a lift; check, open the jaws and look again on the way
    # (+) Over the work surface: at first, after a failure there, and after more, since low pieces with slanted sides
    # slip out of jaws that hold them near their top.
    # (*) The paper's program passed a place 3 cm before the grasp without a stop. With a stop there, steps of 2.5 cm
    # would end 5 mm over every grasp.

    # Places: heights of the tip over the work surface, and distances.
    hold_high_m: float = 0.040  # while travelling
    drop_high_m: float = 0.035  # when the jaws open over the receptacle
    drop_nearer_m: float = 0.018  # there, this much closer to the fragments than the receptacle's middle
    hanging_m: float = 0.005  # for plans, walls are this much higher: a carried fragment hangs lower than fingers
    margin_m: float = 0.004  # between the arms, and to the receptacle (**)
    apart_m: float = 0.028  # fragments this close to the other arm's are not allocated
    # (**) V-B has 1 mm, at which the guard stops an arm here. Plans of ``paper`` keep half a millimetre more, for
    # estimates that change on the way.

    # Looking.
    confirms_above: bool = False  # the camera has to confirm the position over a fragment too, not only at the grasp
    remembers: bool = True  # a fragment counts as present while an arm hides it from the camera
    vision_lag_s: float = 0.0  # rest before every plan to a fragment, for images to catch up; 2 s in their program
    watch_s: float = 0.1  # between two images of a gripper
    watch_binning: int = 2  # this many by this many pixels are combined in them
    settle_s: float = 0.05  # rest before an image on whose estimate a decision depends
    fresh_s: float = 0.5  # a gripper that was not seen for longer does not go down to a fragment

    # Time declared for computations: finding fragments in a pair of images, a gripper in a window, one plan.
    fragments_budget_s: float = 0.12
    gripper_budget_s: float = 0.03
    plan_budget_s: float = 0.05


def best() -> Settings:
    """Return the settings of ``best``: 5 cm/s."""
    return Settings()


def slow() -> Settings:
    """Return the settings of ``best`` at the paper's 1 cm/s."""
    return Settings(tip_speed_m_s=0.01, descent_speed_m_s=0.01)


def paper() -> Settings:
    """Return the settings of the paper and of its authors' program."""
    return Settings(
        estimator="paper", centralised=True, ahead=False, token=True, tip_speed_m_s=0.01, descent_speed_m_s=0.01,
        limits_share=0.75, astray_m=1.0, step_m=0.025, reached_m=0.008, reached_high_m=0.008, reached_low_m=0.008,
        further_share=0.0, arrived_m=0.006, close_m=0.015, max_visits=7, hug_m=0.0, ends_above_m=(2.0e-3,),
        turns=False, close_s=2.5, above_m=0.024, lift_m=0.050, flows=False, drop_high_m=0.038, drop_nearer_m=0.012,
        hanging_m=0.010, margin_m=0.0015, apart_m=0.030, confirms_above=True, remembers=False, vision_lag_s=2.0,
        watch_s=0.25, settle_s=0.1, fresh_s=2.0, fragments_budget_s=0.3, gripper_budget_s=0.1, plan_budget_s=2.4,
    )  # fmt: skip
