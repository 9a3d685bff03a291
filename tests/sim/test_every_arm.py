"""What every registered arm must do in the simulator."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, SOLIDS, capsules, fk, frames, wrist_depth_m
from trocar.geometry import SE3, SO3
from trocar.lab import TRANSMISSIONS, Station, StationArm
from trocar.lab.flaws import Difficulty
from trocar.lab.session import draw_session
from trocar.motion import rest_to_rest
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.world import World

EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
T_WORLD_BASE = SE3.from_parts(SO3.exp([0.3, -0.7, 1.1]), [0.1, -0.2, 0.4])


def station_of(arm, transmission="stiff", limits=None) -> Station:
    """A laboratory with this one arm, its base anyhow in space, nothing on the table."""
    return Station(
        name=f"one {arm.name}",
        about="for tests",
        arms={
            "only": StationArm(
                model=arm,
                transmission=TRANSMISSIONS[transmission],
                transmission_name=transmission,
                limits=limits or arm.motion_limits,
                T_world_base=T_WORLD_BASE,
            )
        },
        cameras={},
        difficulty=Difficulty.of("mild"),
    )


def laboratory_of(arm, transmission="stiff", seed=0, limits=None) -> SimLaboratory:
    rng = np.random.default_rng(seed)
    return SimLaboratory(draw_session(station_of(arm, transmission, limits), rng), rng=rng)


def random_q(arm, rng, share=0.9):
    middle, half = arm.middle, share * (arm.upper - arm.lower) / 2
    return middle + half * rng.uniform(-1.0, 1.0, 6)


@EVERY_ARM
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_forward_kinematics_is_where_mujoco_puts_the_bodies(arm, seed):
    world = World({"only": arm}, {"only": T_WORLD_BASE})
    q = random_q(arm, np.random.default_rng(seed), share=1.0)
    world.place_arm("only", q, 0.3)
    poses = T_WORLD_BASE @ frames(arm, q)
    for link in range(1, 7):
        assert np.abs(world.pose(f"only_link{link}").matrix - poses[link].matrix).max() < 1e-9
    y_of_link6 = world.pose("only_link6").apply([0.0, arm.tip_length_m, 0.0])
    assert np.abs((T_WORLD_BASE @ fk(arm, q)).translation_m - y_of_link6).max() < 1e-9


@EVERY_ARM
def test_the_shaft_runs_from_the_remote_centre_to_the_wrist(arm):
    """A long cylinder whose axis goes through the remote centre, on the near side of the wrist, whatever the joints."""
    world = World({"only": arm}, {"only": T_WORLD_BASE})
    shaft = world.model.geom("only_shaft").id
    radius, half_m = world.model.geom_size[shaft, :2]
    deep = 0
    for seed in range(40):
        q = random_q(arm, np.random.default_rng(seed))
        if wrist_depth_m(arm, q) < 0.03:
            continue  # a Raven's instrument can be drawn out of its port
        deep += 1
        world.place_arm("only", q, 0.0)
        wrist = (T_WORLD_BASE @ frames(arm, q))[5].translation_m
        centre = T_WORLD_BASE.translation_m
        axis = world.data.geom_xmat[shaft].reshape(3, 3)[:, 2]
        ends = world.data.geom_xpos[shaft] + np.outer([-half_m, half_m], axis)
        near, far = sorted(ends, key=lambda p: np.linalg.norm(p - wrist))
        to_centre = (centre - wrist) / np.linalg.norm(centre - wrist)
        assert np.linalg.norm(near - wrist) < 0.03
        assert np.linalg.norm(np.cross(near - wrist, to_centre)) < 1e-9
        assert np.linalg.norm(np.cross(far - wrist, to_centre)) < 1e-9
        assert (far - near) @ to_centre > 0, "the shaft points away from the remote centre"
    assert deep > 10
    assert radius == pytest.approx(arm.instrument.shaft_radius_m)


@EVERY_ARM
def test_the_capsules_hold_the_solids_of_the_simulator(arm):
    """What guard and planners take for the instrument is where the simulator has it."""
    world = World({"only": arm}, {"only": T_WORLD_BASE})
    geoms = {"shaft": "shaft", "left finger": "finger_left", "right finger": "finger_right"}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        q, jaw = random_q(arm, rng), rng.uniform(0.0, 0.5 * arm.jaw.upper)
        world.place_arm("only", q, jaw)
        found = capsules(arm, q, jaw).moved(T_WORLD_BASE)
        for solid, geom in geoms.items():
            number = SOLIDS.index(solid)
            (a, b), radius = found.ends_m[number], found.radii_m[number]
            points = _surface(world, f"only_{geom}")
            share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            outside = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1) - radius
            assert outside.max() < 1e-6, f"{solid} of {arm.name} sticks out of its capsule"


def _surface(world, name):
    """Return corners of a hull, or points on the mantle of a cylinder without its ends, in the world."""
    geom = world.model.geom(name)
    if geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = geom.dataid[0]
        start, count = world.model.mesh_vertadr[mesh], world.model.mesh_vertnum[mesh]
        local = world.model.mesh_vert[start : start + count].astype(float)
    else:
        radius, half = geom.size[:2]
        turn = np.linspace(0, 2 * np.pi, 12)
        ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn])
        local = np.concatenate([ring + [0, 0, z] for z in np.linspace(-half + 0.02, half - 0.02, 9)])
    return local @ world.data.geom_xmat[geom.id].reshape(3, 3).T + world.data.geom_xpos[geom.id]


@EVERY_ARM
def test_the_jaws_meet(arm):
    """Driven shut they touch each other along their length, in the middle of the arm's tip."""
    laboratory = laboratory_of(arm)

    async def script(cell):
        await cell.robot.jaw("only", 0.5 * arm.jaw.upper)
        opened = laboratory.world.jaw_rad("only")
        await cell.robot.jaw("only", max(0.0, arm.jaw.lower))
        await cell.clock.sleep(0.3)
        assert opened == pytest.approx(0.5 * arm.jaw.upper, abs=0.05)

    assert laboratory.run(script, 10.0)
    world = laboratory.world
    assert abs(world.jaw_rad("only")) < 0.02
    tip = T_WORLD_BASE @ fk(arm, world.joints("only"))
    inner = np.array([[arm.instrument.finger_length_m - arm.instrument.tip_chamfer_m, 0.0, 0.0]])
    ends = [world.pose(f"only_finger_{side}").apply(inner)[0] for side in ("left", "right")]
    assert np.linalg.norm(ends[0] - ends[1]) < 0.3e-3
    across = tip.inverse().apply(np.mean(ends, axis=0))[:2]
    assert np.abs(across).max() < 0.2e-3


@EVERY_ARM
def test_ten_seconds_of_random_motion_within_the_limits_track_to_half_a_millimetre(arm):
    laboratory = laboratory_of(arm)
    rng = np.random.default_rng(5)

    async def script(cell):
        while cell.clock.now_s() < 10.0:
            goal = cell.robot.setpoint("only").q + 0.35 * (random_q(arm, rng) - cell.robot.setpoint("only").q)
            await cell.robot.move({"only": rest_to_rest(cell.robot.setpoint("only").q, goal, arm.motion_limits)})

    assert laboratory.run(script, 60.0)
    recorder = laboratory.recorder
    commanded, true = (fk(arm, recorder.joints(kind)["only"][:, :6]).translation_m for kind in ("commanded", "true"))
    assert np.ptp(commanded, axis=0).max() > 0.03, "the arm hardly moved"
    assert np.linalg.norm(commanded - true, axis=1).max() < 0.5e-3


@pytest.mark.parametrize("transmission", TRANSMISSIONS)
def test_every_transmission_moves_an_arm(transmission):
    arm = ARMS["raven2-left" if transmission == "raven2" else "psm-classic"]
    laboratory = laboratory_of(arm, transmission, seed=3)

    async def script(cell):
        start = cell.robot.setpoint("only").q
        await cell.robot.move({"only": rest_to_rest(start, start + 0.2 * (arm.upper - start), arm.motion_limits)})

    before = laboratory.world.joints("only")
    assert laboratory.run(script, 20.0)
    assert np.abs(laboratory.world.joints("only") - before).max() > 0.02
    assert np.array_equal(laboratory.cell.robot.read("only").q, laboratory.cell.robot.setpoint("only").q)
