"""Look at the needle while it is driven: plan the looks, estimate its pose from them, and correct the arm's path."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik_unbounded, ik_with_fixed_wrist
from trocar.arms.inverse import OUTER
from trocar.cell import Cell
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, RgbdImage, Window
from trocar.perception.instrument_solids import InstrumentSolids
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.needle_estimator import TAKING, NeedleEstimate, NeedleEstimator
from trocar.tasks.suture.perception import NeedleSighting, floor_height_m, search_starts, sight_needle
from trocar.tasks.suture.planning.primitive import driven_steps, grasp_pose
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.planning.setup import SutureSetup

if TYPE_CHECKING:
    from trocar.tasks.suture.agents.circle import Settings

MISLOADED_M, MISLOADED_RAD = 2.5e-3, 0.25
"""A needle that lies this far from where a person should have put it is loaded again."""
ROUND_PX = 32
"""Margin around the needle of the window that is read out."""
BEFORE_ENTRY_M = 2e-3
"""Distance from the tissue, along the needle's path, at which the last looks before the entry take place."""
PAST_ENTRY_M = 2.5e-3
"""From there the tip goes in this far without a pause and with the wrist at rest: reversing cables would move it just
at the entry. Also, unrepeatable errors change within a second: the sooner the tip is there, the better the last look
still holds."""
BEFORE_EXIT_RAD, WELL_BEFORE_EXIT_RAD = np.radians(8.0), np.radians(16.0)
"""Rotation of the needle left before its tip comes out, at the last looks and at one look before them. That one is
needed because cable errors after a regrasp may bring the tip out early."""
AT_SURFACE = 0.4
"""Share of the stretch after the last looks, into the tissue or out of it, that lies before the surface: by its end,
the tip is on the corrected path."""
HIGH_LOOKS, ENTRY_LOOKS, EXIT_LOOKS = 2, 4, 3
"""Maximum number of looks above the tissue, just before the needle goes in, and just before it comes out."""
FINDING_LOOKS = 3
"""Maximum number of looks in one call of ``find``."""


class Aim(Enum):
    """What a correction before a stretch of the path applies to."""

    POSE = "position and attitude"
    TIP = "the needle's tip alone, by the outer joints: turning the wrist again would reverse its cables"


@dataclass(frozen=True)
class Stretch:
    """A part of the path without a look.

    Attributes:
        segment: the path to follow.
        first: whether it is the first of its step.
        looks: maximum number of looks at the needle before it. If more than one is allowed, the arm goes to the
            stretch's corrected start after each; otherwise it joins the corrected path on the way.
        aim: what is corrected.
        fixed_wrist: whether the wrist does not move at all.
    """

    segment: Segment
    first: bool = True
    looks: int = 0
    aim: Aim = Aim.POSE
    fixed_wrist: bool = False


def stretches(segments: Sequence[Segment], setup: SutureSetup, to_the_end: bool = False) -> list[Stretch]:
    """Return the path divided at the looks: above and before the entry, in each grip, before the exit.

    Once the tip is out, the needle is looked at only if its pose matters ``to_the_end``.

    The arm stops at the surface neither on the way in nor on the way out: as it starts again, the cables would take up
    their play just where the position of the needle's tip counts.
    """
    exit_rad = setup.exit_turn_rad
    steps = {step.name: step for step in driven_steps(setup)}
    found: list[Stretch] = []
    for segment in segments:
        step = steps.get(segment.name)
        if segment.name == "approach":
            share = 1.0 - BEFORE_ENTRY_M / max(segment.length_m, BEFORE_ENTRY_M)
            found += _cut(Stretch(segment, looks=HIGH_LOOKS), share, ENTRY_LOOKS)
        elif step is None or segment.name == "penetrate":
            found.append(Stretch(segment))
        elif step.holds:
            start, end = step.needle_rad
            whole = Stretch(segment, looks=int(segment.name != "rotate" and (start <= exit_rad or to_the_end)))
            last = exit_rad - BEFORE_EXIT_RAD
            before, *after = _cut(whole, (last - start) / (end - start), EXIT_LOOKS)
            if after:
                after = [*_cut(before, (exit_rad - WELL_BEFORE_EXIT_RAD - start) / (last - start), 1), *after]
            found += after or [before]
        else:
            found.append(Stretch(segment, looks=1 if step.needle_rad[0] < exit_rad else 0))
    return _joined_at_entry(found)


def _cut(whole: Stretch, share: float, looks: int) -> list[Stretch]:
    """Return a stretch divided at a share of its length, with looks in between; whole if the share is outside it."""
    segment = whole.segment
    steps = len(segment.q) - 1
    place = round(share * steps) if np.isfinite(share) else 0
    if not 0 < place < steps:
        return [whole]
    before = replace(segment, q=segment.q[: place + 1], length_m=segment.length_m * place / steps)
    after = replace(segment, q=segment.q[place:], length_m=segment.length_m - before.length_m)
    return [replace(whole, segment=before), Stretch(after, first=False, looks=looks, aim=Aim.TIP)]


def _joined_at_entry(found: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches with the end of the approach, after the last looks, and the tip's entry joined into one."""
    joined: list[Stretch] = []
    for stretch in found:
        last = joined[-1] if joined else stretch
        if stretch.segment.name != "penetrate" or last.aim is not Aim.TIP:
            joined.append(stretch)
            continue
        whole, steps = stretch.segment, len(stretch.segment.q) - 1
        deep = min(steps, max(1, round(PAST_ENTRY_M / max(whole.length_m, PAST_ENTRY_M) * steps)))
        deep_m = whole.length_m * deep / steps
        q = np.concatenate([last.segment.q, whole.q[1 : deep + 1]])
        way = replace(whole, q=q, length_m=last.segment.length_m + deep_m)
        joined[-1] = replace(last, segment=way, first=True, fixed_wrist=True)
        if deep < steps:
            left = replace(whole, q=whole.q[deep:], length_m=whole.length_m - deep_m)
            joined.append(Stretch(left, first=False, aim=Aim.TIP))
    return joined


class NeedleTracker:
    """Estimates where the needle is from looks at it, and corrects the arm's path accordingly.

    Of several cameras with depth, the one nearest to the circle is used.

    Args:
        cell: cell with a camera that shows depth.
        hand: the arm.
        setup: geometry of the sutures, with the registered base and circle.
        settings: number of images per look, and the declared times to find the needle in them.
        others: other arms, which may hide the needle.

    Attributes:
        estimator: estimates the errors of the arm's tip and of the needle in its jaws.
        setup: geometry in which the needle was last grasped.
        seen: whether the last look saw the needle, and the estimator accepted it.
        T_base_floor: the plane over which the needle is seen, z up; by default the circle's.
        camera: the camera for the looks.
        T_base_camera: its pose: as registered, then corrected by the floor that looks show.

    Raises:
        InvalidInput: no camera shows depth.
    """

    def __init__(
        self,
        cell: Cell,
        hand: ArmScript,
        setup: SutureSetup,
        settings: Settings,
        others: Sequence[ArmScript] = (),
    ):
        lenses = {name: lens for name, camera in cell.cameras.items() if isinstance(lens := camera.model, Intrinsics)}
        if not lenses:
            raise InvalidInput("no camera of this cell", "shows depth, to look at the needle", "choose --method blind")
        T_world_camera, p_circle_m = cell.T_world_camera_registered, cell.T_world_fixture["circle"].translation_m
        nearest = min(lenses, key=lambda name: np.linalg.norm(T_world_camera[name].translation_m - p_circle_m))
        self.camera, self._lens, self._camera_name = cell.cameras[nearest], lenses[nearest], nearest
        self.T_base_camera = cell.T_world_base_registered[hand.name].inverse() @ T_world_camera[nearest]
        self._log, self._hand, self.setup, self._settings = cell.log, hand, setup, settings
        holds = [step for step in driven_steps(setup) if step.holds and step.name != "penetrate"]
        self._back_rad = [step.back_rad for step in holds]
        self._now_s = cell.clock.now_s
        self.estimator = NeedleEstimator(self._hand.model, self._now_s)
        self.T_base_floor = setup.T_base_circle
        T_world_base = cell.T_world_base_registered
        self._to_others = {o: T_world_base[o.name].inverse() @ T_world_base[hand.name] for o in others}
        self._grips, self.seen = 0, False
        self._tip_error, self._T_tip_needle = np.zeros(6), self.T_tip_needle_planned
        self._aim, self._fixed_wrist = Aim.POSE, False

    def loaded(self) -> None:
        """Note that a person has loaded the needle."""
        self._grips, self.seen = 0, False
        self.estimator.loaded(self.T_tip_needle_planned)

    def rests(self, needle: NeedleEstimate) -> None:
        """Note that something other than the jaws holds the needle still, about here in the arm's base."""
        self.estimator.resting(needle)
        self.seen = False

    def took(self, setup: SutureSetup) -> None:
        """Note that the jaws have closed, in this setup's grasp, on a needle that something else held."""
        self.setup, self._grips = setup, 0
        self.estimator.regrasped(self._T_base_tip, self.T_tip_needle_planned, TAKING)

    @property
    def needle(self) -> NeedleEstimate:
        """Return where the needle is, in the arm's base."""
        return self.estimator.needle(self._T_base_tip)

    def towards_needle(self, segment: Segment, T_base_needle: SE3) -> Segment:
        """Return a path, planned to or from a needle at ``T_base_needle``, moved to where the needle really rests."""
        planned = fk(self._hand.model, segment.q)
        self._tip_error = self.estimator.tip_error(planned[-1])
        wanted = self.needle.T_base_needle @ T_base_needle.inverse() @ planned
        return self._reaching(segment, wanted)

    def with_needle(self, segment: Segment) -> Segment:
        """Return a path from where the arm is, on which the needle moves as planned, however it lies in the jaws."""
        T_base_tip = fk(self._hand.model, segment.q)
        planned = T_base_tip @ self.T_tip_needle_planned
        self._tip_error, self._T_tip_needle = self.estimator.tip_error(T_base_tip[-1]), self.estimator.T_tip_needle
        wanted = planned @ self._T_tip_needle.inverse()
        return self._from_here(self._reaching(segment, wanted))

    def forget(self) -> None:
        """Discard everything seen so far."""
        self.estimator = NeedleEstimator(self._hand.model, self._now_s)

    @property
    def well_loaded(self) -> bool:
        """Return whether the needle was seen in the jaws, about as a person should have put it there."""
        off = (self.T_tip_needle_planned.inverse() @ self.estimator.T_tip_needle).log()
        return self.seen and bool(np.linalg.norm(off[:3]) < MISLOADED_M and np.linalg.norm(off[3:]) < MISLOADED_RAD)

    def released(self) -> None:
        """Note that the jaws are about to open, and the tissue holds the needle."""
        self.estimator.released(self._T_base_tip)

    def gripped(self, lost: bool = False) -> None:
        """Note that the jaws have closed on the needle again: further back along it, unless they had ``lost`` it."""
        self._grips += not lost
        if self.estimator.rests:
            self.estimator.regrasped(self._T_base_tip, self.T_tip_needle_planned)

    def aim(self, stretch: Stretch) -> None:
        """Correct the path from now on by the present estimates of arm and needle."""
        self._tip_error, self._T_tip_needle = self.estimator.tip_error(self._T_base_tip), self.estimator.T_tip_needle
        self._aim, self._fixed_wrist = stretch.aim, stretch.fixed_wrist

    def path(self, stretch: Stretch) -> Segment:
        """Return the corrected segment of a stretch, from where the arm is to where it should be at the end."""
        if stretch.looks <= 1:
            self.aim(stretch)
        segment = self.corrected(stretch.segment)
        if segment.name == "lower" or len(segment.q) < 2:
            return segment
        return self._from_here(segment, AT_SURFACE if stretch.looks > 1 and stretch.aim is Aim.TIP else 1.0)

    def _from_here(self, segment: Segment, share: float = 1.0) -> Segment:
        """Return a segment that begins where the arm is, and blends into the given one over a share of its length."""
        left = np.maximum(1.0 - np.linspace(0.0, 1.0 / share, len(segment.q)), 0.0)[:, None]
        return replace(segment, q=segment.q + left * (self._hand.q - segment.q[0]))

    def corrected(self, segment: Segment) -> Segment:
        """Return the segment with the path's corrections.

        While the jaws hold the needle, the needle has to follow its planned path; otherwise, the jaws have to follow
        their planned path relative to the needle.
        """
        if not len(segment.q):
            return segment
        T_base_tip = fk(self._hand.model, segment.q)
        if not self.estimator.rests:
            if self._aim is Aim.TIP:
                with suppress(OutOfReach):
                    return replace(segment, q=self._with_planned_wrist(segment.q))
            wanted = T_base_tip @ self.T_tip_needle_planned @ self._T_tip_needle.inverse()
        else:
            planned = T_base_tip[0] @ self.T_tip_needle_planned
            wanted = self.needle.T_base_needle @ planned.inverse() @ T_base_tip
        return self._reaching(segment, wanted)

    def _with_planned_wrist(self, planned: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joints (k, 6) that take the needle's tip along its path, turning the wrist as planned and no more."""
        off, p_tip_m = self._tip_error, self.setup.needle.p_tip_m
        wanted_m = (fk(self._hand.model, planned) @ self.T_tip_needle_planned).apply(p_tip_m) - off[:3]
        q = planned.copy()
        turning = 0.0 if self._fixed_wrist else 1.0
        q[:, OUTER:] = self._hand.q[OUTER:] + turning * (planned - planned[0])[:, OUTER:]
        for _ in range(2):  # the error of the jaws' position depends on the orientation that is found
            R = fk(self._hand.model, q).rotation
            held_m = (R.inverse() @ SO3.exp(off[3:]) @ R).apply(self._T_tip_needle.apply(p_tip_m))
            places = zip(q, wanted_m, held_m, strict=True)
            q = np.array([ik_with_fixed_wrist(self._hand.model, *place) for place in places])
        return q

    def _reaching(self, segment: Segment, wanted: SE3) -> Segment:
        """Return a segment with the commands, near its joints, that bring the tip to these poses (k,) in the base."""
        off = self._tip_error
        commanded = SE3.from_parts(SO3.exp(-off[3:]) @ wanted.rotation, wanted.translation_m - off[:3])
        return replace(segment, q=ik_unbounded(self._hand.model, commanded, near=segment.q))

    async def look(self) -> bool:
        """Look at the needle, in the jaws or in the tissue; return whether it was seen but rejected."""
        await self._hand.settle()
        with self._log.span(self._hand.name, "looking"):
            before = self.needle
            window = self._window(before)
            taken = [await self.camera.capture(window) for _ in range(self._settings.images)]
        images = [image for image in taken if isinstance(image, RgbdImage)]
        starts = search_starts(before.T_base_needle, before.covariance, self.setup.needle)
        budget_s = self._settings.sighting_budget_s + (len(starts) - 1) * self._settings.start_budget_s
        seen = await self._hand.compute("perception", budget_s, partial(self._sight, images, before))
        self.seen = accepted = seen is not None and self.estimator.update(self._T_base_tip, self.T_base_camera, seen)
        if seen is not None:
            outline_m = seen.T_camera_needle.apply(self.setup.needle.outline_m)
            self._log.saw(self._camera_name, images[-1], {"needle": outline_m})
        off = (before.T_base_needle.inverse() @ self.needle.T_base_needle).log()
        tip_m = (self.setup.T_base_circle.inverse() @ self.needle.T_base_needle).apply(self.setup.needle.p_tip_m)
        self._log.event(
            "needle not seen" if seen is None else "needle seen",
            accepted=accepted,
            pixels=0 if seen is None else seen.pixels,
            off_mm=(1e3 * off[:3]).round(3).tolist(),
            off_deg=np.degrees(off[3:]).round(2).tolist(),
            tip_mm=(1e3 * tip_m).round(3).tolist(),
        )
        return seen is not None and not accepted

    async def find(self) -> bool:
        """Look until the needle is seen, searching more widely each time; return whether it was seen."""
        for _ in range(FINDING_LOOKS):
            await self.look()
            if self.seen:
                return True
            self.estimator.doubt()
        return False

    def tip_shift_m(self, q: NDArray[np.float64]) -> float:
        """Return how far the needle's tip would go if the arm went to these joints (6,)."""
        poses = (self._T_base_tip, fk(self._hand.model, q))
        now, then = (self.estimator.needle(T).T_base_needle.apply(self.setup.needle.p_tip_m) for T in poses)
        return float(np.linalg.norm(then - now))

    def _window(self, expected: NeedleEstimate) -> Window:
        """Return the rectangle of pixels round the needle."""
        needle = self.setup.needle
        wire = needle.point_m(np.linspace(0.0, needle.arc_rad, 40))
        seen = project(self._lens, (self.T_base_camera.inverse() @ expected.T_base_needle).apply(wire))
        most = np.array([self._lens.width, self._lens.height]) - 1
        lower, upper = (np.clip(at, 0, most).astype(int) for at in (seen.min(0) - ROUND_PX, seen.max(0) + ROUND_PX))
        return Window((int(lower[0]), int(lower[1])), (int(upper[0] - lower[0] + 1), int(upper[1] - lower[1] + 1)))

    def _sight(self, images: Sequence[RgbdImage], expected: NeedleEstimate) -> NeedleSighting | None:
        """Find the needle in images; the instrument may hide it."""
        self._level(images, expected)
        T_camera_base, T_base_tip = self.T_base_camera.inverse(), self._T_base_tip
        solids = [InstrumentSolids.of(hand.model, hand.q, hand.jaw_rad) for hand in (self._hand, *self._to_others)]
        T_solids_camera = [T_base_tip @ self.estimator.tip(T_base_tip).inverse() @ self.T_base_camera]
        T_solids_camera += [T_other_base @ self.T_base_camera for T_other_base in self._to_others.values()]

        def distance_m(points: NDArray[np.float64]) -> NDArray[np.float64]:
            """Return how far points (n, 3) in the camera's frame are from the nearest instrument."""
            each = zip(solids, T_solids_camera, strict=True)
            return np.min([solid.distance_m(T.apply(points)) for solid, T in each], axis=0)

        return sight_needle(
            images,
            T_camera_base @ expected.T_base_needle,
            expected.covariance,
            self.setup.needle,
            T_camera_base @ self.T_base_floor,
            distance_m,
        )

    def _level(self, images: Sequence[RgbdImage], expected: NeedleEstimate) -> None:
        """Correct the camera's height by the floor that it shows; an error there moves the entry 1.7 times as much."""
        T_camera_base = self.T_base_camera.inverse()
        places = T_camera_base @ expected.T_base_needle, self.setup.needle, T_camera_base @ self.T_base_floor
        if (height_m := floor_height_m(images, *places)) is not None:
            up = self.T_base_floor.rotation.matrix[:, 2]
            self.T_base_camera = SE3.from_parts(translation_m=-height_m * up) @ self.T_base_camera

    @property
    def _T_base_tip(self) -> SE3:
        return fk(self._hand.model, self._hand.q)

    @property
    def T_tip_needle_planned(self) -> SE3:
        """Return the planned pose of the needle in the jaws after the regrasps so far."""
        back = SE3.from_parts(SO3.axis("z", -self._back_rad[self._grips]))
        return (back @ grasp_pose(self.setup)).inverse()
