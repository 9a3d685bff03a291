"""Looks at the needle while it is driven, and the corrections that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik_unbounded, ik_with_fixed_wrist
from trocar.arms.fixed_wrist import OUTER
from trocar.cell import Cell
from trocar.errors import OutOfReach, TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, RgbdImage, Window
from trocar.perception.instrument_solids import InstrumentSolids
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.needle_belief import NeedleEstimate, NeedleEstimator
from trocar.tasks.suture.perception import NeedleArc, NeedleSighting, search_starts, sight_needle
from trocar.tasks.suture.planning import SutureSetup
from trocar.tasks.suture.planning.drive import Segment
from trocar.tasks.suture.planning.primitive import driven_steps, grasp_pose

BEFORE_ENTRY_M = 2e-3
"""Distance of the last look before the tissue, along the needle's path."""
PAST_ENTRY_M = 2.5e-3
"""From there the tip goes in this far without a pause, with the wrist at rest, because cables that reverse would move
it just at the entry. Also, the unrepeatable errors change within a second: the sooner the tip is there, the better what
was seen still holds.
"""
RUN_UP_M = 1.0e-3
"""A corrected start of a path is approached from this far behind it, along the path, so that the outer joints have
taken up their play in the direction of the motion."""
BEFORE_EXIT_RAD = np.radians(8.0)
"""Angle of the last look before the tip comes out, about the needle's centre."""
WELL_BEFORE_EXIT_RAD = np.radians(16.0)
"""Another look is taken there, because after the jaws have closed elsewhere, cable errors may bring the tip out
early."""
HIGH_LOOKS, ENTRY_LOOKS, EXIT_LOOKS = 2, 4, 3
"""Greatest number of looks above the tissue, just before the needle goes in, and just before it comes out."""
ENOUGH_M = 0.2e-3
"""A needle's tip estimated to be this close to where it should be is not moved and looked at again. The threshold is
multiplied by the number of looks there, because each move disturbs the cables again, by some .6 mm."""

AWRY_M, AWRY_RAD = 2.5e-3, 0.25
"""A needle that lies this far from where a person should have put it is loaded again."""
ROUND_PX = 32
"""Margin around the needle in the pixels that are read out."""


class Aim(Enum):
    """What a correction before a stretch of the path applies to."""

    POSE = "place and attitude"
    TIP = "the place of the needle's tip alone, by the outer joints: turning the wrist again would stir its cables"


@dataclass(frozen=True)
class Stretch:
    """A part of the path without a look.

    Attributes:
        segment: to be followed.
        first: whether it is the first of its step.
        looks: maximum number of looks at the needle before it. If more than one is allowed, the arm goes to the
            stretch's corrected start after each; otherwise it joins the corrected path on the way.
        aim: what is corrected.
        rests: whether the wrist does not move at all.
    """

    segment: Segment
    first: bool = True
    looks: int = 0
    aim: Aim = Aim.POSE
    rests: bool = False


def stretches(segments: Sequence[Segment], setup: SutureSetup) -> list[Stretch]:
    """Return the path divided at the looks: above and before the entry, in each grip, before the exit.

    The arm does not stop at the surface, neither on the way in nor on the way out: when it starts again, reversed
    cables take up their play, and that would be just where the position of the needle's tip counts.
    """
    exit_rad = setup.insertion.exit_turn_rad(setup.needle.radius_m)
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
            whole = Stretch(segment, looks=0 if segment.name == "rotate" or start > exit_rad else 1)
            last = exit_rad - BEFORE_EXIT_RAD
            before, *after = _cut(whole, (last - start) / (end - start), EXIT_LOOKS)
            if after:
                after = [*_cut(before, (exit_rad - WELL_BEFORE_EXIT_RAD - start) / (last - start), 1), *after]
            found += after or [before]
        else:
            found.append(Stretch(segment, looks=1 if step.needle_rad[0] < exit_rad else 0))
    return _through_the_surface(found)


def _cut(whole: Stretch, share: float, looks: int) -> list[Stretch]:
    """Return a stretch divided at a share of its length, with the last looks in between; whole if it ends before."""
    segment = whole.segment
    steps = len(segment.q) - 1
    place = round(share * steps) if np.isfinite(share) else 0
    if not 0 < place < steps:
        return [whole]
    before = replace(segment, q=segment.q[: place + 1], length_m=segment.length_m * place / steps)
    after = replace(segment, q=segment.q[place:], length_m=segment.length_m - before.length_m)
    return [replace(whole, segment=before), Stretch(after, first=False, looks=looks, aim=Aim.TIP)]


def _through_the_surface(found: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches with the rest of the approach after the last looks and the tip's entry joined."""
    joined: list[Stretch] = []
    for stretch in found:
        last = joined[-1] if joined else stretch
        if stretch.segment.name == "penetrate" and last.aim is Aim.TIP:
            whole, steps = stretch.segment, len(stretch.segment.q) - 1
            deep = min(steps, max(1, round(PAST_ENTRY_M / max(whole.length_m, PAST_ENTRY_M) * steps)))
            deep_m = whole.length_m * deep / steps
            q = np.concatenate([last.segment.q, whole.q[1 : deep + 1]])
            way = replace(whole, q=q, length_m=last.segment.length_m + deep_m)
            joined[-1] = replace(last, segment=way, first=True, rests=True)
            if deep < steps:
                left = replace(whole, q=whole.q[deep:], length_m=whole.length_m - deep_m)
                joined.append(Stretch(left, first=False, aim=Aim.TIP))
        else:
            joined.append(stretch)
    return joined


class NeedleWatch:
    """Estimates where the needle is from looks at it, and corrects the arm's path accordingly.

    Args:
        cell: with a camera that shows depth; of several, the one nearest to the circle is used.
        hand: the arm.
        images: number per look.
        budget_s: declared for finding the needle in them.
        searching_s: the same if it has to be searched for from several poses.

    Raises:
        TrocarError: no camera shows depth.
    """

    def __init__(self, cell: Cell, hand: ArmScript, images: int, budget_s: float, searching_s: float):
        seeing = {name: lens for name, camera in cell.cameras.items() if isinstance(lens := camera.model, Intrinsics)}
        if not seeing:
            raise TrocarError("no camera of this cell shows depth, to look at the needle; choose --method blind")
        self._cell, self._hand, self._images = cell, hand, images
        self._budget_s, self._searching_s = budget_s, searching_s
        T_world_camera, T_world_circle = cell.T_world_camera_registered, cell.T_world_fixture["circle"]
        nearest = min(
            seeing,
            key=lambda name: np.linalg.norm(T_world_camera[name].translation_m - T_world_circle.translation_m),
        )
        self._camera, self._lens = cell.cameras[nearest], seeing[nearest]
        base = cell.T_world_base_registered[hand.name]
        self._T_base_camera = base.inverse() @ T_world_camera[nearest]
        self._belief = NeedleEstimator()
        self._held: NeedleEstimate | None = None

    def loaded(self, setup: SutureSetup) -> None:
        """Note that a person has loaded the needle for a suture of this setup."""
        self.setup, self._grips, self._held, self._seen = setup, 0, None, False
        holds = [step for step in driven_steps(setup) if step.holds]
        self._back_rad = [step.back_rad for step in holds if step.name != "penetrate"]
        needle = setup.needle
        self._arc = NeedleArc(needle.radius_m, needle.arc_rad, needle.wire_m)
        self._belief.loaded(self._grasp(0))

    def forget(self) -> None:
        """Discard everything seen so far."""
        self._belief = NeedleEstimator()

    @property
    def well_loaded(self) -> bool:
        """Return whether the needle was seen in the jaws, about as a person should have put it there."""
        awry = (self._grasp(0).inverse() @ self._belief.in_jaws()).log()
        return self._seen and bool(np.linalg.norm(awry[:3]) < AWRY_M and np.linalg.norm(awry[3:]) < AWRY_RAD)

    def let_go(self) -> None:
        """Note that the jaws are about to open, and the tissue holds the needle."""
        self._held = self._belief.needle(self._T_base_tip)

    def gripped(self) -> None:
        """Note that the jaws have closed again on the needle."""
        self._grips += 1
        if self._held is not None:
            self._belief.regrasped(self._held, self._T_base_tip, self._grasp(self._grips))
        self._held = None

    def moved(self, way_m: float) -> None:
        """Note that the jaws have moved by this distance."""
        self._belief.moved(way_m)

    def stirred(self) -> None:
        """Note that the arm was corrected a little."""
        self._belief.stirred()

    def aim(self, stretch: Stretch) -> None:
        """Correct the path from now on by the estimates of arm and needle."""
        self._off, self._in_jaws = self._belief.tip_off, self._belief.in_jaws()
        self._wrist_still, self._rests = stretch.aim is Aim.TIP, stretch.rests

    def way(self, stretch: Stretch) -> Segment:
        """Return the corrected segment of a stretch, from where the arm is to where it should be at the end."""
        if stretch.looks <= 1:
            self.aim(stretch)
        segment = self.corrected(stretch.segment)
        if segment.name == "lower" or len(segment.q) < 2:
            return segment
        left = np.linspace(1.0, 0.0, len(segment.q))[:, None]
        return replace(segment, q=segment.q + left * (self._hand.q - segment.q[0]))

    def corrected(self, segment: Segment) -> Segment:
        """Return the segment with the path's corrections.

        While the jaws hold the needle, the needle has to follow its planned path; otherwise, the jaws have to follow
        their planned path relative to the needle.
        """
        if not len(segment.q):
            return segment
        T_base_tip = fk(self._hand.model, segment.q)
        if self._held is None and self._wrist_still:
            with suppress(OutOfReach):
                return replace(segment, q=self._with_still_wrist(segment.q))
        if self._held is None:
            wanted = T_base_tip @ self._grasp(self._grips) @ self._in_jaws.inverse()
        else:
            planned = T_base_tip[0] @ self._grasp(self._grips)
            wanted = self._held.T_base_needle @ planned.inverse() @ T_base_tip
        return replace(segment, q=ik_unbounded(self._hand.model, self._asked(wanted), near=segment.q))

    def _with_still_wrist(self, planned: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joints (k, 6) that take the needle's tip along its path, with the wrist turning only as planned.

        The needle keeps its orientation error.
        """
        p_needle_tip = self._arc.point_m(np.zeros(1))[0]
        wanted_m = (self._fk(planned) @ self._grasp(self._grips)).apply(p_needle_tip) - self._off[:3]
        q = planned.copy()
        q[:, OUTER:] = self._hand.q[OUTER:] + (0.0 if self._rests else 1.0) * (planned - planned[0])[:, OUTER:]
        for _ in range(2):  # the error of the jaws' position depends on the orientation that is found
            R = self._fk(q).rotation
            held_m = (R.inverse() @ SO3.exp(self._off[3:]) @ R).apply(self._in_jaws.apply(p_needle_tip))
            places = zip(q, wanted_m, held_m, strict=True)
            q = np.array([ik_with_fixed_wrist(self._hand.model, *place) for place in places])
        return q

    def _asked(self, T_base_tip: SE3) -> SE3:
        """Return where the tip has to be commanded, with the path's corrections, to reach poses of any batch."""
        R = SO3.exp(-self._off[3:]) @ T_base_tip.rotation
        return SE3.from_parts(R, T_base_tip.translation_m - self._off[:3])

    async def look(self) -> bool:
        """Look at the needle, in the jaws or in the tissue; return whether it was seen but rejected."""
        await self._hand.settle()
        with self._cell.log.span(self._hand.name, "looking"):
            before = self._needle
            window = self._window(before)
            taken = [await self._camera.capture(window) for _ in range(self._images)]
        images = [image for image in taken if isinstance(image, RgbdImage)]
        find = partial(self._find, images, before)
        widely = len(search_starts(before.T_base_needle, before.covariance, self._arc)) > 1
        budget_s = self._searching_s if widely else self._budget_s
        seen = await self._hand.compute("perception", budget_s, find)
        self._seen = accepted = seen is not None and self._take(seen)
        off = (before.T_base_needle.inverse() @ self._needle.T_base_needle).log()
        self._cell.log.event(
            "needle not seen" if seen is None else "needle seen",
            accepted=accepted,
            pixels=0 if seen is None else seen.pixels,
            off_mm=(1e3 * off[:3]).round(3).tolist(),
            off_deg=np.degrees(off[3:]).round(2).tolist(),
            tip_mm=(1e3 * self._tip_in_circle(self._needle)).round(3).tolist(),
        )
        return seen is not None and not accepted

    def _tip_in_circle(self, needle: NeedleEstimate) -> NDArray[np.float64]:
        """Return where (3,) the tip of a needle is estimated to be in the circle's frame, m."""
        return (self.setup.T_base_circle.inverse() @ needle.T_base_needle).apply(self._arc.point_m(np.zeros(1))[0])

    def _window(self, expected: NeedleEstimate) -> Window:
        """Return the rectangle of pixels round the needle."""
        wire = self._arc.point_m(np.linspace(0.0, self._arc.arc_rad, 40))
        seen = project(self._lens, (self._T_base_camera.inverse() @ expected.T_base_needle).apply(wire))
        most = np.array([self._lens.width, self._lens.height]) - 1
        lower, upper = (np.clip(at, 0, most).astype(int) for at in (seen.min(0) - ROUND_PX, seen.max(0) + ROUND_PX))
        return Window((int(lower[0]), int(lower[1])), (int(upper[0] - lower[0] + 1), int(upper[1] - lower[1] + 1)))

    @property
    def _needle(self) -> NeedleEstimate:
        """Return where the needle is estimated to be."""
        return self._held or self._belief.needle(self._T_base_tip)

    def _take(self, seen: NeedleSighting) -> bool:
        """Update with what was seen; return whether it is accepted."""
        if self._held is None:
            return self._belief.saw(self._T_base_tip, self._T_base_camera, seen)
        after = self._held.after(self._T_base_camera, seen)
        self._held = after or self._held.doubted()
        return after is not None

    def off_m(self, q: NDArray[np.float64]) -> float:
        """Return how far the needle's tip would go if the arm went to these joints (6,)."""
        tip = self._arc.point_m(np.zeros(1))
        now, then = (self._belief.needle(T).T_base_needle.apply(tip) for T in (self._T_base_tip, self._fk(q)))
        return float(np.linalg.norm(then - now))

    def _find(self, images: Sequence[RgbdImage], expected: NeedleEstimate) -> NeedleSighting | None:
        T_camera_base, asked = self._T_base_camera.inverse(), self._T_base_tip
        solids = InstrumentSolids.of(self._hand.model, self._hand.q, self._hand.jaw_rad)
        to_solids = asked @ self._belief.tip(asked).inverse() @ self._T_base_camera
        return sight_needle(
            images,
            T_camera_base @ expected.T_base_needle,
            expected.covariance,
            self._arc,
            T_camera_base @ self.setup.T_base_circle,
            lambda points: solids.distance_m(to_solids.apply(points)),
        )

    @property
    def _T_base_tip(self) -> SE3:
        return self._fk(self._hand.q)

    def _fk(self, q: NDArray[np.float64]) -> SE3:
        return fk(self._hand.model, q)

    def _grasp(self, grips: int) -> SE3:
        """Return how the needle should lie in the jaws after so many regrasps."""
        back = SE3.from_parts(SO3.axis("z", -self._back_rad[grips]))
        return (back @ grasp_pose(self.setup)).inverse()
