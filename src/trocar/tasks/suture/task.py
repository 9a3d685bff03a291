"""The suture task: sutures round a circle, each driven along the needle primitive as planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from trocar.calibration.excitation import PSM1_BOX, MotionBox
from trocar.errors import InvalidInput, OutOfReach, UnknownName
from trocar.eval import Method, Task, check_budget, option
from trocar.geometry import SE3, shown
from trocar.lab import Station, load_station
from trocar.registry import Lazy
from trocar.tasks.suture.planning import (
    CLOCKWISE,
    COUNTERCLOCKWISE,
    PRESETS,
    Preset,
    Suture,
    SutureSetup,
    dexterity,
    plan_even,
)
from trocar.tasks.suture.planning.plan import PlannedSutures, check_count, load_plan
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.planning.segments import suture_segments
from trocar.tasks.suture.planning.settings import preset_of
from trocar.tasks.suture.planning.summary import plan_out_of_reach
from trocar.tasks.suture.planning.two_arms import TwoArmPlan, plan_pulled, plan_two_arms
from trocar.tasks.suture.scene import NEEDLE, SutureScene
from trocar.tasks.suture.score import NeedleTruth, SutureScore, score_sutures
from trocar.tasks.suture.variants import SINGLE, STATIONS, TWO, pair_of

if TYPE_CHECKING:
    from trocar.sim.world import TaskWorld

DIRECTIONS_BY_NAME = {"best": None, "clockwise": CLOCKWISE, "counterclockwise": COUNTERCLOCKWISE}

PRESET, DIRECTION, SUTURES = "default", "best", 4
"""Defaults of the plan."""
ROOM = np.array([0.05, 0.05, 0.005, 0.40, 0.30, 0.30])
"""How far the calibration motion goes beyond the plan's range of each joint, rad and m, to cover corrections."""
_AGENTS = "trocar.tasks.suture.agents"
_LOOKING = {
    "agent": Lazy(f"{_AGENTS}:agent_of"),
    "settings": Lazy(f"{_AGENTS}.circle:Settings"),
    "stop_at_limits": True,
}
_BLIND = {**_LOOKING, "settings": Lazy(f"{_AGENTS}.circle:blind")}
_WORLD = Lazy("trocar.tasks.suture.world:SutureWorld")


@dataclass(frozen=True)
class CircleSutures(Task):
    """Drive the best even plan of a preset, or any given plan."""

    variant: str = option(
        SINGLE,
        "Who does it: one arm, for which a person loads the needle and pulls it out, or two arms and no person.",
        choices=tuple(STATIONS),
    )
    preset: str | None = option(
        None,
        f"Setup and reward of the plan: {', '.join(PRESETS)}, or a setup file (.toml) (default: {PRESET}).",
        metavar="NAME",
    )
    direction: str | None = option(
        None,
        "Direction: all clockwise or counterclockwise, even beyond a limit; or best: the better for each (default).",
        choices=tuple(DIRECTIONS_BY_NAME),
    )
    sutures: int | None = option(None, f"How many, evenly spaced (default: {SUTURES}).", flag="count", metavar="N")
    plan_file: Path | None = option(
        None,
        "Drive this plan of `trocar plan suture --out DIR` (the folder, its plan.json or its waypoints.json), which "
        "defines everything that a preset does.",
        flag="plan",
        metavar="PATH",
    )
    budget_s: float = option(
        600.0, "A trial that takes longer on its own clock is stopped.", flag="budget", metavar="S"
    )

    name = "suture"
    about = "sutures round a circle, driven as planned (Thananjeyan et al. 2019)"
    goal_noun = "suture"
    station = "suture"
    methods: ClassVar = {
        "calibrated": Method(
            "cables compensated by a model that was fitted in this session; a camera looks at the needle",
            calibrated=True,
            **_LOOKING,
        ),
        "blind": Method("cables compensated likewise; no looks at the needle", calibrated=True, **_BLIND),
        "uncalibrated": Method("encoder readings taken at face value; no looks at the needle", **_BLIND),
    }
    report = Lazy("trocar.tasks.suture.report.driven_sutures:SutureReport")

    _station: ClassVar[Station | None] = None
    """Station of the two arms; None: their usual station."""

    def __post_init__(self) -> None:
        if self.variant not in STATIONS:
            raise UnknownName("variant of suture", self.variant, STATIONS)
        if self.planned:
            for what, value in (("preset", self.preset), ("direction", self.direction)):
                if value is not None:
                    raise InvalidInput(f"{what} {value!r}", "cannot be combined with a plan", "give only one of them")
            count = len(self.planned.sutures)
            if self.sutures not in (None, count):
                raise InvalidInput(
                    "the number of sutures", f"is {self.sutures}, but the plan has {count}", "give only one of them"
                )
            object.__setattr__(self, "sutures", count)
        else:
            for name, usual in (("preset", PRESET), ("direction", DIRECTION), ("sutures", SUTURES)):
                if getattr(self, name) is None:
                    object.__setattr__(self, name, usual)
        if self.direction is not None and self.direction not in DIRECTIONS_BY_NAME:
            raise UnknownName("the direction", self.direction, DIRECTIONS_BY_NAME)
        check_count(self.sutures or 0)
        check_budget(self.budget_s)
        grasp = self.setup.grasp
        if not grasp.holdable:
            can = ", ".join(name for name, preset in PRESETS.items() if preset.setup.grasp.holdable)
            out = shown(grasp.out_of_jaws_rad, "rad", ".0f")
            problem = f"cannot be driven: its wire stands {out} out of the plane in which flat jaws meet"
            remedy = f"choose one of {can}" if self.preset else "plan with --set grasp_skew_deg=0"
            raise InvalidInput(self._plan_in_words, problem, remedy)

    @property
    def _plan_in_words(self) -> str:
        return f"preset {self.preset!r}" if self.preset else "the plan"

    def options(self) -> dict[str, Any]:
        """Return the options; a plan or preset from a file is given by its content, because the file may change."""
        if self.planned or self.preset not in PRESETS:
            return super().options() | {"preset": None, "plan_file": self.plan.values()}
        return super().options()

    @cached_property
    def planned(self) -> PlannedSutures | None:
        """Return the plan from the given file; None if none is given."""
        return load_plan(self.plan_file) if self.plan_file else None

    @property
    def setup(self) -> SutureSetup:
        """Return the geometry: the plan's or the preset's."""
        return self.planned.setup if self.planned else self._chosen.setup

    @cached_property
    def _chosen(self) -> Preset:
        return preset_of(self.preset or PRESET)

    @cached_property
    def plan(self) -> PlannedSutures:
        """Return the given plan, or the preset's best even plan (of those that the second arm, if any, can pull)."""
        if self.planned:
            return self.planned
        count = self.sutures or SUTURES
        planner, positions = partial(plan_even, count=count), 360 - 360 % count
        if self.with_two_arms:
            station = self._station or load_station(self.usual_station)
            map, best = plan_pulled(self._chosen, planner, positions, *pair_of(station))
        else:
            map = dexterity(self.setup, self._chosen.reward, positions)
            best = planner(map)
        return PlannedSutures(map.setup, best.positions_rad, best.directions)

    def done_at(self, station: Station) -> CircleSutures:
        """Return the task; if two arms sew and no plan is given, planned for the second arm of this station."""
        if self.planned or not self.with_two_arms:
            return self
        self._require_pair(station)
        there = replace(self)
        object.__setattr__(there, "_station", station)
        return there

    @property
    def usual_station(self) -> str:
        """Return the station of the variant."""
        return STATIONS[self.variant]

    @property
    def with_two_arms(self) -> bool:
        """Return whether a second arm pulls the needle through."""
        return self.variant == TWO

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the first arm, or the first two."""
        return tuple(station.arms)[: 2 if self.with_two_arms else 1]

    def at(self, station: Station) -> Station:
        """Return the station with the circle and the driving arm's base where the plan has them."""
        if self.with_two_arms:
            self._require_pair(station)
        name = self.working_arms(station)[0]
        arm = station.arm(name)
        if arm.model.name != self.setup.arm.name:
            there = f"arm {name!r} of station {station.name!r} is {arm.model.name!r}"
            remedy = "" if self.preset else f"plan with --arm {arm.model.name}"
            raise InvalidInput(self._plan_in_words, f"is for {self.setup.arm.name!r}, but {there}", remedy)
        arms = dict(station.arms) | {name: replace(arm, T_world_base=self.setup.T_world_base)}
        fixtures = dict(station.T_world_fixture) | {"circle": self.setup.circle.T_world_circle}
        return replace(station, arms=arms, T_world_fixture=fixtures)

    def _require_pair(self, station: Station) -> None:
        there = f"station {station.name!r}"
        if len(station.arms) < 2:
            raise InvalidInput(there, f"has one arm, and suture --variant {TWO} needs two", "add one")
        if "stand" not in station.T_world_fixture:
            raise InvalidInput(there, f"has no fixture 'stand', which suture --variant {TWO} needs", "add it")

    def goals(self) -> tuple[Suture, ...]:
        """Return the sutures of the plan, in the forced direction if there is one."""
        forced = DIRECTIONS_BY_NAME[self.direction or DIRECTION]
        return tuple(replace(suture, direction=forced or suture.direction) for suture in self.plan.sutures)

    def calibration(self, station: Station, arm: str) -> MotionBox:
        """Return the calibration motion's box: the plan's range of each joint, widened by ``ROOM``.

        Raises:
            OutOfReach: the plan is out of reach, so that no range is left.
        """
        ways = [segment.q for suture in self.goals() for segment in suture_segments(suture)]
        if self.with_two_arms:
            first, second = self.plan_with(station).joints()
            ways = [second] if arm != self.working_arms(station)[0] else [*ways, first]
        q = np.concatenate(ways)
        model = station.arm(arm).model
        inside = (model.lower + 1e-3, model.upper - 1e-3)
        q = q[np.isfinite(q).all(1)]
        lower = np.clip(q.min(0, initial=np.inf) - ROOM, *inside)
        upper = np.clip(q.max(0, initial=-np.inf) + ROOM, *inside)
        if not (lower < upper).all():
            raise OutOfReach(plan_out_of_reach(self.plan.sutures), arm=arm)
        return MotionBox(lower, upper, PSM1_BOX.step)

    def plan_with(self, station: Station) -> TwoArmPlan:
        """Return what two arms do between the sutures, at a station that :meth:`at` returned.

        Raises:
            OutOfReach: an arm cannot do its part.
        """
        home_q, puller = pair_of(station)
        setup = replace(self.setup, T_world_base=station.arm(self.working_arms(station)[0]).T_world_base)
        sutures = [replace(suture, setup=setup) for suture in self.goals()]
        cameras = [camera.T_world_camera for camera in station.cameras.values()]
        return plan_two_arms(sutures, home_q, puller, station.T_world_fixture["stand"], cameras)

    def scene(self, rng: np.random.Generator, station: Station) -> tuple[SutureScene, tuple[str, ...]]:
        """Return the phantom where the plan expects it, how a person places the needle, and the arms that work."""
        sd = np.repeat(station.difficulty.values(NEEDLE), 3)
        loaded = tuple(SE3.exp(sd * rng.standard_normal(6)) for _ in self.goals())
        T_world_circle, T_tip_needle = station.T_world_fixture["circle"], grasp_pose(self.setup).inverse()
        stand = station.T_world_fixture["stand"] if self.with_two_arms else None
        circle = (T_world_circle, self.setup.circle.radius_m)
        return SutureScene(*circle, self.setup.needle, T_tip_needle, loaded, stand), self.working_arms(station)

    def world(self, scene: tuple[SutureScene, tuple[str, ...]]) -> TaskWorld:
        """Return phantom, needle and referee."""
        lies, arms = scene
        return _WORLD.load()(lies, *arms)

    def score(self, truth: NeedleTruth, events: Sequence[Mapping[str, Any]]) -> list[SutureScore]:
        """Return one score for each suture of the plan."""
        return score_sutures(self.goals(), truth, events)
