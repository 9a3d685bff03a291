"""A collection on a real arm: images of its spheres, at rest after each command."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trocar.arms import fk
from trocar.cell import Cell
from trocar.collect.motion import depth_camera
from trocar.collect.plan import CollectionPlan, Listener
from trocar.errors import InvalidInput
from trocar.geometry import shown
from trocar.hardware.laboratory import registered
from trocar.lab import Station
from trocar.motion import rest_to_rest
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.perception.spheres import find_spheres

SETTLE_S = 0.2
"""An arm rests this long before its image is exposed."""
REPEATED = 30
"""A resumed collection first repeats this many rows without images. A cable's state depends on earlier commands, and
this many swing the wrist through all its slack."""


class RobotCollection(CollectionPlan):
    """The calibration of one real arm by the spheres that it wears; it uses its seeds as the simulated one does.

    Args:
        station: the station, with its bases and camera as registered.
        arm: the arm's name.
        seeds: seeds of the motion.
        rows: number of samples.
        wide: whether the motion is the short one of wide swings.

    Raises:
        InvalidInput: the spheres leave the camera's view, or the tip leaves the arm's workspace.
    """

    def __init__(self, station: Station, arm: str, seeds: np.random.SeedSequence, rows: int, *, wide: bool = False):
        self._camera, self._there = depth_camera(station), station.arm(arm)
        camera = station.cameras[self._camera]
        lens, T_world_base = camera.model_registered, registered(self._there)
        assert isinstance(lens, Intrinsics)
        motion, _, _, _, search = seeds.spawn(5)
        model, box = self._there.model, station.calibration_box(arm)
        super().__init__(
            arm, model, lens, registered(camera), T_world_base, box, rows, motion=motion, search=search, wide=wide
        )
        if self._there.workspace_m is not None:
            tips_m = (T_world_base @ fk(model, self.q_cmd)).translation_m
            lower, upper = self._there.workspace_m
            out_m = float(np.max([lower - tips_m, tips_m - upper]))
            if out_m > 0:
                problem = f"lets the tip leave the arm's workspace by {shown(out_m, 'm', '.4f')}"
                raise InvalidInput(f"the calibration of arm {arm!r}", problem, "set another range, or another box")

    async def collect(self, cell: Cell, path: Path, listener: Listener) -> None:
        """Collect the rows that a file does not have; each row is saved as soon as it was seen.

        Args:
            cell: the cell with the arm and the camera.
            path: the file.
            listener: called after each row.

        Raises:
            TrocarError: the file is of another collection, the arm stopped, or no image came.
        """
        found = self.kept(path)
        origin_s = cell.clock.now_s() - (self.t_s[len(found) - 1] if found else 0.0)
        for row in range(max(0, len(found) - REPEATED), len(self.q_cmd)):
            await self._go(cell, row)
            if row < len(found):
                continue
            centers = self.unknown
            if row >= self.unseen:
                await cell.clock.sleep(SETTLE_S)
                image = await cell.cameras[self._camera].capture(self.window(row))
                assert isinstance(image, RgbdImage)  # its lens is one that sees depth
                centers, _ = await cell.clock.compute(lambda image=image: find_spheres(image, self.fixture), 0.0)
            self.t_s[row] = cell.clock.now_s() - origin_s
            found.append(centers)
            self.keep(found, path)
            listener(row + 1, len(self.q_cmd))

    async def _go(self, cell: Cell, row: int) -> None:
        """Move to a row's command; raise the cause if the arm does not get there."""
        motion = rest_to_rest(cell.robot.setpoint(self.arm).q, self.q_cmd[row], self._there.limits)
        result = (await cell.robot.move({self.arm: motion}))[self.arm]
        if result.cause is not None:
            raise result.cause
