"""Sutures round a circle, each driven along the needle primitive where the planner put it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.excitation import PSM1_BOX, MotionBox
from trocar.cell import Outcome
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.scene import SutureScene
from trocar.scene.truth import NeedleTruth
from trocar.sutures import CLOCKWISE, COUNTERCLOCKWISE, PRESETS, SutureSetup, dexterity, plan_even
from trocar.sutures.drive import Suture, drive
from trocar.sutures.plan import check_count
from trocar.sutures.plan_file import PlannedSutures
from trocar.sutures.primitive import grasp_pose
from trocar.sutures.reach import plan_out_of_reach

ON_TARGET_M = 1.0e-3
"""Where the needle goes in and comes out may be off by this (assumed; FLS marks off the suture's dots by the mm)."""

TOUCH_M = 0.5e-3
"""The tip has gone in when it is deeper than this."""

SLIP_M, SLIP_RAD = 0.5e-3, math.radians(10.0)
"""A needle that moves more than this in closed jaws has slipped (assumed)."""

SIMULATED_ARM = "psm-classic"
"""The arm whose cables were identified."""

DIRECTIONS_BY_NAME = {"best": None, "clockwise": CLOCKWISE, "counterclockwise": COUNTERCLOCKWISE}

PRESET, DIRECTION, SUTURES = "default", "best", 4
"""What is driven where nothing is said."""

ROOM = np.array([0.05, 0.05, 0.005, 0.40, 0.30, 0.30])
"""How far the calibration's motion goes beyond the plan's joints, rad and m: room for the corrections."""


@dataclass(frozen=True)
class SutureScore:
    """One suture as the referee saw it; lengths in m.

    Attributes:
        theta_deg: where on the circle.
        direction: 1 clockwise, -1 counterclockwise.
        attempted: the arm set out to drive it.
        succeeded: driven to its end, in and out within ``ON_TARGET_M``, no slip.
        failure: name of the outcome that ended it, empty after a success.
        reason: a sentence, where there is one.
        start_s: on the trial's clock.
        end_s: likewise.
        steps: how many steps of the primitive were begun.
        entry_error_m: from the planned point of entry to the true one, on the surface; None if it never went in.
        exit_error_m: likewise where it comes out.
        tip_rms_m: distance of the needle's tip from its planned path while it was driven; None if it was not.
        tip_max_m: the largest.
        slip_m: largest movement of the grasped point in closed jaws.
        slip_rad: largest turn of the needle in closed jaws.
    """

    theta_deg: float
    direction: int
    attempted: bool
    succeeded: bool
    failure: str
    reason: str
    start_s: float
    end_s: float
    steps: int
    entry_error_m: float | None
    exit_error_m: float | None
    tip_rms_m: float | None
    tip_max_m: float | None
    slip_m: float
    slip_rad: float


@dataclass(frozen=True)
class CircleSutures:
    """The task, apart from how it is done: the best even plan of a preset, or any plan that is given.

    Attributes:
        variant: so far ``single-arm``: one arm drives the needle; a person pulls it out and loads it again.
        preset: name in ``PRESETS`` of setup and reward; ``PRESET`` unless a plan is given.
        direction: ``best``, or one that all sutures must take, whether the joints allow it or not; likewise.
        sutures: how many, evenly spaced; ``SUTURES``, or those of the plan that is given.
        planned: a plan of any setup.
        budget_s: a trial that takes longer is stopped.
    """

    variant: str = "single-arm"
    preset: str | None = None
    direction: str | None = None
    sutures: int | None = None
    planned: PlannedSutures | None = None
    budget_s: float = 600.0

    name = "suture"
    variants = ("single-arm",)
    arm = "psm1"
    stop_at_limits = True
    compares_joints = True

    def __post_init__(self) -> None:
        if self.planned is None:
            for name, usual in (("preset", PRESET), ("direction", DIRECTION), ("sutures", SUTURES)):
                if getattr(self, name) is None:
                    object.__setattr__(self, name, usual)
        for what, value, choices in (
            ("variant", self.variant, self.variants),
            ("preset", self.preset, tuple(PRESETS)),
            ("direction", self.direction, tuple(DIRECTIONS_BY_NAME)),
        ):
            if value is not None and value not in choices:
                raise TrocarError(f"{what} {value!r} of suture is unknown; choose one of {', '.join(choices)}")
        if self.sutures is not None:
            check_count(self.sutures)
        if self.planned is not None:
            self._keep_to(self.planned)
        what = f"preset {self.preset!r}" if self.preset else "the plan"
        if self.setup.arm.name != SIMULATED_ARM:
            raise TrocarError(
                f"{what} is for {self.setup.arm.name!r}; the simulated cell has {SIMULATED_ARM!r}"
                + ("" if self.preset else f": plan with --arm {SIMULATED_ARM}")
            )
        if not self.setup.grasp.holdable:
            can = ", ".join(name for name, preset in PRESETS.items() if preset.setup.grasp.holdable)
            raise TrocarError(
                f"{what} cannot be driven: its wire stands "
                f"{math.degrees(self.setup.grasp.out_of_jaws_rad):.0f} deg out of the plane in which flat jaws meet; "
                + (f"choose one of {can}" if self.preset else "plan with --grasp-skew-deg 0")
            )

    def _keep_to(self, planned: PlannedSutures) -> None:
        """Raise a sentence if something else is asked for than what is planned; count its sutures."""
        for what in ("preset", "direction"):
            if getattr(self, what) is not None:
                raise TrocarError(f"{what} {getattr(self, what)!r} cannot be combined with a plan; give one of both")
        count = len(planned.sutures)
        if self.sutures not in (None, count):
            raise TrocarError(f"the number of sutures is {self.sutures}, but the plan has {count}; give one of both")
        object.__setattr__(self, "sutures", count)

    @property
    def setup(self) -> SutureSetup:
        """Return the geometry: the plan's or the preset's."""
        return self.planned.setup if self.planned else PRESETS[self.preset or PRESET].setup

    @property
    def T_world_base(self) -> Mapping[str, SE3]:
        """Return where the arm stands."""
        return {self.arm: self.setup.T_world_base}

    @property
    def T_world_board(self) -> SE3:
        """Return where the circle is marked."""
        return self.setup.circle.T_world_circle

    @cached_property
    def plan(self) -> PlannedSutures:
        """Return the plan that was given, or the best even plan of the preset."""
        if self.planned:
            return self.planned
        count = self.sutures or SUTURES
        best = plan_even(dexterity(self.setup, PRESETS[self.preset or PRESET].reward, 360 - 360 % count), count)
        return PlannedSutures(self.setup, best.positions_rad, best.directions)

    @cached_property
    def work(self) -> tuple[Suture, ...]:
        """Return the sutures of the plan, in the forced direction where there is one."""
        forced = DIRECTIONS_BY_NAME[self.direction or DIRECTION]
        return tuple(replace(suture, direction=forced or suture.direction) for suture in self.plan.sutures)

    @property
    def excitation(self) -> MotionBox:
        """Return where a calibration's motion should go: everywhere that the plan goes, and a little beyond.

        Raises:
            TrocarError: the plan is out of reach, and leaves no room to move in.
        """
        q = np.concatenate([stretch.q for suture in self.work for stretch in drive(suture)])
        arm = self.setup.arm
        inside = (arm.lower + 1e-3, arm.upper - 1e-3)
        q = q[np.isfinite(q).all(1)]
        lower = np.clip(q.min(0, initial=np.inf) - ROOM, *inside)
        upper = np.clip(q.max(0, initial=-np.inf) + ROOM, *inside)
        if not (lower < upper).all():
            raise TrocarError(plan_out_of_reach(self.setup, self.plan))
        return MotionBox(lower, upper, PSM1_BOX.step)

    def scene(self, rng: np.random.Generator) -> SutureScene:
        """Return the phantom where the plan expects it; nothing is drawn from ``rng`` so far."""
        del rng
        needle = self.setup.needle
        return SutureScene(
            self.setup.circle.T_world_circle,
            self.setup.circle.radius_m,
            needle.radius_m,
            needle.arc_rad,
            needle.wire_m,
            grasp_pose(self.setup).inverse(),
        )

    def score(self, events: Sequence[Mapping[str, object]], truth: NeedleTruth) -> list[SutureScore]:
        """Return one score for each suture that the script noted, judged by where needle and jaws really were."""
        return [_score(self.work[int(e["suture"])], e, events, truth) for e in events if e["name"] == "suture"]  # type: ignore[call-overload]


def _score(
    suture: Suture, event: Mapping[str, object], events: Sequence[Mapping[str, object]], truth: NeedleTruth
) -> SutureScore:
    start_s, end_s = float(event["start_s"]), float(event["time_s"])  # type: ignore[arg-type]
    steps = [e for e in events if e["name"] == "step" and e["suture"] == event["suture"]]
    begins = [float(e["time_s"]) for e in steps]  # type: ignore[arg-type]
    spans = list(zip([str(e["step"]) for e in steps], begins, [*begins, end_s][1:], strict=True))
    tips = truth.p_circle_needle_tip_m
    driven = [truth.rows(a, b) for step, a, b in spans if drives(step)]
    off = [path_distance_m(tips[rows], suture.needle_path_m) for rows in driven]
    distance = np.concatenate(off) if off else np.zeros(0)
    slips = [slip(truth, *between) for between in held(spans)]
    whole = truth.rows(begins[0] if begins else start_s, end_s)
    entry, exit_ = crossings(tips[whole])
    entry_error = _apart(entry, suture.entry_m)
    exit_error = _apart(exit_, suture.exit_m)
    slip_m = max((s[0] for s in slips), default=0.0)
    slip_rad = max((s[1] for s in slips), default=0.0)
    outcome = str(event["outcome"])
    failure = "" if outcome == Outcome.DONE.name else outcome
    if not failure and (slip_m > SLIP_M or slip_rad > SLIP_RAD):
        failure = Outcome.NEEDLE_SLIPPED.name
    if not failure and not on_target(entry_error, exit_error, suture):
        failure = Outcome.OFF_TARGET.name
    return SutureScore(
        round(math.degrees(suture.theta_rad), 6),
        suture.direction,
        True,
        not failure,
        failure,
        str(event["reason"]),
        start_s,
        end_s,
        sum(drives(str(step["step"])) or str(step["step"]).startswith("regrasp") for step in steps),
        entry_error,
        exit_error,
        float(np.sqrt(np.mean(distance**2))) if len(distance) else None,
        float(distance.max()) if len(distance) else None,
        slip_m,
        slip_rad,
    )


def held(spans: Sequence[tuple[str, float, float]]) -> list[tuple[float, float]]:
    """Return from when to when the jaws were closed on the needle, of steps (name, start, end) in order."""
    found: list[tuple[float, float]] = []
    open_before = True
    for step, start_s, end_s in spans:
        opens = step.startswith(("regrasp", "withdraw", "rise"))
        if not opens:
            found = [*found, (start_s, end_s)] if open_before else [*found[:-1], (found[-1][0], end_s)]
        open_before = opens
    return found


def drives(step: str) -> bool:
    """Return whether the jaws move the needle through the tissue in this step."""
    return step.startswith(("penetrate", "rotate", "push"))


def on_target(entry_error_m: float | None, exit_error_m: float | None, suture: Suture) -> bool:
    """Return whether the needle went in and came out where it should."""
    went_in = entry_error_m is not None and entry_error_m <= ON_TARGET_M
    came_out = exit_error_m is not None and exit_error_m <= ON_TARGET_M
    return went_in and (came_out or suture.exit_m is None)


def crossings(
    tips_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return where (3,) the tip's path (n, 3) first goes below z = 0, and where it next comes up again.

    A dip shallower than ``TOUCH_M`` is no entry: between two steps the tip rests on the surface and trembles.
    """
    below = tips_m[:, 2] < 0.0
    down = np.flatnonzero(~below[:-1] & below[1:])
    up = np.flatnonzero(below[:-1] & ~below[1:])
    for start in down:
        later = up[up > start]
        end = int(later[0]) if len(later) else len(tips_m) - 1
        if tips_m[start : end + 1, 2].min() < -TOUCH_M:
            return _at_surface(tips_m, int(start)), (_at_surface(tips_m, end) if len(later) else None)
    return None, None


def _at_surface(tips_m: NDArray[np.float64], row: int) -> NDArray[np.float64]:
    first, second = tips_m[row], tips_m[row + 1]
    return first + (second - first) * first[2] / (first[2] - second[2])


def _apart(found: NDArray[np.float64] | None, planned: NDArray[np.float64] | None) -> float | None:
    return None if found is None or planned is None else float(np.linalg.norm(found - planned))


def path_distance_m(points_m: NDArray[np.float64], path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (n,) of points (n, 3) from a path through (k, 3) points, straight between them."""
    start, step = path_m[:-1], np.diff(path_m, axis=0)
    since = points_m[:, None] - start
    share = np.clip((since * step).sum(-1) / np.maximum((step * step).sum(-1), 1e-30), 0.0, 1.0)
    return np.linalg.norm(since - share[..., None] * step, axis=-1).min(axis=1)


def slip(truth: NeedleTruth, start_s: float, end_s: float) -> tuple[float, float]:
    """Return how far the needle moved (at the jaws, m) and turned (rad) in the jaws between two times, at most."""
    rows = truth.rows(start_s, end_s)
    T_tip_needle = SE3(truth.T_circle_tip.matrix[rows]).inverse() @ SE3(truth.T_circle_needle.matrix[rows])
    if len(T_tip_needle.matrix) < 2:
        return 0.0, 0.0
    # the point of the needle that was between the jaws at first, where it is in the jaws later
    p_needle = T_tip_needle[0].inverse().apply([0.0, 0.0, 0.0])
    moved = np.linalg.norm(T_tip_needle.apply(p_needle), axis=-1)
    turned = np.linalg.norm((T_tip_needle[0].rotation.inverse() @ T_tip_needle.rotation).log(), axis=-1)
    return float(moved.max()), float(turned.max())
