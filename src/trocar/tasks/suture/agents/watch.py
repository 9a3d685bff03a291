"""Looks at the needle while it is driven, and what they change of the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik_unbounded
from trocar.cell import Cell
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, RgbdImage, Window
from trocar.perception.instrument.solids import InstrumentSolids
from trocar.perception.needle import NeedleArc, NeedleSighting, search_starts, sight_needle
from trocar.sutures import SutureSetup
from trocar.sutures.drive import Segment
from trocar.sutures.primitive import grasp_pose
from trocar.tasks.kit import ArmScript
from trocar.tasks.suture.agents.needle_belief import Believed, NeedleBelief

BEFORE_ENTRY_M = 2e-3
"""The last look before the tissue is so far before it, along the needle's way."""
BEFORE_EXIT_RAD = np.radians(8.0)
"""And the last one before the tip comes out, about the needle's centre."""
HIGH_LOOKS, ENTRY_LOOKS, EXIT_LOOKS = 2, 4, 3
"""At most so many looks above the tissue, just before the needle goes in, and just before it comes out."""
ENOUGH_M = 0.2e-3
"""A needle's tip that is believed this near to where it should be is not moved and looked at again; times the number of
looks there, for each move stirs the cables anew, by some .6 mm."""

ROUND_PX = 16
"""So much round the needle is read out of the camera."""


class Aim(Enum):
    """What of the way is corrected before a stretch of it."""

    POSE = "place and attitude"
    TIP = "the place of the needle's tip alone: turning the wrist again would stir its cables"
    KEPT = "nothing anew"


@dataclass(frozen=True)
class Stretch:
    """A part of the way without a look.

    Attributes:
        segment: that is followed.
        first: whether it is the first of its step.
        looks: how often the needle is looked at, at most, before it. Where more than one is allowed, the arm goes to
            the stretch's corrected start after each; else it comes to the corrected way on the way.
        aim: what is corrected.
    """

    segment: Segment
    first: bool = True
    looks: int = 0
    aim: Aim = Aim.POSE


def stretches(segments: Sequence[Segment], setup: SutureSetup) -> list[Stretch]:
    """Return the way cut where the needle is looked at: above and before its entry, in each grip, before its exit."""
    insertion, found = setup.insertion, []
    exit_rad = insertion.exit_turn_rad(setup.needle.radius_m)
    turned = 0.0
    for segment in segments:
        if segment.name == "approach":
            share = 1.0 - BEFORE_ENTRY_M / max(segment.length_m, BEFORE_ENTRY_M)
            found += _cut(Stretch(segment, looks=HIGH_LOOKS), share, ENTRY_LOOKS)
        elif segment.name == "penetrate":
            found.append(Stretch(segment, aim=Aim.KEPT))
        elif segment.name == "rotate" or segment.name.startswith("push"):
            turns = segment.name == "rotate"
            angle = insertion.rotation_rad if turns else insertion.regrasp_rad
            whole = Stretch(segment, looks=0 if turns or turned > exit_rad else 1)
            found += _cut(whole, (exit_rad - BEFORE_EXIT_RAD - turned) / angle, EXIT_LOOKS)
            turned += angle
        else:
            found.append(Stretch(segment, looks=1 if segment.regrasps and turned < exit_rad else 0))
    return found


def _cut(whole: Stretch, share: float, looks: int) -> list[Stretch]:
    """Return a stretch in two, at a share of its length, with the last looks between; in one, if it ends before."""
    segment = whole.segment
    steps = len(segment.q) - 1
    place = round(share * steps) if np.isfinite(share) else 0
    if not 0 < place < steps:
        return [whole]
    before = replace(segment, q=segment.q[: place + 1], length_m=segment.length_m * place / steps)
    after = replace(segment, q=segment.q[place:], length_m=segment.length_m - before.length_m)
    return [replace(whole, segment=before), Stretch(after, first=False, looks=looks, aim=Aim.TIP)]


class NeedleWatch:
    """Knows where the needle is from looks at it, and corrects the arm's way by that.

    Args:
        cell: with a camera that shows depth; of several the one nearest to the circle is used.
        hand: the arm.
        images: of one look.
        budget_s: declared for finding the needle in them.
        searching_s: the same where it has to be searched for in several places.

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
        self._belief = NeedleBelief()
        self._held: Believed | None = None

    def loaded(self, setup: SutureSetup) -> None:
        """A person has loaded the needle for a suture of this setup."""
        self._setup, self._grips, self._held = setup, 0, None
        needle = setup.needle
        self._arc = NeedleArc(needle.radius_m, needle.arc_rad, needle.wire_m)
        self._belief.loaded(self._grasp(0))

    def let_go(self) -> None:
        """The jaws are about to open, and the tissue holds the needle."""
        self._held = self._belief.needle(self._T_base_tip)

    def gripped(self) -> None:
        """The jaws have closed again on the needle."""
        self._grips += 1
        if self._held is not None:
            self._belief.regrasped(self._held, self._T_base_tip, self._grasp(self._grips))
        self._held = None

    def moved(self, way_m: float) -> None:
        """The jaws went so far."""
        self._belief.moved(way_m)

    def stirred(self) -> None:
        """The arm was corrected a little."""
        self._belief.stirred()

    def aim(self, stretch: Stretch) -> None:
        """Correct the way from now on by what is believed of arm and needle."""
        if stretch.aim is Aim.POSE:
            self._off, self._in_jaws = self._belief.tip_off, self._belief.in_jaws()
        elif stretch.aim is Aim.TIP:
            planned = self._fk(stretch.segment.q[0]) @ self._grasp(self._grips)
            expected = self._belief.needle(self._asked(planned @ self._in_jaws.inverse())).T_base_needle
            tip = self._arc.point_m(np.zeros(1))[0]
            self._off[:3] += expected.apply(tip) - planned.apply(tip)

    def way(self, stretch: Stretch) -> Segment:
        """Return how a stretch is followed: corrected, from where the arm is to where it should be at the end."""
        if stretch.looks <= 1:
            self.aim(stretch)
        segment = self.corrected(stretch.segment)
        if segment.name == "lower" or len(segment.q) < 2:
            return segment
        left = np.linspace(1.0, 0.0, len(segment.q))[:, None]
        return replace(segment, q=segment.q + left * (self._hand.q - segment.q[0]))

    def corrected(self, segment: Segment) -> Segment:
        """Return the segment with what is corrected of the way.

        While the jaws hold the needle it is the needle that has to go where it was planned; while they do not, the jaws
        have to go where they were planned about the needle.
        """
        if not len(segment.q):
            return segment
        T_base_tip = fk(self._hand.model, segment.q)
        if self._held is None:
            wanted = T_base_tip @ self._grasp(self._grips) @ self._in_jaws.inverse()
        else:
            planned = T_base_tip[0] @ self._grasp(self._grips)
            wanted = self._held.T_base_needle @ planned.inverse() @ T_base_tip
        return replace(segment, q=ik_unbounded(self._hand.model, self._asked(wanted), near=segment.q))

    def _asked(self, T_base_tip: SE3) -> SE3:
        """Return where the tip has to be asked to be, by what the way is corrected by, to get to poses of any batch."""
        R = SO3.exp(-self._off[3:]) @ T_base_tip.rotation
        return SE3.from_parts(R, T_base_tip.translation_m - self._off[:3])

    async def look(self) -> bool:
        """Look at the needle, in the jaws or in the tissue; return whether what was seen is believed."""
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
        believed = seen is not None and self._take(seen)
        off = (before.T_base_needle.inverse() @ self._needle.T_base_needle).log()
        self._cell.log.event(
            "needle not seen" if seen is None else "needle seen",
            believed=believed,
            pixels=0 if seen is None else seen.pixels,
            off_mm=(1e3 * off[:3]).round(3).tolist(),
            off_deg=np.degrees(off[3:]).round(2).tolist(),
        )
        return believed

    def _window(self, expected: Believed) -> Window:
        """Return the rectangle of pixels round the needle."""
        wire = self._arc.point_m(np.linspace(0.0, self._arc.arc_rad, 40))
        seen = project(self._lens, (self._T_base_camera.inverse() @ expected.T_base_needle).apply(wire))
        most = np.array([self._lens.width, self._lens.height]) - 1
        lower, upper = (np.clip(at, 0, most).astype(int) for at in (seen.min(0) - ROUND_PX, seen.max(0) + ROUND_PX))
        return Window((int(lower[0]), int(lower[1])), (int(upper[0] - lower[0] + 1), int(upper[1] - lower[1] + 1)))

    @property
    def _needle(self) -> Believed:
        """Return where the needle is believed to be."""
        return self._held or self._belief.needle(self._T_base_tip)

    def _take(self, seen: NeedleSighting) -> bool:
        """Take in what was seen; return whether it is believed."""
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

    def _find(self, images: Sequence[RgbdImage], expected: Believed) -> NeedleSighting | None:
        T_camera_base, asked = self._T_base_camera.inverse(), self._T_base_tip
        solids = InstrumentSolids.of(self._hand.model, self._hand.q, self._hand.jaw_rad)
        to_solids = asked @ self._belief.tip(asked).inverse() @ self._T_base_camera
        return sight_needle(
            images,
            T_camera_base @ expected.T_base_needle,
            expected.covariance,
            self._arc,
            T_camera_base @ self._setup.T_base_circle,
            lambda points: solids.distance_m(to_solids.apply(points)),
        )

    @property
    def _T_base_tip(self) -> SE3:
        return self._fk(self._hand.q)

    def _fk(self, q: NDArray[np.float64]) -> SE3:
        return fk(self._hand.model, q)

    def _grasp(self, grips: int) -> SE3:
        """Return how the needle should lie in the jaws after so many regrasps."""
        back = SE3.from_parts(SO3.axis("z", -grips * self._setup.insertion.regrasp_rad))
        return (back @ grasp_pose(self._setup)).inverse()
