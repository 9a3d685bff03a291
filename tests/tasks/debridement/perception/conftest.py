"""One world with six fragments and both arms under a small stereo pair; tests move what they need and put it back."""

import mujoco
import numpy as np
import pytest
from stereo_scenes import CAMERA, RIG, STATION, T_WORLD_TABLE, Awake, set_arm, show, stereo_cameras

from trocar.arms import ik
from trocar.perception.image import StereoRig
from trocar.sim.world import World
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.scene import lay_out

SMALL = StereoRig(RIG.left.binned(2), RIG.right.binned(2), RIG.T_left_right)


class Stage:
    """A world and its eyes."""

    def __init__(self):
        fixtures, rng = STATION.T_world_fixture, np.random.default_rng(3)
        self.scene = lay_out(fixtures["table"], fixtures["receptacle"], Workspace(), rng)
        task = Awake(self.scene)
        bases = {name: arm.T_world_base for name, arm in STATION.arms.items()}
        self.world = World(STATION.models, bases, task)
        self.park()
        task.start(self.world)
        self.world.settle(0.5)
        self.eyes = stereo_cameras(self.world, SMALL)
        self.T_world_camera, self.T_world_table = CAMERA.T_world_camera, T_WORLD_TABLE
        self.rest = self.world.data.qpos.copy()

    def park(self):
        for name, arm in STATION.arms.items():
            set_arm(self.world, name, arm.park_q(), arm.park_jaw_rad)

    def reset(self):
        self.world.data.qpos[:] = self.rest

    def move(self, fragment, p_world_m):
        start = self.world.model.joint(fragment).qposadr[0]
        self.world.data.qpos[start : start + 3] = p_world_m

    def put(self, name, T_world_tip, jaw_rad):
        arm = STATION.arms[name]
        set_arm(self.world, name, ik(arm.model, arm.T_world_base.inverse() @ T_world_tip), jaw_rad)

    def show(self, seed=0):
        mujoco.mj_kinematics(self.world.model, self.world.data)
        return show(self.world, self.eyes, np.random.default_rng(seed))


@pytest.fixture(scope="session")
def only_stage():
    return Stage()


@pytest.fixture
def stage(only_stage):
    only_stage.reset()
    return only_stage
