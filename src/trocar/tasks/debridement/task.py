"""Debridement: move every fragment of damaged tissue from the work surface to a receptacle (Kehoe 2014, III)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from trocar.calibration.excitation import MotionBox
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval import Method, Task, check_budget, option
from trocar.lab import Station, StationArm
from trocar.perception.image import StereoRig
from trocar.registry import Lazy
from trocar.tasks.debridement.goals import Clearing, Workspace
from trocar.tasks.debridement.scene import DebridementScene, lay_out
from trocar.tasks.debridement.score import FragmentScore, score_fragments
from trocar.tasks.debridement.truth import DebridementTruth

if TYPE_CHECKING:
    from trocar.sim.world import TaskWorld

MOST_FRAGMENTS = 12  # more would not fit into the region where fragments lie
BACKDROPS = ("plain", "tissue")
FIXTURES = ("table", "receptacle")
CAMERA = "stereo"

SWING = np.array([0.12, 0.12, 0.02, 0.60, 0.40, 0.40])
"""Range of the calibration motion about the parked joints, rad and m (assumed: above the work surface)."""
PACE = np.array([0.010, 0.010, 0.0015, 0.06, 0.05, 0.05])
"""Mean step of this motion from sample to sample, rad and m, about as in the recordings of the PSM."""

REGION_M = {1: ((-0.092, -0.092), (-0.017, -0.046)), 2: Workspace.region_m}
"""Region of the fragments, corners x, y in the world, by the number of arms. A working arm reaches it with its gripper
straight down in at least nine of ten sessions, despite kinematic errors of centimetres
(``tests/tasks/debridement/test_task.py`` draws 24 sessions; assumed: a person lays the fragments there)."""
WITHDRAWN_M = 0.10  # a person withdraws an idle arm into its port by this distance, out of the way

_METHOD = {
    "agent": Lazy("trocar.tasks.debridement.agents:DebridementAgent"),
    "calibrated": False,
    "wrap_robot": Lazy("trocar.tasks.debridement.agents:with_adjustment"),
    "planner": "convex",
    "perception": "stereo",
}
_WORLD = Lazy("trocar.tasks.debridement.world:DebridementWorld")


@dataclass(frozen=True)
class Debridement(Task):
    """Clearing of randomly scattered foam fragments into one receptacle, by one arm or by two at once."""

    arms: int = option(2, "How many arms work, 1 or 2; with 1 the other stays parked.", metavar="N")
    fragments: int = option(6, f"How many fragments there are, 1 to {MOST_FRAGMENTS}.", metavar="N")
    backdrop: str = option("plain", "What the fragments lie on: white, or a likeness of tissue.", choices=BACKDROPS)
    budget_s: float = option(1800.0, "A trial that takes longer is stopped.", flag="budget", metavar="S")

    name = "debridement"
    about = "fragments of foam into a receptacle, two arms at once, re-planning all the way (Kehoe et al. 2014)"
    goal_noun = "fragment"
    objects = Lazy("trocar.tasks.debridement.perception.objects:DebridementObjects")
    report = Lazy("trocar.tasks.debridement.report:DebridementReport")
    study = Lazy("trocar.tasks.debridement.report.study:DebridementStudy")
    station = "raven-pair"
    methods: ClassVar = {
        name: Method(about, settings=Lazy(f"trocar.tasks.debridement.agents.settings:{settings}"), **_METHOD)
        for name, settings, about in (
            ("best", "best", "joint errors are remembered by place, few stops, 5 cm/s"),
            ("best-1cm", "slow", "the same at the paper's 1 cm/s"),
            ("paper", "paper", "the paper's rule and program: 1 cm/s, a new plan every 2.5 cm"),
        )
    }
    perceptions: ClassVar = {"stereo": Lazy("trocar.tasks.debridement.perception.stereo_view:StereoView")}

    def __post_init__(self) -> None:
        if self.arms not in (1, 2):
            raise InvalidValue("the number of arms", self.arms, "give 1 or 2 with --arms")
        if not 1 <= self.fragments <= MOST_FRAGMENTS:
            remedy = f"give 1 to {MOST_FRAGMENTS} with --fragments"
            raise InvalidValue("the number of fragments", self.fragments, remedy)
        if self.backdrop not in BACKDROPS:
            raise UnknownName("backdrop", self.backdrop, BACKDROPS)
        check_budget(self.budget_s)

    @property
    def variant(self) -> str:  # type: ignore[override]
        """Return how many arms work."""
        return ("one-arm", "two-arms")[self.arms - 1]

    def at(self, station: Station) -> Station:
        """Return the station with its idle arms withdrawn, after a check that it has what the task needs.

        Raises:
            InvalidInput: a fixture, the stereo camera or an arm is missing.
        """
        this = f"station {station.name!r}"
        for fixture in FIXTURES:
            if fixture not in station.T_world_fixture:
                raise InvalidInput(this, f"has no fixture {fixture!r}, which debridement needs", "add it")
        camera = station.cameras.get(CAMERA)
        if camera is None or not isinstance(camera.model, StereoRig):
            raise InvalidInput(this, f"has no camera {CAMERA!r} with two eyes, which debridement needs", "add it")
        if len(station.arms) < self.arms:
            raise InvalidInput(this, f"has one arm, and debridement --arms {self.arms} needs two", "add one")
        idle = {name: _withdrawn(arm) for name, arm in list(station.arms.items())[self.arms :]}
        return replace(station, arms={**station.arms, **idle})

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the first arm, or the first two."""
        return tuple(station.arms)[: self.arms]

    def calibration(self, station: Station, arm: str) -> MotionBox:
        """Return the range that the station defines, else one round the parked joints."""
        there = station.arm(arm)
        if there.calibration is not None:
            return there.calibration
        q, model = there.park_q(), there.model
        return MotionBox(np.maximum(q - SWING, model.lower + 1e-3), np.minimum(q + SWING, model.upper - 1e-3), PACE)

    def goals(self) -> tuple[Clearing, ...]:
        """Return one goal for each fragment, in the order in which they are cleared."""
        return tuple(Clearing(number) for number in range(self.fragments))

    def nominal(self) -> Workspace:
        """Return the receptacle's shape, and the region of the fragments."""
        return Workspace(fragments=self.fragments, region_m=REGION_M[self.arms])

    def scene(self, rng: np.random.Generator, station: Station) -> DebridementScene:
        """Return fragments scattered at random, and the receptacle slightly off its place."""
        table, receptacle = (station.T_world_fixture[name] for name in FIXTURES)
        scene = lay_out(table, receptacle, self.nominal(), rng, self.backdrop)
        camera = station.cameras[CAMERA]
        assert isinstance(camera.model, StereoRig)  # ``at`` has checked it
        right = camera.T_world_camera @ camera.model.T_left_right
        return replace(scene, p_world_eyes_m=np.stack([camera.T_world_camera.translation_m, right.translation_m]))

    def world(self, scene: DebridementScene) -> TaskWorld:
        """Return work surface, receptacle, fragments and referee."""
        return _WORLD.load()(scene)

    def score(self, truth: DebridementTruth, events: Sequence[Mapping[str, Any]]) -> list[FragmentScore]:
        """Return one score for each fragment, in the order in which they were cleared."""
        return score_fragments(truth, events)


def _withdrawn(arm: StationArm) -> StationArm:
    """Return an arm parked as high in its port as its range allows, up to ``WITHDRAWN_M`` above its usual place."""
    q, model = arm.park_q(), arm.model
    back = q.copy()
    back[2] = np.clip(q[2] + model.wrist_sign * WITHDRAWN_M, model.lower[2] + 1e-3, model.upper[2] - 1e-3)
    return replace(arm, park=back)
