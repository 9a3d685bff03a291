"""A station as a model for MuJoCo's own viewer and for other programs: actuators, sensors and frames by name."""

from __future__ import annotations

from math import atan, degrees
from xml.etree.ElementTree import Element, indent, tostring

import mujoco
import numpy as np

from trocar.arms import ArmModel, fk, frames
from trocar.geometry import SE3, SO3
from trocar.lab import Station, StationCamera
from trocar.perception.image import Intrinsics, StereoRig
from trocar.sim.elements import add, placed, scene_bits, text
from trocar.sim.mjcf import JAW_STIFFNESS_NM_RAD, CellModel, Servo, cell_element
from trocar.sim.task_world import TaskWorld

PARK = "park"
"""Name of the keyframe in which the arms rest where the station parks them."""
TABLE = "table"
TABLE_RGB = (0.30, 0.32, 0.34)
FIXTURE_RGB = (0.85, 0.55, 0.10)
CAMERA_FROM_OPENCV = SE3.from_parts(SO3.axis("x", np.pi))
"""MuJoCo's cameras look along -z, y up; the station's along z, y down."""


class _Table(TaskWorld):
    """Only a table: at the station's fixture of that name, else a plane at the lowest fixture."""

    def __init__(self, station: Station):
        self._station = station

    def add(self, world: Element, assets: Element) -> None:
        fixtures = self._station.T_world_fixture
        if not fixtures:
            return
        lowest = min(float(T.translation_m[2]) for T in fixtures.values())
        pose = fixtures.get(TABLE, SE3.from_parts(translation_m=[0.0, 0.0, lowest]))
        look = {"rgba": text((*TABLE_RGB, 1)), **placed(pose), **scene_bits()}
        add(world, "geom", name=TABLE, type="plane", size="0.5 0.5 0.01", **look)


def station_mjcf(station: Station, task: TaskWorld | None = None) -> str:
    """Return a station as self-contained MJCF text: the nominal laboratory, with joints that follow exactly.

    As loaded, each arm is, and is commanded to be, as near to zero as its joints' ranges allow; the keyframe
    :data:`PARK` has it where the station parks it. Of each arm ``ARM`` and joint ``JOINT`` there are the joint and the
    position actuator ``ARM_JOINT`` (rad, m), the sensors ``ARM_JOINT_position``, ``_velocity`` and ``_effort``; for the
    opening of the jaws the actuator ``ARM_jaw`` (rad) and the sensors ``ARM_jaw_position`` and ``_velocity``; the sites
    ``ARM_base``, which is the remote centre, and ``ARM_tip``, and where the tip is in the base the sensors
    ``ARM_tip_position`` and ``ARM_tip_orientation`` (wxyz). Fixtures are sites, cameras are cameras.

    Args:
        station: whose arms, table, fixtures and cameras.
        task: what lies on the table; None: nothing.
    """
    starts = {name: np.clip(np.zeros(6), arm.lower, arm.upper) for name, arm in station.models.items()}
    bases = {name: arm.T_world_base for name, arm in station.arms.items()}
    root = cell_element(CellModel(station.models, bases, task or _Table(station), q_start=starts))
    root.set("model", station.name)
    _add_light(root, station)
    world = _section(root, "worldbody")
    for name, T in station.T_world_fixture.items():
        add(world, "site", name=name, type="box", size="0.004 0.004 0.0005", rgba=text((*FIXTURE_RGB, 1)), **placed(T))
    for name, camera in station.cameras.items():
        _add_camera(world, name, camera)
    tendons, sensors = add(root, "tendon"), add(root, "sensor")
    for name, arm in station.models.items():
        _add_sites(world, name, arm)
        _set_drives(_section(root, "actuator"), tendons, name, arm)
        _add_sensors(sensors, name, arm)
    _add_park(root, station)
    indent(root)
    return tostring(root, encoding="unicode")


def _section(root: Element, tag: str) -> Element:
    found = root.find(tag)
    assert found is not None  # the cell has it
    return found


def _body(world: Element, name: str) -> Element:
    return next(body for body in world.iter("body") if body.get("name") == name)


def _add_light(root: Element, station: Station) -> None:
    """Light the scene, and start a viewer where all tips and remote centres are visible."""
    places = [arm.T_world_base.translation_m for arm in station.arms.values()]
    places += [(arm.T_world_base @ fk(arm.model, arm.park_q())).translation_m for arm in station.arms.values()]
    middle, extent = np.mean(places, axis=0), 0.15 + float(np.ptp(places, axis=0).max())
    add(root, "statistic", center=text(np.round(middle, 3)), extent=text(round(extent, 3)))
    visual = add(root, "visual")
    add(visual, "global", azimuth="120", elevation="-25", offwidth="1280", offheight="960")
    add(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.5 0.5 0.5", specular="0.1 0.1 0.1")
    sky = {"type": "skybox", "builtin": "gradient", "width": "64", "height": "384"}
    add(_section(root, "asset"), "texture", name="sky", rgb1="0.80 0.84 0.88", rgb2="0.40 0.45 0.52", **sky)
    light = {"pos": text(middle + [0, 0, 1]), "dir": "0.2 0.3 -1", "diffuse": "0.5 0.5 0.5"}
    add(_section(root, "worldbody"), "light", name="lamp", type="directional", castshadow="false", **light)


def _add_camera(world: Element, name: str, camera: StationCamera) -> None:
    """Add an ideal camera with the field of view of a station's: of a pair, one for each eye."""
    if isinstance(camera.model, StereoRig):
        right = camera.T_world_camera @ camera.model.T_left_right
        eyes = {"left": (camera.model.left, camera.T_world_camera), "right": (camera.model.right, right)}
        found: dict[str, tuple[Intrinsics, SE3]] = {f"{name}_{eye}": lens for eye, lens in eyes.items()}
    else:
        found = {name: (camera.model, camera.T_world_camera)}
    for label, (lens, T) in found.items():
        fovy = degrees(2 * atan(0.5 * lens.height / lens.fy))
        size = {"fovy": text(fovy), "resolution": f"{lens.width} {lens.height}"}
        add(world, "camera", name=label, **size, **placed(T @ CAMERA_FROM_OPENCV))


def _add_sites(world: Element, name: str, arm: ArmModel) -> None:
    """Add the frames of the base, which is the remote centre, and of the tip."""
    at_zero = frames(arm, np.zeros(6))
    tip = at_zero[6].inverse() @ at_zero[7]
    add(_body(world, f"{name}_base"), "site", name=f"{name}_base", size="0.002", rgba="0.1 0.6 0.2 1")
    add(_body(world, f"{name}_link6"), "site", name=f"{name}_tip", size="0.001", rgba="0.8 0.1 0.1 1", **placed(tip))


def _set_drives(actuators: Element, tendons: Element, name: str, arm: ArmModel) -> None:
    """Leave one actuator a joint, within its range, and one for the opening between both fingers.

    The simulator's own jaw drive pulls at half the opening; a tendon over both fingers has the same stiffness and force
    for the whole of it.
    """
    for joint in arm.joints:
        label = f"{name}_{joint.name}"
        drive, feed = (actuators.find(f"*[@name='{each}']") for each in (label, f"{label}_feed"))
        assert drive is not None and feed is not None  # the cell has them
        drive.set("ctrlrange", text((joint.lower, joint.upper)))
        actuators.remove(feed)
    half = actuators.find(f"*[@name='{name}_jaw']")
    assert half is not None
    actuators.remove(half)
    jaw = add(tendons, "fixed", name=f"{name}_jaw")
    for side, sign in (("left", 1), ("right", -1)):
        add(jaw, "joint", joint=f"{name}_jaw_{side}", coef=str(sign))
    servo, stiffness = Servo(), JAW_STIFFNESS_NM_RAD / 4
    add(
        actuators,
        "position",
        name=f"{name}_jaw",
        tendon=f"{name}_jaw",
        kp=text(stiffness),
        kv=text(np.sqrt(2 * stiffness * servo.jaw_inertia_kg_m2)),
        ctrlrange=text((arm.jaw.lower, arm.jaw.upper)),
        forcerange=text((-servo.jaw_torque_nm, servo.jaw_torque_nm)),
    )


def _add_sensors(sensors: Element, name: str, arm: ArmModel) -> None:
    for joint in arm.joints:
        label = f"{name}_{joint.name}"
        add(sensors, "jointpos", name=f"{label}_position", joint=label)
        add(sensors, "jointvel", name=f"{label}_velocity", joint=label)
        add(sensors, "actuatorfrc", name=f"{label}_effort", actuator=label)
    add(sensors, "tendonpos", name=f"{name}_jaw_position", tendon=f"{name}_jaw")
    add(sensors, "tendonvel", name=f"{name}_jaw_velocity", tendon=f"{name}_jaw")
    at = {"objtype": "site", "objname": f"{name}_tip", "reftype": "site", "refname": f"{name}_base"}
    add(sensors, "framepos", name=f"{name}_tip_position", **at)
    add(sensors, "framequat", name=f"{name}_tip_orientation", **at)


def _add_park(root: Element, station: Station) -> None:
    """Add the keyframe in which the arms rest as defined by the station; all else is as loaded."""
    model = mujoco.MjModel.from_xml_string(tostring(root, encoding="unicode"))
    qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
    for name, arm in station.arms.items():
        for joint, value in zip(arm.model.joints, arm.park_q(), strict=True):
            label = f"{name}_{joint.name}"
            qpos[model.joint(label).qposadr[0]] = ctrl[model.actuator(label).id] = value
        for side, share in (("left", 0.5), ("right", -0.5)):
            qpos[model.joint(f"{name}_jaw_{side}").qposadr[0]] = share * arm.park_jaw_rad
        ctrl[model.actuator(f"{name}_jaw").id] = arm.park_jaw_rad
    add(add(root, "keyframe"), "key", name=PARK, qpos=text(qpos), ctrl=text(ctrl))
