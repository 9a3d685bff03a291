"""What a recorder keeps of a world, tick by tick, and what of it can be seen; contacts, each counted once."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, fk
from trocar.geometry import SE3, SO3
from trocar.sim.record import FIRST_ROWS, CollidingPair, ContactMonitor, Recorder, fixed_poses, solids_of
from trocar.sim.world import TaskWorld, World

PLACED = SE3.from_parts(SO3.exp([0.1, 0.2, 0.3]), [0.3, 0.0, 0.2])
SHAPE = mujoco.mjtGeom
BODIES = {
    "ball": {"type": SHAPE.mjGEOM_SPHERE, "size": (0.01, 0, 0)},
    "bar": {"type": SHAPE.mjGEOM_CAPSULE, "size": (0.01, 0.02, 0)},
}


class Toys(TaskWorld):
    def add(self, spec):
        world, box = spec.worldbody, {"type": SHAPE.mjGEOM_BOX, "size": (0.1, 0.2, 0.3)}
        world.add_geom(type=SHAPE.mjGEOM_PLANE, size=(1, 1, 0.1))
        world.add_geom(pos=(1, 2, 3), rgba=(0.1, 0.2, 0.3, 1), group=2, **box)
        for unseen in (3, 4):
            world.add_geom(group=unseen, **box)
        post = world.add_body(name="post", pos=(4, 5, 6))
        post.add_geom(type=SHAPE.mjGEOM_CYLINDER, size=(0.01, 0.05, 0), pos=(0, 0, 0.1))
        for name, shape in BODIES.items():
            body = world.add_body(name=name)
            body.add_freejoint()
            body.add_geom(**shape)


@pytest.fixture
def world():
    return World({"a": PSM_CLASSIC}, {"a": PLACED}, Toys())


def test_every_tick_has_joints_jaws_bodies_and_tips(world):
    def told(by):
        return SimpleNamespace(q=PSM_CLASSIC.middle + by, jaw_rad=0.3 + by)

    robot = SimpleNamespace(read=lambda name: told(0.02), setpoint=lambda name: told(0.01))
    recorder, rng = Recorder(world, robot, lambda name: 0.25), np.random.default_rng(0)
    recorder.desired_of = SimpleNamespace(setpoint=lambda name: told(0.0))
    placed = {name: [] for name in BODIES}
    for tick in range(3):
        world.place_arm("a", PSM_CLASSIC.middle + 0.03 * tick, 0.2)
        for number, name in enumerate(world.free_bodies):
            pose = SE3.from_parts(SO3.exp(rng.normal(size=3)), rng.normal(size=3))
            world.data.qpos[world._free_qpos[number]] = [*pose.translation_m, *pose.rotation.as_quaternion()]
            placed[name].append(pose.matrix)
        recorder.observe(0.01 * tick)
    record = recorder.record(())
    assert_allclose(record.times_s, [0, 0.01, 0.02])
    for name, poses in placed.items():
        assert_allclose(record.T_world_body[name].matrix, poses, atol=1e-12)
        assert_allclose(recorder.free_poses()[name][:, :3], np.array(poses)[:, :3, 3])
    true = [np.append(PSM_CLASSIC.middle + 0.03 * tick, 0.2) for tick in range(3)]
    assert_allclose(record.joints["a"], true)
    assert_allclose(record.T_world_tip["a"].matrix, (PLACED @ fk(PSM_CLASSIC, np.array(true)[:, :6])).matrix)
    for kind, by, jaw_rad in (("desired", 0.0, 0.25), ("commanded", 0.01, 0.25), ("measured", 0.02, 0.32)):
        assert_allclose(recorder.joints(kind)["a"], [np.append(PSM_CLASSIC.middle + by, jaw_rad)] * 3)


def test_a_record_grows_and_what_was_read_of_it_stays(world):
    robot = SimpleNamespace(read=lambda name: rest, setpoint=lambda name: rest)
    rest = SimpleNamespace(q=PSM_CLASSIC.middle, jaw_rad=0.3)
    looked, alone = (Recorder(world, robot, lambda name: 0.3) for _ in range(2))
    ticks, early = 2 * FIRST_ROWS + 3, {}
    for tick in range(ticks):
        world.data.qpos[world._free_qpos[0]] = [0.001 * tick, 0, 0, 1, 0, 0, 0]
        world.place_arm("a", PSM_CLASSIC.middle + 1e-5 * tick, 0.2)
        looked.observe(0.01 * tick), alone.observe(0.01 * tick)
        if tick in (0, FIRST_ROWS - 1, FIRST_ROWS, ticks - 2):
            early[tick] = looked.record(())
    once, often = alone.record(()), looked.record(())
    for record, rows in ((often, ticks), *((record, tick + 1) for tick, record in early.items())):
        for name, poses in (*record.T_world_body.items(), *record.T_world_tip.items()):
            whole = (once.T_world_body | once.T_world_tip)[name].matrix
            assert np.array_equal(poses.matrix, whole[:rows])
        assert np.array_equal(record.times_s, 0.01 * np.arange(rows))
        assert np.array_equal(record.joints["a"], once.joints["a"][:rows])
    with pytest.raises(ValueError, match="read-only"):
        often.times_s[0] = 1.0


def test_everything_that_is_seen_is_a_solid_of_its_size_but_planes(world):
    world.step(1)
    found = {(solid.body, solid.shape): solid for solid in solids_of(world)}
    assert {shape for body, shape in found if body == "world"} == {"box"}
    assert sum(solid.body == "world" for solid in solids_of(world)) == 1, "what no camera sees is left out"
    box, post = found["world", "box"], found["post", "cylinder"]
    assert_allclose(box.size_m, [0.1, 0.2, 0.3])
    assert_allclose(box.T_body_solid.translation_m, [1, 2, 3])
    assert_allclose(box.rgba, [0.1, 0.2, 0.3, 1], rtol=1e-6)
    assert_allclose(post.size_m, [0.01, 0.05])
    assert_allclose(post.T_body_solid.translation_m, [0, 0, 0.1])
    assert found["ball", "sphere"].size_m == (0.01,) and found["bar", "capsule"].size_m == (0.01, 0.02)
    assert box.vertices_m.shape == (0, 3)
    finger = found["a_finger_left", "hull"]
    assert finger.size_m == ()
    corners = {tuple(np.rint(1e6 * p).astype(int)) for p in finger.T_body_solid.apply(finger.vertices_m)}
    assert corners == {tuple(np.rint(1e6 * p).astype(int)) for p in PSM_CLASSIC.instrument.finger_m(1)}
    mujoco.mj_kinematics(world.model, world.data)
    fixed = fixed_poses(world)
    assert set(fixed) == {"world", "post", "a_base"}
    assert_allclose(fixed["post"].translation_m, [4, 5, 6])
    assert_allclose(fixed["a_base"].matrix, PLACED.matrix, atol=1e-9)


HEAVY_KG, LIGHT_KG = 0.5, 0.001
BALL = """<mujoco><worldbody><geom name="table" type="plane" size="1 1 .1"/>
<body name="ball"><freejoint/><geom name="ball" type="sphere" size=".01" mass="{}"/></body></worldbody></mujoco>"""
HIT = CollidingPair("a", "arm", "table")


def pressed(mass_kg, owners=(-1, 0)):
    """A ball, as a part of arm ``a``, that is pressed into a table as deep as one likes; and who watches it."""
    model = mujoco.MjModel.from_xml_string(BALL.format(mass_kg))
    data = mujoco.MjData(model)
    asked, counted = [], []

    def collision(first, second):
        asked.append({first, second})
        return HIT

    def counts(hit, normal):
        assert normal.shape == (3,)
        counted.append(abs(normal[2]))
        return True

    task = SimpleNamespace(collision=collision, counts=counts)
    world = SimpleNamespace(model=model, data=data, geom_arm=np.array(owners), arm_names=("a", "b"), task=task)
    touches = ContactMonitor(world)

    def look(time_s, depth_m):
        data.qpos[:3] = 0.01 * round(time_s, 2), 0.0, 0.01 - depth_m
        mujoco.mj_forward(model, data)
        touches.observe(time_s)

    return SimpleNamespace(look=look, touches=touches, task=task, asked=asked, counted=counted)


@pytest.fixture
def press():
    return pressed(HEAVY_KG)


def test_a_touch_counts_once_with_its_time_its_force_and_its_place(press):
    for tick, depth_mm in enumerate([0.0, 1.0, 3.0, 2.0, 0.0, 0.0]):
        press.look(0.01 * tick, 1e-3 * depth_mm - 1e-4)
    (collision,) = press.touches.collisions()
    assert (collision.time_s, collision.end_s) == (0.01, 0.03)
    assert (collision.arm, collision.what, collision.against) == HIT
    assert collision.force_n > 0.5
    assert collision.p_world_m[0] == pytest.approx(0.01 * 0.02), "the place of the largest force"
    assert press.asked[0] == {0, 1} and press.counted[0] == pytest.approx(1.0)


@pytest.mark.parametrize(("gap_s", "collisions"), [(0.18, 1), (0.22, 2)])
def test_a_touch_that_comes_back_at_once_is_the_same(press, gap_s, collisions):
    for time_s, depth_m in ((1.0, 1e-3), (1.0 + gap_s / 2, -1e-3), (1.0 + gap_s, 1e-3)):
        press.look(time_s, depth_m)
    found = press.touches.collisions()
    assert len(found) == collisions
    assert [c.time_s for c in found] == [1.0, 1.0 + gap_s][:collisions]
    assert found[-1].end_s == pytest.approx(1.0 + gap_s)


def test_a_touch_without_force_is_none():
    press = pressed(LIGHT_KG)
    press.look(0.0, 1e-4)
    assert press.asked == [{0, 1}]
    assert press.counted == [] and press.touches.collisions() == ()


def test_what_the_task_does_not_count_is_none(press):
    press.task.counts = lambda pair, normal: False
    press.look(0.0, 1e-3)
    assert press.touches.collisions() == ()
    press.task.collision = lambda first, second: None
    press.look(0.1, 1e-3)
    assert press.touches.collisions() == ()


@pytest.mark.parametrize(("owners", "who"), [((1, 0), ("b", "a")), ((0, 1), ("a", "b")), ((0, 0), ("a", "a"))])
def test_two_arms_that_touch_are_hits_whatever_the_task_says(owners, who):
    press = pressed(HEAVY_KG, owners)
    press.look(0.0, 1e-3)
    (collision,) = press.touches.collisions()
    first, second = who
    assert (collision.arm, collision.what, collision.against) == (first, "arm", second)
    assert press.asked == []


@pytest.mark.parametrize("owners", [(-1, 1), (1, -1), (-1, -1)])
def test_the_task_is_asked_about_everything_else(owners):
    press = pressed(HEAVY_KG, owners)
    press.look(0.0, 1e-3)
    assert press.asked == [{0, 1}]


def test_half_a_newton_is_a_hit_and_the_first_of_equal_forces_gives_the_place(press, monkeypatch):
    force_n = []
    monkeypatch.setattr(
        "trocar.sim.record.mujoco.mj_contactForce", lambda m, d, k, into: into.__setitem__(0, force_n[-1])
    )
    for tick, force in enumerate((0.45, 0.7, 0.7, 0.6)):
        force_n.append(force)
        press.look(0.01 * tick, 1e-3)
    (collision,) = press.touches.collisions()
    assert (collision.time_s, collision.end_s, collision.force_n) == (0.01, 0.03, 0.7)
    assert collision.p_world_m[0] == pytest.approx(0.01 * 0.01)
