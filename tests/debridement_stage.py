"""Debridement trials whose perception gets the true poses with a camera's noise: a hundred times faster."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import trio

from trocar.arms import fk
from trocar.eval import run as trial_run
from trocar.eval import staged
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.geometry import SE3, SO3
from trocar.perception.image import StereoImage
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.debridement.perception.fragments import SeenFragment
from trocar.tasks.debridement.task import Debridement

EXPOSURE_S = 0.033
HELD_M = 0.018


class Eyes:
    """Perception that reports the true poses with a camera's noise; a test may change what it sees.

    Attributes:
        lab: the laboratory.
        hidden: (arm, start, end) in s: when an arm's marks are hidden.
        frozen_s: time from which on the camera repeats one image.
        more: positions (3,) of fragments that it sees in addition.
    """

    def __init__(self):
        self.lab, self.hidden, self.frozen_s, self.more = None, (), np.inf, ()
        self.rng, self.count = np.random.default_rng(0), 0

    def place(self, number):
        return self.lab.world.free_pose(f"fragment{number}").translation_m

    def numbers(self):
        return range(len(self.lab.world.free_bodies))

    def tip(self, arm):
        world = self.lab.world
        return world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm))

    def fragments(self, image, T_world_camera, T_world_table, arms=None):
        places = [self.place(k) + self.rng.normal(0.0, 5e-4, 3) for k in self.numbers()]
        return [SeenFragment(np.array(p), np.array([0.012, 0.009]), 0.3, 0.004, 500) for p in (*places, *self.more)]

    def gripper(self, image, T_world_camera, model):
        arm = "left" if "left" in model.name else "right"
        if any(arm == who and start <= image.time_s <= end for who, start, end in self.hidden):
            return None
        T = self.tip(arm)
        turned = SO3.exp(self.rng.normal(0.0, 5e-3, 3)) @ T.rotation
        moved = T.translation_m + self.rng.normal(0.0, 2e-4, 3)
        return SimpleNamespace(T_world_tip=SE3.from_parts(turned, moved), jaw_rad=0.5, marks=4, residual_m=0.0)

    def gripper_window(self, *_, **__):
        return None

    def holding(self, image, T_world_camera, model, T_world_tip, jaw_rad):
        near = [np.linalg.norm(self.place(k) - self.tip(self.arm_of(model)).translation_m) for k in self.numbers()]
        return min(near) < HELD_M

    @staticmethod
    def arm_of(model):
        return "left" if "left" in model.name else "right"


class Camera:
    """A camera whose images show nothing but a running number."""

    def __init__(self, eyes, model):
        self.eyes, self.model, self.taken = eyes, model, []

    async def capture(self, window=None):
        await trio.sleep(EXPOSURE_S)
        eyes = self.eyes
        if eyes.lab.now_s() < eyes.frozen_s:
            eyes.count += 1
        picture = np.zeros((self.model.left.height, self.model.left.width, 3), dtype=np.uint8)
        picture[0, 0] = eyes.count % 251, eyes.count // 251, 0
        return StereoImage(picture, picture, self.model, eyes.lab.now_s())


def play(monkeypatch, tmp_path, eyes, *, seed=3, method="best", change=None, robot=None, **options):
    """Play a trial by ``run_trial`` with ``eyes`` as its perception, and return it.

    Args:
        monkeypatch: pytest's.
        tmp_path: for the session's files.
        eyes: the perception.
        seed: of the run.
        method: of the task.
        change: takes the scene and returns the one to play.
        robot: called with the laboratory before it runs, to plant faults.
        options: of the task.
    """
    task = Debridement(**options)
    config = RunConfig(task, method=method, difficulty="mild", seed=seed)
    if change is not None:
        lay = Debridement.scene
        monkeypatch.setattr(Debridement, "scene", lambda self, rng, station: change(lay(self, rng, station)))

    class Told(SimLaboratory):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            eyes.lab = self
            camera = Camera(eyes, self.cell.cameras["stereo"].model)
            self.cell = replace(self.cell, cameras={"stereo": camera})
            if robot is not None:
                robot(self)

    monkeypatch.setattr(staged, "SimLaboratory", Told)
    monkeypatch.setattr(trial_run, "pick_perception", lambda kind, name: eyes)
    return trial_run.run_trial(config, prepare(config, 0, tmp_path), 0)
