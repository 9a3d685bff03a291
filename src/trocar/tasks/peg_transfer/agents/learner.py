"""An arm that looks at its own wrist, and learns its cables from that."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from functools import partial

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.perception.image import RgbdImage
from trocar.perception.instrument import Sighting, sight
from trocar.robots import Adaptive
from trocar.robots.adaptive import Knowledge
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.grasps import Grasp

PLACE_M = (0.0, 0.0, 0.045)
"""Position of the tip in the board's frame while the wrist swings back and forth, clear of pegs and blocks."""
YAWS_RAD = np.linspace(-1.2, 1.2, 7)
"""Rotations of a vertical tool, as for grasps; the wrist moves through all joint values that these need."""
WIDER_RAD = 0.15
"""Extension of these joint ranges at both ends."""
OPEN_RAD = 0.9
"""Opening of the jaws meanwhile: the plane of open jaws shows the roll."""


@asynccontextmanager
async def learning(arms: Sequence[PegArm]) -> AsyncIterator[None]:
    """Let arms learn, if the settings say so: first one by one in front of the camera, then while they work."""
    if arms[0].settings.teaching_looks == 0:
        yield
        return
    async with trio.open_nursery() as nursery:
        for arm in arms:
            learner = Learner(arm, nursery)
            arm.before_descent, arm.after_release = learner.look, learner.adopt
            await learner.teach()
            await arm.go_home()
        yield
        nursery.cancel_scope.cancel()


class Learner:
    """One arm's looks at its wrist; cables are fitted in the nursery while the arm works.

    Raises:
        InvalidInput: the robot does not learn.
    """

    def __init__(self, arm: PegArm, nursery: trio.Nursery):
        robot = arm.cell.robot
        if not isinstance(robot, Adaptive):
            what, remedy = f"a {type(robot).__name__} robot", "make Adaptive the outermost wrapper"
            raise InvalidInput(what, "does not learn its cables", remedy)
        self.arm, self.robot, self.nursery = arm, robot, nursery
        self.table, self.hand, self.settings = arm.table, arm.hand, arm.settings
        self.T_base_camera = arm.motions.T_base_board @ self.table.T_camera_board.inverse()
        self._better: Knowledge | None = None

    async def teach(self) -> None:
        """Turn the wrist back and forth in front of the camera, and learn from the images."""
        from scipy.stats import qmc  # slow to import; few agents learn

        model = self.hand.model
        upright = [self.arm.motions.ik(pose) for pose in self._upright()]
        middle = upright[len(upright) // 2]
        lower = np.maximum(np.min(upright, axis=0) - WIDER_RAD, model.lower)[3:]
        upper = np.minimum(np.max(upright, axis=0) + WIDER_RAD, model.upper)[3:]
        await self.arm.go_over(self.arm.motions.tip(middle))
        await self.hand.jaw(OPEN_RAD)
        count = self.settings.teaching_looks
        points = qmc.Sobol(3, rng=0).random_base2(int(np.ceil(np.log2(count))))[:count]
        async with trio.open_nursery() as nursery:
            for point in points:
                await self.hand.go(np.concatenate([middle[:3], lower + point * (upper - lower)]))
                await self.hand.settle()
                row, q, jaw_rad = *self.robot.moment(self.arm.name), self.hand.jaw_rad
                nursery.start_soon(self._evaluated, await self.table.capture(self.hand), row, q, jaw_rad, None)
        await self._fit()
        if self._better is None:
            self.arm.cell.log.event("cables not learned", arm=self.arm.name, reason="too few looks showed the wrist")
        self.adopt()

    def _upright(self) -> list[SE3]:
        """Return poses of a vertical tool, turned both ways from the roll at home."""
        home = self.arm.home[3]
        turned = [SE3.from_parts(SO3.axis("z", yaw), PLACE_M) for yaw in (0.0, np.pi)]
        middle = min(turned, key=lambda pose: abs(self.arm.motions.ik(pose)[3] - home))
        return [SE3.from_parts(middle.rotation @ SO3.axis("z", yaw), PLACE_M) for yaw in YAWS_RAD]

    async def look(self, grasp: Grasp, opening_rad: float) -> None:
        """Look at the wrist over a block and correct it before the arm goes down; then fit the cables to all looks."""
        if not await self.arm.stop_over(grasp, opening_rad):
            return  # the arm goes down without a look
        row, q, jaw_rad = *self.robot.moment(self.arm.name), self.hand.jaw_rad
        seen = await self._evaluated(await self.table.capture(self.hand), row, q, jaw_rad, self.arm.T_base_floor)
        if seen is None:
            return
        spread = self.robot.spread(self.arm.name)
        before = self.hand.q[3:]
        accepted = self.robot.correct(self.arm.name, seen)
        self.arm.cell.log.event(
            "wrist seen",
            arm=self.arm.name,
            accepted=accepted,
            spread_rad=None if spread is None else spread.round(4).tolist(),
            corrected_rad=(self.hand.q[3:] - before).round(4).tolist(),
        )
        self.nursery.start_soon(self._fit)

    def adopt(self) -> None:
        """Use what was learned so far, if the arm is at rest."""
        if self._better is not None and not self.robot.setpoint(self.arm.name).moving:
            self.robot.adopt(self.arm.name, self._better)
            self._better = None

    async def _evaluated(
        self, image: RgbdImage, row: int, q: NDArray[np.float64], jaw_rad: float, T_base_floor: SE3 | None
    ) -> Sighting | None:
        """Find the wrist in an image, and report it to the robot."""
        find = partial(sight, image, self.T_base_camera, self.hand.model, q, jaw_rad, T_base_floor)
        seen = await self.hand.compute("perception", self.settings.sighting_budget_s, find)
        if seen is None:
            self.arm.cell.log.event("wrist not seen", arm=self.arm.name)
        else:
            self.robot.saw(self.arm.name, row, seen)
        return seen

    async def _fit(self) -> None:
        learned = partial(self.robot.learned, self.arm.name)
        self._better = await self.hand.compute("calibration", self.settings.fit_budget_s, learned)
