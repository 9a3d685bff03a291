"""Looks at the needle while it is driven, and the corrections of the arm's path that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

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
from trocar.tasks.suture.agents.needle_estimator import NeedleEstimate, NeedleEstimator
from trocar.tasks.suture.agents.stretches import Aim, Stretch
from trocar.tasks.suture.perception import NeedleSighting, search_starts, sight_needle
from trocar.tasks.suture.planning.primitive import driven_steps, grasp_pose
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.planning.setup import SutureSetup

MISLOADED_M, MISLOADED_RAD = 2.5e-3, 0.25
"""A needle that lies this far from where a person should have put it is loaded again."""
ROUND_PX = 32
"""Margin around the needle in the pixels that are read out."""


@dataclass(frozen=True, eq=False)
class PathCorrection:
    """What a corrected path makes up for.

    Attributes:
        tip_error: (6,) of the arm's tip: shift, m, and rotation, rad, in the base's axes.
        T_tip_needle: how the needle lies in the jaws.
        aim: what is corrected.
        fixed_wrist: whether the wrist does not move at all.
    """

    tip_error: NDArray[np.float64]
    T_tip_needle: SE3
    aim: Aim = Aim.POSE
    fixed_wrist: bool = False


class NeedleTracker:
    """Estimates where the needle is from looks at it, and corrects the arm's path accordingly.

    Args:
        cell: with a camera that shows depth; of several, the one nearest to the circle is used.
        hand: the arm.
        setup: of the sutures, with the registered base and circle.
        images: number per look.
        budget_s: declared for finding the needle in them.
        searching_budget_s: the same if it has to be searched for from several poses.

    Raises:
        InvalidInput: no camera shows depth.
    """

    def __init__(
        self, cell: Cell, hand: ArmScript, setup: SutureSetup, images: int, budget_s: float, searching_budget_s: float
    ):
        lenses = {name: lens for name, camera in cell.cameras.items() if isinstance(lens := camera.model, Intrinsics)}
        if not lenses:
            raise InvalidInput("no camera of this cell", "shows depth, to look at the needle", "choose --method blind")
        T_world_camera, p_circle_m = cell.T_world_camera_registered, cell.T_world_fixture["circle"].translation_m
        nearest = min(lenses, key=lambda name: np.linalg.norm(T_world_camera[name].translation_m - p_circle_m))
        self._camera, self._lens = cell.cameras[nearest], lenses[nearest]
        self._T_base_camera = cell.T_world_base_registered[hand.name].inverse() @ T_world_camera[nearest]
        self._log, self._hand, self._setup = cell.log, hand, setup
        self._images, self._budget_s, self._searching_budget_s = images, budget_s, searching_budget_s
        holds = [step for step in driven_steps(setup) if step.holds and step.name != "penetrate"]
        self._back_rad = [step.back_rad for step in holds]
        self._p_needle_tip_m = setup.needle.point_m(np.zeros(1))[0]
        self._estimator = NeedleEstimator()
        self._in_tissue: NeedleEstimate | None = None
        self._grips, self._seen = 0, False
        self._correction = PathCorrection(np.zeros(6), self._T_tip_needle_planned)

    def loaded(self) -> None:
        """Note that a person has loaded the needle."""
        self._grips, self._in_tissue, self._seen = 0, None, False
        self._estimator.loaded(self._T_tip_needle_planned)

    def forget(self) -> None:
        """Discard everything seen so far."""
        self._estimator = NeedleEstimator()

    @property
    def well_loaded(self) -> bool:
        """Return whether the needle was seen in the jaws, about as a person should have put it there."""
        off = (self._T_tip_needle_planned.inverse() @ self._estimator.T_tip_needle).log()
        return self._seen and bool(np.linalg.norm(off[:3]) < MISLOADED_M and np.linalg.norm(off[3:]) < MISLOADED_RAD)

    def released(self) -> None:
        """Note that the jaws are about to open, and the tissue holds the needle."""
        self._in_tissue = self._estimator.needle(self._T_base_tip)

    def gripped(self) -> None:
        """Note that the jaws have closed again on the needle."""
        self._grips += 1
        if self._in_tissue is not None:
            self._estimator.regrasped(self._in_tissue, self._T_base_tip, self._T_tip_needle_planned)
        self._in_tissue = None

    def moved(self, length_m: float) -> None:
        """Note that the jaws have moved by this distance."""
        self._estimator.moved(length_m)

    def adjusted(self) -> None:
        """Note that the arm was corrected a little."""
        self._estimator.adjusted()

    def aim(self, stretch: Stretch) -> None:
        """Correct the path from now on by the estimates of arm and needle."""
        self._correction = PathCorrection(
            self._estimator.tip_error, self._estimator.T_tip_needle, stretch.aim, stretch.fixed_wrist
        )

    def path(self, stretch: Stretch) -> Segment:
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
        if self._in_tissue is None and self._correction.aim is Aim.TIP:
            with suppress(OutOfReach):
                return replace(segment, q=self._with_planned_wrist(segment.q))
        if self._in_tissue is None:
            wanted = T_base_tip @ self._T_tip_needle_planned @ self._correction.T_tip_needle.inverse()
        else:
            planned = T_base_tip[0] @ self._T_tip_needle_planned
            wanted = self._in_tissue.T_base_needle @ planned.inverse() @ T_base_tip
        return replace(segment, q=ik_unbounded(self._hand.model, self._commanded(wanted), near=segment.q))

    def _with_planned_wrist(self, planned: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joints (k, 6) that take the needle's tip along its path, with the wrist turning only as planned.

        The needle keeps its orientation error.
        """
        off, T_tip_needle = self._correction.tip_error, self._correction.T_tip_needle
        wanted_m = (self._fk(planned) @ self._T_tip_needle_planned).apply(self._p_needle_tip_m) - off[:3]
        q = planned.copy()
        turning = 0.0 if self._correction.fixed_wrist else 1.0
        q[:, OUTER:] = self._hand.q[OUTER:] + turning * (planned - planned[0])[:, OUTER:]
        for _ in range(2):  # the error of the jaws' position depends on the orientation that is found
            R = self._fk(q).rotation
            held_m = (R.inverse() @ SO3.exp(off[3:]) @ R).apply(T_tip_needle.apply(self._p_needle_tip_m))
            places = zip(q, wanted_m, held_m, strict=True)
            q = np.array([ik_with_fixed_wrist(self._hand.model, *place) for place in places])
        return q

    def _commanded(self, T_base_tip: SE3) -> SE3:
        """Return where the tip has to be commanded, with the path's corrections, to reach poses of any batch."""
        off = self._correction.tip_error
        return SE3.from_parts(SO3.exp(-off[3:]) @ T_base_tip.rotation, T_base_tip.translation_m - off[:3])

    async def look(self) -> bool:
        """Look at the needle, in the jaws or in the tissue; return whether it was seen but rejected."""
        await self._hand.settle()
        with self._log.span(self._hand.name, "looking"):
            before = self._estimate
            window = self._window(before)
            taken = [await self._camera.capture(window) for _ in range(self._images)]
        images = [image for image in taken if isinstance(image, RgbdImage)]
        starts = search_starts(before.T_base_needle, before.covariance, self._setup.needle)
        budget_s = self._searching_budget_s if len(starts) > 1 else self._budget_s
        seen = await self._hand.compute("perception", budget_s, partial(self._sight, images, before))
        self._seen = accepted = seen is not None and self._update(seen)
        off = (before.T_base_needle.inverse() @ self._estimate.T_base_needle).log()
        tip_m = (self._setup.T_base_circle.inverse() @ self._estimate.T_base_needle).apply(self._p_needle_tip_m)
        self._log.event(
            "needle not seen" if seen is None else "needle seen",
            accepted=accepted,
            pixels=0 if seen is None else seen.pixels,
            off_mm=(1e3 * off[:3]).round(3).tolist(),
            off_deg=np.degrees(off[3:]).round(2).tolist(),
            tip_mm=(1e3 * tip_m).round(3).tolist(),
        )
        return seen is not None and not accepted

    def tip_shift_m(self, q: NDArray[np.float64]) -> float:
        """Return how far the needle's tip would go if the arm went to these joints (6,)."""
        now, then = (
            self._estimator.needle(T).T_base_needle.apply(self._p_needle_tip_m) for T in (self._T_base_tip, self._fk(q))
        )
        return float(np.linalg.norm(then - now))

    def _window(self, expected: NeedleEstimate) -> Window:
        """Return the rectangle of pixels round the needle."""
        needle = self._setup.needle
        wire = needle.point_m(np.linspace(0.0, needle.arc_rad, 40))
        seen = project(self._lens, (self._T_base_camera.inverse() @ expected.T_base_needle).apply(wire))
        most = np.array([self._lens.width, self._lens.height]) - 1
        lower, upper = (np.clip(at, 0, most).astype(int) for at in (seen.min(0) - ROUND_PX, seen.max(0) + ROUND_PX))
        return Window((int(lower[0]), int(lower[1])), (int(upper[0] - lower[0] + 1), int(upper[1] - lower[1] + 1)))

    def _sight(self, images: Sequence[RgbdImage], expected: NeedleEstimate) -> NeedleSighting | None:
        """Find the needle in images; the instrument may hide it."""
        T_camera_base, T_base_tip = self._T_base_camera.inverse(), self._T_base_tip
        solids = InstrumentSolids.of(self._hand.model, self._hand.q, self._hand.jaw_rad)
        T_solids_camera = T_base_tip @ self._estimator.tip(T_base_tip).inverse() @ self._T_base_camera
        return sight_needle(
            images,
            T_camera_base @ expected.T_base_needle,
            expected.covariance,
            self._setup.needle,
            T_camera_base @ self._setup.T_base_circle,
            lambda points: solids.distance_m(T_solids_camera.apply(points)),
        )

    def _update(self, seen: NeedleSighting) -> bool:
        """Update the estimate with what was seen; return whether it is accepted."""
        if self._in_tissue is None:
            return self._estimator.update(self._T_base_tip, self._T_base_camera, seen)
        after = self._in_tissue.updated(self._T_base_camera, seen)
        self._in_tissue = after or self._in_tissue.doubted()
        return after is not None

    @property
    def _estimate(self) -> NeedleEstimate:
        return self._in_tissue or self._estimator.needle(self._T_base_tip)

    @property
    def _T_base_tip(self) -> SE3:
        return self._fk(self._hand.q)

    def _fk(self, q: NDArray[np.float64]) -> SE3:
        return fk(self._hand.model, q)

    @property
    def _T_tip_needle_planned(self) -> SE3:
        """Return how the needle should lie in the jaws after the regrasps so far."""
        back = SE3.from_parts(SO3.axis("z", -self._back_rad[self._grips]))
        return (back @ grasp_pose(self._setup)).inverse()
