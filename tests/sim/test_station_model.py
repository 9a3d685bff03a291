"""Stations as MJCF for other programs: names, kinematics and limits of their arms, at rest and following commands."""

import mujoco
import numpy as np
import pytest

from trocar.arms import ARMS, fk
from trocar.eval import TASKS
from trocar.geometry import SE3, SO3
from trocar.lab import TRANSMISSIONS, Station, StationArm, built_in_stations, load_station
from trocar.perception.image import StereoRig
from trocar.sim.station_model import PARK, station_mjcf, station_spec
from trocar.sim.world import World

BENCHES = {
    f"bench of {name}": Station(
        name=f"bench of {name}",
        about="for tests",
        arms={
            "only": StationArm(
                arm,
                TRANSMISSIONS["stiff"],
                "stiff",
                arm.motion_limits,
                SE3.from_parts(SO3.exp([0.3, -0.7, 1.1]), [0.1, 0, 1]),
            )
        },
        cameras={},
    )
    for name, arm in ARMS.items()
}
STATIONS = {name: load_station(name) for name in built_in_stations()} | BENCHES
EVERY_STATION = pytest.mark.parametrize("station", STATIONS.values(), ids=STATIONS)


def loaded(station, task=None):
    return station_spec(station, task).compile()


def parked(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(PARK).id)
    mujoco.mj_forward(model, data)
    return data


def site(data, name):
    return SE3.from_parts(SO3(data.site(name).xmat.reshape(3, 3)), data.site(name).xpos)


@EVERY_STATION
def test_tips_are_where_the_forward_kinematics_has_them(station):
    model = loaded(station)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(10):
        for name, arm in station.models.items():
            q = rng.uniform(arm.lower, arm.upper)
            for joint, value in zip(arm.joints, q, strict=True):
                data.joint(f"{name}_{joint.name}").qpos = value
            mujoco.mj_forward(model, data)
            base, tip = station.arms[name].T_world_base, fk(arm, q)
            assert np.abs(site(data, f"{name}_base").matrix - base.matrix).max() < 1e-9
            assert np.abs(site(data, f"{name}_tip").matrix - (base @ tip).matrix).max() < 1e-9
            assert np.abs(data.sensor(f"{name}_tip_position").data - tip.translation_m).max() < 1e-9
            turn = SO3.from_quaternion(data.sensor(f"{name}_tip_orientation").data)
            assert np.abs(turn.matrix - tip.rotation.matrix).max() < 1e-9


@EVERY_STATION
def test_each_joint_has_its_range_an_actuator_and_sensors_by_name(station):
    model, count = loaded(station), len(station.arms)
    assert (model.nu, model.nsensor) == (7 * count, 22 * count)
    for name, arm in station.models.items():
        for joint in arm.joints:
            label = f"{name}_{joint.name}"
            for limits in (model.joint(label).range, model.actuator(label).ctrlrange):
                assert limits == pytest.approx([joint.lower, joint.upper], abs=1e-12)
            assert model.actuator(label).trnid[0] == model.joint(label).id
            for what in ("position", "velocity", "effort"):
                assert model.sensor(f"{label}_{what}").dim == 1
        assert model.actuator(f"{name}_jaw").ctrlrange == pytest.approx([arm.jaw.lower, arm.jaw.upper])
    for name, camera in station.cameras.items():
        pair = isinstance(camera.model, StereoRig)
        lens, label = (camera.model.left, f"{name}_left") if pair else (camera.model, name)
        assert tuple(model.cam_resolution[model.camera(label).id]) == (lens.width, lens.height)
    for name, T in station.T_world_fixture.items():
        assert model.site(name).pos == pytest.approx(T.translation_m)


@EVERY_STATION
def test_cameras_see_what_the_stations_do(station):
    """MuJoCo's look along -z with y up: a point ahead of ours, to the right and below its axis, is so in theirs."""
    model = loaded(station)
    data = parked(model)
    for name, camera in station.cameras.items():
        eyes = {name: (camera.model, camera.T_world_camera)}
        if isinstance(camera.model, StereoRig):
            rig = camera.model
            right = camera.T_world_camera @ rig.T_left_right
            eyes = {f"{name}_left": (rig.left, camera.T_world_camera), f"{name}_right": (rig.right, right)}
        for label, (lens, T) in eyes.items():
            assert model.camera(label).fovy[0] == pytest.approx(np.degrees(2 * np.arctan(lens.height / 2 / lens.fy)))
            pose = SE3.from_parts(SO3(data.camera(label).xmat.reshape(3, 3)), data.camera(label).xpos)
            assert pose.inverse().apply(T.apply([0.1, 0.2, 1.0])) == pytest.approx([0.1, -0.2, -1.0])


@EVERY_STATION
def test_the_table_is_as_deep_as_the_lowest_fixture_and_all_is_in_view(station):
    model = loaded(station)
    fixtures = station.T_world_fixture
    names = {model.geom(g).name for g in range(model.ngeom)}
    assert ("table" in names) == bool(fixtures)
    if fixtures:
        lowest = fixtures.get("table", min(fixtures.values(), key=lambda T: T.translation_m[2]))
        assert model.geom("table").pos[2] == pytest.approx(lowest.translation_m[2])
        assert model.geom("table").rgba[3] == 1.0
    places = [
        T for arm in station.arms.values() for T in (arm.T_world_base, arm.T_world_base @ fk(arm.model, arm.park_q()))
    ]
    points = np.array([T.translation_m for T in places])
    assert model.stat.center == pytest.approx(points.mean(axis=0), abs=6e-4)
    assert model.stat.extent == pytest.approx(0.15 + np.ptp(points, axis=0).max(), abs=6e-4)
    lamp = model.light("lamp")
    assert lamp.pos == pytest.approx(points.mean(axis=0) + [0, 0, 1])
    data = parked(model)
    assert data.time == 0.0
    for name, arm in station.arms.items():
        assert [data.joint(f"{name}_jaw_{side}").qpos[0] for side in ("left", "right")] == pytest.approx(
            [arm.park_jaw_rad / 2, -arm.park_jaw_rad / 2]
        )
        drives = [model.actuator(f"{name}_{joint.name}").id for joint in arm.model.joints]
        assert data.ctrl[drives] == pytest.approx(arm.park_q())
        assert data.ctrl[model.actuator(f"{name}_jaw").id] == pytest.approx(arm.park_jaw_rad)


@EVERY_STATION
def test_parked_it_stays_as_the_station_says_and_goes_where_it_is_told(station):
    model = loaded(station)
    data, targets = parked(model), {}
    for name, arm in station.arms.items():
        q = arm.park_q()
        assert [data.joint(f"{name}_{j.name}").qpos[0] for j in arm.model.joints] == pytest.approx(q.tolist())
        targets[name] = q + 0.05 * np.where(q < arm.model.middle, 1, -1) * [1, 1, 0.1, 1, 1, 1]
    before = data.qpos.copy()
    mujoco.mj_step(model, data, 300)
    assert np.abs(data.qpos - before).max() < 1e-6, "gravity moves it"
    for name, arm in station.models.items():
        for joint, value in zip(arm.joints, targets[name], strict=True):
            data.actuator(f"{name}_{joint.name}").ctrl = value
        data.actuator(f"{name}_jaw").ctrl = 0.3
    mujoco.mj_step(model, data, 500)
    for name, arm in station.models.items():
        reached = [data.sensor(f"{name}_{joint.name}_position").data[0] for joint in arm.joints]
        assert reached == pytest.approx(targets[name].tolist(), abs=1e-3)
        assert data.sensor(f"{name}_jaw_position").data[0] == pytest.approx(0.3, abs=2e-3)


@pytest.mark.parametrize("name", ["psm-classic", "raven2-left"])
def test_as_loaded_it_stands_where_its_commands_are(name):
    """A program that loads the file and steps it sees no arm fly off: not even one whose ranges do not hold zero."""
    model = loaded(BENCHES[f"bench of {name}"])
    data = mujoco.MjData(model)
    before = data.qpos.copy()
    mujoco.mj_step(model, data, 100)
    assert np.abs(data.qpos - before).max() < 1e-6
    for joint in ARMS[name].joints:
        assert data.joint(f"only_{joint.name}").qpos[0] == pytest.approx(
            np.clip(0.0, joint.lower, joint.upper), abs=1e-6
        )


def test_the_jaws_are_as_stiff_and_as_strong_as_the_simulators_own():
    """Both drives, told the same opening, stop at the same with the same load on both fingers, and no sooner."""
    station = BENCHES["bench of psm-classic"]
    ours = World(station.models, {"only": SE3.identity()})
    model = loaded(station)
    data, opened = parked(model), {}
    for label, m, d, drive, command in (
        ("simulator", ours.model, ours.data, ours.model.actuator("only_jaw").id, 0.3),
        ("exported", model, data, model.actuator("only_jaw").id, 0.6),
    ):
        d.ctrl[drive] = command
        for torque in (0.01, 0.06):
            for side, sign in (("left", -1), ("right", 1)):
                d.qfrc_applied[m.joint(f"only_jaw_{side}").dofadr[0]] = sign * torque
            mujoco.mj_step(m, d, 400)
            left, right = (d.joint(f"only_jaw_{side}").qpos[0] for side in ("left", "right"))
            opened[label, torque] = left - right
    for torque in (0.01, 0.06):
        assert opened["exported", torque] == pytest.approx(opened["simulator", torque], abs=5e-4)
    assert opened["exported", 0.01] > 0.5
    assert opened["exported", 0.06] < 0.1


@pytest.mark.parametrize("name", TASKS)
def test_what_a_task_puts_on_the_table_can_be_there_too(name):
    task = TASKS[name]()
    station = task.at(load_station(task.station))
    model = loaded(station, task.world(task.scene(np.random.default_rng(0), station)))
    data = parked(model)
    assert model.nbody > loaded(station).nbody
    mujoco.mj_step(model, data, 20)
    assert not any(warning.number for warning in data.warning)


@EVERY_STATION
def test_the_text_alone_is_the_same_model_to_six_digits(station):
    ours, read = loaded(station), mujoco.MjModel.from_xml_string(station_mjcf(station))
    assert [ours.joint(j).name for j in range(ours.njnt)] == [read.joint(j).name for j in range(read.njnt)]
    for name in ("body_pos", "body_quat", "geom_size", "jnt_range", "actuator_gainprm", "key_qpos", "key_ctrl"):
        np.testing.assert_allclose(getattr(read, name), getattr(ours, name), rtol=1e-4, atol=1e-5)
    assert read.mesh_vert.shape == ours.mesh_vert.shape
