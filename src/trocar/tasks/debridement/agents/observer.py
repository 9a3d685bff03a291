"""What the arms learn from the stereo camera: where fragments and grippers are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms.solids import capsules
from trocar.cell import Cell
from trocar.errors import InvalidInput, TrocarError
from trocar.geometry import SE3, TURN
from trocar.geometry.capsules import Capsules, segment_distances_m
from trocar.perception.image import StereoImage, StereoRig, StereoWindow
from trocar.robots.concurrency import with_helpers
from trocar.tasks.debridement.agents.adjusted import Adjusted, StepEnded
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.perception.fragments import SAME_M, SeenFragment
from trocar.tasks.debridement.perception.gripper import SeenGripper

CAMERA = "stereo"
FROZEN = 3  # after this many identical images in a row, although an arm has moved, the camera counts as frozen
LOST_S = 1.0
MARGIN_M, LOST_MARGIN_M = 0.008, 0.020
"""Margin of a window round the gripper, and a larger one if it has not been seen for longer than ``LOST_S``."""
HELD_MARGIN_M = 0.016  # margin if it may hold a fragment, which sticks out of the jaws
MOVED_M = 2e-3  # an arm that has moved by this much changes some pixel
SHORT_S = 0.01  # minimum pause between two looks at a gripper
AGAIN_S = 0.2  # pause before another try after an image that shows nothing new, or not what is needed
LYING_M = 0.012  # middles of fragments on the work surface are lower than this; others are held, and not remembered
ROUND_M = 0.008
"""An arm may hide fragments this far beyond its outline: its pose is an estimate, and what it carries sticks out."""
SHIFTED_M = 0.016
"""Jaws that approach a fragment may shift it unseen, by half of their opening plus half its length at most."""
FINGERS = slice(2, 4)  # the fingers among an arm's capsules
RING_M = 4e-3 * np.array([(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0, TURN, 24, endpoint=False)])
"""Circle about a gripper's tip, for viewers."""
HIDDEN_LOOKS = 8  # after this many more looks hidden jaws count as empty: 2 s, in which arms move on


class CameraFrozen(TrocarError):
    """The camera delivers no new images."""


class Observation(NamedTuple):
    """The fragments that a pair of images shows anywhere, and those on the work surface that an arm hides in it."""

    fragments: Sequence[SeenFragment]
    hidden: Sequence[SeenFragment] = ()


class FragmentMemory:
    """The fragments on the work surface as last seen, and which arms carry something."""

    def __init__(self) -> None:
        self._lying: list[SeenFragment] = []
        self._carrying: set[str] = set()
        self.taken = 0  # how often jaws have closed on one

    def update(
        self, seen: Sequence[SeenFragment], p_world_eyes_m: NDArray[np.float64], arms: Mapping[str, Capsules]
    ) -> Observation:
        """Return what a pair of images from eyes (2, 3) shows outside the jaws, and the fragments that arms hide in it.

        A fragment that is neither seen nor hidden is forgotten. One that appears beside a hidden one is taken to be the
        hidden one, shifted. ``arms``: their solids in the world, approximately as they were in the images.
        """
        fingers = [Capsules(arms[arm].ends_m[FINGERS], arms[arm].radii_m[FINGERS]) for arm in self._carrying]
        shown = [new for new in seen if not _is_behind(new, p_world_eyes_m[:1], fingers)]
        appeared = [new for new in shown if all(new.away_m(old.p_world_m) > SAME_M for old in self._lying)]
        hidden = [
            old
            for old in self._lying
            if all(old.away_m(new.p_world_m) > SAME_M for new in shown)
            and all(old.away_m(new.p_world_m) > SHIFTED_M for new in appeared)
            and _is_behind(old, p_world_eyes_m, arms.values())
        ]
        self._lying = [*(fragment for fragment in shown if fragment.height_m < LYING_M), *hidden]
        return Observation(shown, hidden)

    def take(self, arm: str, p_world_m: NDArray[np.float64]) -> None:
        """Record that the jaws of an arm have closed on what lay at a place (3,), or was shifted from there.

        That is the fragment nearest to it, and all that is so close that it was seen twice; neighbours are still there.
        """
        nearest_m = min((old.away_m(p_world_m) for old in self._lying), default=np.inf)
        reach_m = max(SAME_M, nearest_m if nearest_m <= SHIFTED_M else 0.0)
        self._lying = [old for old in self._lying if old.away_m(p_world_m) > reach_m]
        self._carrying.add(arm)
        self.taken += 1

    def let_go(self, arm: str) -> None:
        """Record that the jaws of an arm have opened again."""
        self._carrying.discard(arm)


class StereoObserver:
    """The stereo camera that the arms share, with a memory of the fragments that arms hide or carry."""

    def __init__(self, cell: Cell, perception: Any, robot: Adjusted, settings: Settings):
        self._cell, self._perception, self._robot, self._settings = cell, perception, robot, settings
        self._camera = cell.cameras[CAMERA]
        self._T_world_camera = cell.T_world_camera_registered[CAMERA]
        self._last: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.memory = FragmentMemory()

    async def observe(self, arm: str) -> Observation:
        """Take a pair of images for an arm, and find fragments and all grippers in it.

        Raises:
            CameraFrozen: images do not change any more.
        """
        image, kinematic = await self._captured(arm, "whole")
        see, T_world_camera, arms = self._perception, self._T_world_camera, self._cell.arms

        def find():
            fragments = see.fragments(image, T_world_camera, self._cell.T_world_fixture["table"], arms)
            return fragments, {name: see.gripper(image, T_world_camera, model) for name, model in arms.items()}

        budget_s = self._settings.fragments_budget_s
        fragments, grippers = await self._cell.compute(arm, "perception", find, budget_s)
        for name, gripper in grippers.items():
            if gripper is not None:
                self._robot.saw(name, image.time_s, kinematic[name], gripper.T_world_tip)
        self._cell.log.saw(CAMERA, image, self._outlines(fragments, grippers))
        known = self._remembered(fragments, image.rig) if self._settings.remembers else Observation(fragments)
        places = [np.round(f.p_world_m, 5).tolist() for f in (*known.fragments, *known.hidden)]
        self._cell.log.event(
            "detected", arm=arm, image_s=round(image.time_s, 6), fragments=places, remembered=len(known.hidden)
        )
        return known

    def _outlines(
        self, fragments: Sequence[SeenFragment], grippers: Mapping[str, SeenGripper | None]
    ) -> dict[str, NDArray[np.float64]]:
        """Return a line about each fragment and each gripper's tip, in the left camera's frame."""
        T_camera_world = self._T_world_camera.inverse()
        found = {f"fragment {number}": one.rim_m for number, one in enumerate(fragments, 1)}
        found |= {name: seen.T_world_tip.apply(RING_M) for name, seen in grippers.items() if seen is not None}
        return {name: T_camera_world.apply(rim) for name, rim in found.items()}

    def _remembered(self, seen: Sequence[SeenFragment], rig: StereoRig) -> Observation:
        """Return what is seen outside the jaws, and what arms hide at their estimated positions."""
        solids = {}
        for name, model in self._cell.arms.items():
            reading = self._robot.read(name)
            expected = capsules(model, reading.q, reading.jaw_rad)
            solids[name] = expected.moved(self._cell.T_world_base_registered[name])
        T_world_right = self._T_world_camera @ rig.T_left_right
        eyes_m = np.stack([self._T_world_camera.translation_m, T_world_right.translation_m])
        return self.memory.update(seen, eyes_m, solids)

    async def track(
        self, arm: str, *, waits: bool = True, margin_m: float = MARGIN_M
    ) -> tuple[StereoImage, SE3 | None]:
        """Learn where a gripper is from an image round it; return the image, and the tip as seen or None.

        None: marks are hidden. ``waits``: whether the arm waits for the image, or continues meanwhile.
        """
        margin_m = margin_m if self._robot.age_s(arm) < LOST_S else max(margin_m, LOST_MARGIN_M)
        tip, binning = self._robot.T_world_tip(arm), 1 if waits else self._settings.watch_binning
        window = self._perception.gripper_window(
            tip, self._T_world_camera, self._camera.model, margin_m=margin_m, binning=binning
        )
        image, kinematic = await self._captured(arm, "window", window, waits)
        find = partial(self._perception.gripper, image, self._T_world_camera, self._cell.arms[arm])
        budget_s = self._settings.gripper_budget_s
        if waits:
            seen = await self._cell.compute(arm, "perception", find, budget_s)
        else:
            seen, seconds = await self._cell.clock.compute(find, budget_s)
            self._cell.log.compute("watching", seconds, budget_s)
        if seen is None:
            return image, None
        self._robot.saw(arm, image.time_s, kinematic[arm], seen.T_world_tip)
        return image, seen.T_world_tip

    async def follow(self, arm: str) -> None:
        """Follow a gripper forever: while it moves, correct its commands from images; stop it if far off its path.

        Raises:
            CameraFrozen: images do not change any more.
        """

        async def loop(helpers: trio.Nursery) -> None:
            while True:
                began_s = self._cell.clock.now_s()
                if self._robot.setpoint(arm).moving:
                    await self.track(arm, waits=False)
                    if self._robot.astray_m(arm) > self._settings.astray_m:
                        self._robot.hold(arm, reason=StepEnded(arm))
                    else:
                        helpers.start_soon(self._robot.correct, arm)
                await self._cell.clock.sleep(max(began_s + self._settings.watch_s - self._cell.clock.now_s(), SHORT_S))

        await with_helpers(loop)

    async def holds(self, arm: str) -> bool:
        """Return whether pixels show that a fragment was picked up, and note it; if inconclusive, look again."""
        holding, sure, image_s = await self._check_jaws(arm)
        for _ in range(HIDDEN_LOOKS):
            if not sure:
                await self._cell.clock.sleep(AGAIN_S)
                holding, sure, image_s = await self._check_jaws(arm)
        self._cell.log.event("pickup", arm=arm, holding=holding, image_s=round(image_s, 6))
        return holding

    async def clings(self, arm: str) -> bool:
        """Return whether pixels show a fragment at the open jaws."""
        return (await self._check_jaws(arm))[0]

    async def _check_jaws(self, arm: str) -> tuple[bool, bool, float]:
        """Return whether pixels show a fragment in the jaws, whether that is certain, and when.

        If the marks are hidden, mostly by the other arm, the content of the jaws may be hidden too, or the jaws may be
        elsewhere; the absence of red then means nothing.
        """
        image, T_world_seen = await self.track(arm, margin_m=HELD_MARGIN_M)
        T_world_tip, jaw_rad = T_world_seen or self._robot.T_world_tip(arm), self._robot.read(arm).jaw_rad
        where = self._T_world_camera, self._cell.arms[arm], T_world_tip, jaw_rad
        look = partial(self._perception.holding, image, *where)
        holding = bool(await self._cell.compute(arm, "perception", look, self._settings.gripper_budget_s))
        return holding, holding or T_world_seen is not None, image.time_s

    async def _captured(
        self, arm: str, kind: str, window: StereoWindow | None = None, waits: bool = True
    ) -> tuple[StereoImage, dict[str, SE3]]:
        """Return a new image, and the kinematic poses of all arms when it was taken.

        Raises:
            CameraFrozen: the images are not new.
        """
        for _ in range(FROZEN):
            with self._cell.log.span(arm, "capture") if waits else nullcontext():
                image = await self._camera.capture(window)
            if not isinstance(image, StereoImage):
                raise InvalidInput(f"camera {CAMERA!r}", "has one eye", "debridement needs two")
            kinematic = {name: self._robot.kinematic(name) for name in self._cell.arms}
            if self._is_new(f"{arm} {kind}", image, kinematic):
                return image, kinematic
            await self._cell.clock.sleep(AGAIN_S)
        raise CameraFrozen("the stereo camera has stopped giving new images; check its connection")

    def _is_new(self, key: str, image: StereoImage, kinematic: Mapping[str, SE3]) -> bool:
        """Return whether an image differs from the last of its kind, if an arm has moved since."""
        tips = np.array([T.translation_m for T in kinematic.values()])
        before = self._last.get(key)
        if before is not None and np.abs(tips - before[1]).max() > MOVED_M and np.array_equal(before[0], image.left):
            return False
        self._last[key] = image.left, tips
        return True


def _is_behind(fragment: SeenFragment, p_world_eyes_m: NDArray[np.float64], solids: Iterable[Capsules]) -> bool:
    """Return whether the line of sight from one of the eyes to a fragment passes through or close to these solids."""
    near, place = ROUND_M + 0.5 * float(fragment.extent_m[0]), fragment.p_world_m
    return any(
        (segment_distances_m(solid.ends_m[:, 0], solid.ends_m[:, 1], eye, place) < solid.radii_m + near).any()
        for solid in solids
        for eye in p_world_eyes_m
    )
