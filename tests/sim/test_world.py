"""The physics of one cell behind names: arms that are put and driven, bodies that are free, time that passes."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC
from trocar.errors import UnknownName
from trocar.geometry import SE3, SO3
from trocar.sim.record import CollidingPair
from trocar.sim.spec import Servo
from trocar.sim.world import PhysicsError, TaskWorld, World

PLACED = SE3.from_parts(SO3.exp([0.1, 0.2, 0.3]), [0.3, 0.0, 0.2])


class Balls(TaskWorld):
    """Two balls in the air, and a post that stands."""

    acted = 0

    def add(self, spec):
        for x, name in enumerate(("red", "post", "blue")):
            body = spec.worldbody.add_body(name=name, pos=(x + 1, 0, 5))
            if name != "post":
                body.add_freejoint()
            body.add_geom(name=f"{name}_ball", size=(0.01, 0, 0))

    def act(self):
        self.acted += 1


@pytest.fixture
def world():
    return World({"a": PSM_CLASSIC}, {"a": PLACED}, Balls())


def test_a_body_that_is_not_there_is_told_with_those_that_are(world):
    with pytest.raises(
        UnknownName, match=r"free body 'bleu' is unknown; did you mean 'blue'\? choose one of red, blue$"
    ):
        world.free_pose("bleu")
    with pytest.raises(UnknownName, match=r"free body 'post' is unknown; choose one of red, blue$"):
        world.free_pose("post")
    with pytest.raises(
        UnknownName, match=r"body 'pots' is unknown; did you mean 'post'\? choose one of .*red, post, blue"
    ):
        world.pose("pots")


def test_free_bodies_are_known_by_name_and_where_they_are(world):
    assert world.free_bodies == ("red", "blue")
    assert_allclose(world.free_poses(), [[1, 0, 5, 1, 0, 0, 0], [3, 0, 5, 1, 0, 0, 0]])
    turned = SO3.exp([0.3, -0.4, 0.5])
    at = world.data.joint(world.model.body("blue").jntadr[0])
    at.qpos[:] = [7, 8, 9, *turned.as_quaternion()]
    assert_allclose(world.free_pose("blue").matrix, SE3.from_parts(turned, [7, 8, 9]).matrix, atol=1e-12)
    mujoco.mj_kinematics(world.model, world.data)
    assert_allclose(world.pose("blue").matrix, world.free_pose("blue").matrix, atol=1e-12)
    assert_allclose(world.pose("post").translation_m, [2, 0, 5])
    assert world.geom_arm[world.model.geom("post_ball").id] == -1
    assert [world.model.geom(g).name for g in world.geoms("red")] == ["red_ball"]
    fingers = [world.model.geom(f"a_finger_{side}").id for side in ("left", "right")]
    assert list(world.arms["a"].fingers) == fingers


def test_the_task_acts_before_every_few_steps_and_a_broken_physics_is_an_error(world, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file of the working directory
    world.step(4)
    assert world.task.acted == 1 and world.time_s == pytest.approx(0.004)
    fallen = world.free_poses()[0]
    assert 5 - 0.5 * 9.81 * 0.005**2 < fallen[2] < 5.0
    world.data.qvel[:] = np.nan
    with pytest.raises(PhysicsError, match="unstable at"):
        world.step(1)


def test_an_arm_is_put_where_it_is_told_with_its_jaws_and_rests_there(world):
    q = PSM_CLASSIC.middle + 0.1
    world.data.qvel[:] = 1.0
    world.place_arm("a", q, 0.4)
    assert_allclose(world.joints("a"), q)
    assert world.jaw_rad("a") == pytest.approx(0.4)
    joints = [world.data.joint(f"a_jaw_{side}").qpos[0] for side in ("left", "right")]
    assert_allclose(joints, [0.2, -0.2])
    assert not world.data.qvel[world.arms["a"].dof].any()
    world.drive_arm("a", q, np.arange(6.0), 0.6)
    assert_allclose(world.data.ctrl[world.arms["a"].drive], q)
    assert_allclose(world.data.ctrl[world.arms["a"].feed], np.arange(6.0) * Servo().damping)
    assert world.data.ctrl[world.arms["a"].jaw_drive] == pytest.approx(0.3)
    before_s = world.time_s
    world.step(3)
    assert world.time_s == pytest.approx(before_s + 0.003)
    world.settle(0.01)
    assert world.time_s == 0.0


def test_only_bodies_of_a_task_are_free():
    bare = World({"a": PSM_CLASSIC}, {"a": PLACED})
    assert bare.free_bodies == () and bare.free_poses().shape == (0, 7)


def test_a_body_without_a_name_gets_one_for_replays():
    class Nameless(TaskWorld):
        def add(self, spec):
            spec.worldbody.add_body().add_geom(size=(0.01, 0, 0))

    model = World({}, {}, Nameless()).model
    assert all(model.body(b).name for b in range(model.nbody)) and model.nbody == 2


class Sleepy(TaskWorld):
    sleeps = True


def test_it_is_empty_and_counts_what_it_is_asked_about():
    task = TaskWorld()
    assert task.counts(CollidingPair("a", "arm", "b"), np.array([0.0, 0.0, 1.0])) is True
    assert task.collision(0, 1) is None and task.assistants() == {}
    record = object()
    assert task.truth(record) is record and task.arrays(record) == {}


@pytest.mark.parametrize(("task", "sleeps"), [(TaskWorld(), False), (Sleepy(), True)])
def test_bodies_that_lie_still_are_left_out_only_where_the_task_lets_them(task, sleeps):
    model = World({}, {}, task).model
    assert bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP) == sleeps
