"""ContactMonitor that should not have happened, each counted once."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from trocar.sim.record import CollidingPair
from trocar.sim.recorder import ContactMonitor

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
    press.look(0.0, 1e-3)
    press.look(gap_s / 2, -1e-3)
    press.look(gap_s, 1e-3)
    found = press.touches.collisions()
    assert len(found) == collisions
    assert [c.time_s for c in found] == [0.0, gap_s][:collisions] and found[-1].end_s == pytest.approx(gap_s)


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
        "trocar.sim.recorder.mujoco.mj_contactForce", lambda m, d, k, into: into.__setitem__(0, force_n[-1])
    )
    for tick, force in enumerate((0.45, 0.7, 0.7, 0.6)):
        force_n.append(force)
        press.look(0.01 * tick, 1e-3)
    (collision,) = press.touches.collisions()
    assert (collision.time_s, collision.end_s, collision.force_n) == (0.01, 0.03, 0.7)
    assert collision.p_world_m[0] == pytest.approx(0.01 * 0.01)
