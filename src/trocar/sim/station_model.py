"""A station as a MuJoCo model for its own viewer and other programs, with actuators, sensors and frames by name."""

from __future__ import annotations

from math import atan, degrees

import mujoco
import numpy as np

from trocar.arms import ArmModel, fk, frames
from trocar.geometry import SE3, SO3
from trocar.lab import Station, StationCamera
from trocar.perception.image import StereoRig
from trocar.sim.spec import JAW_STIFFNESS_NM_RAD, SERVO, SOLID, CellArms, cell_spec, digits, placed
from trocar.sim.world import TaskWorld

PARK = "park"
"""Name of the keyframe in which the arms are parked."""
TABLE = "table"
TABLE_RGB = (0.30, 0.32, 0.34)
FIXTURE_RGB = (0.85, 0.55, 0.10)
CAMERA_FROM_OPENCV = SE3.from_parts(SO3.axis("x", np.pi))
"""MuJoCo's cameras look along -z, y up; the station's along z, y down."""


def station_mjcf(station: Station, task: TaskWorld | None = None) -> str:
    """Return :func:`station_spec` as self-contained MJCF text, to MuJoCo's six digits."""
    spec = station_spec(station, task)
    spec.compile()
    return spec.to_xml()


def station_spec(station: Station, task: TaskWorld | None = None) -> mujoco.MjSpec:
    """Return a station as a MuJoCo model specification: the nominal laboratory, with joints that follow exactly.

    Initially each arm is, and is commanded to be, as near to zero as its joints' ranges allow; in the keyframe
    :data:`PARK` it is parked. The model has, for each arm ``ARM`` and joint ``JOINT``:

    - the joint and its position actuator ``ARM_JOINT`` (rad, m), with sensors ``ARM_JOINT_position``, ``_velocity`` and
      ``_effort``;
    - for the opening of the jaws, the actuator ``ARM_jaw`` (rad), with sensors ``ARM_jaw_position`` and ``_velocity``;
    - the sites ``ARM_base`` (the remote centre) and ``ARM_tip``, with sensors of the tip's pose in the base,
      ``ARM_tip_position`` and ``ARM_tip_orientation`` (wxyz).

    Fixtures are sites, cameras are cameras.

    Args:
        station: the station.
        task: adds what lies on the table; None: only the table itself.
    """
    starts = {name: np.clip(np.zeros(6), arm.lower, arm.upper) for name, arm in station.models.items()}
    arms = CellArms(station.models, {name: arm.T_world_base for name, arm in station.arms.items()}, q_start=starts)
    if task is None:
        spec = cell_spec(arms, lambda spec: _add_table(spec, station))
    else:
        spec = cell_spec(arms, task.add, sleeps=task.sleeps)
    spec.modelname = station.name
    _add_light(spec, station)
    for name, T in station.T_world_fixture.items():
        box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": (0.004, 0.004, 0.0005)}
        spec.worldbody.add_site(name=name, rgba=(*FIXTURE_RGB, 1), **box, **placed(T))
    for name, camera in station.cameras.items():
        _add_camera(spec, name, camera)
    for name, arm in station.models.items():
        _add_sites(spec, name, arm)
        _set_drives(spec, name, arm)
        _add_sensors(spec, name, arm)
    _add_park(spec, station)
    return spec


def _add_table(spec: mujoco.MjSpec, station: Station) -> None:
    """Add a table at the station's fixture ``table``, or else at the height of the lowest fixture."""
    fixtures = station.T_world_fixture
    if not fixtures:
        return
    lowest = min(float(T.translation_m[2]) for T in fixtures.values())
    pose = fixtures.get(TABLE, SE3.from_parts(translation_m=[0.0, 0.0, lowest]))
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "rgba": (*TABLE_RGB, 1)}
    spec.worldbody.add_geom(name=TABLE, **plane, **placed(pose), **SOLID)


def _add_light(spec: mujoco.MjSpec, station: Station) -> None:
    """Light the scene, and set a viewer's initial view to show all tips and remote centres."""
    places = [arm.T_world_base.translation_m for arm in station.arms.values()]
    places += [(arm.T_world_base @ fk(arm.model, arm.park_q())).translation_m for arm in station.arms.values()]
    middle, extent = np.mean(places, axis=0), 0.15 + float(np.ptp(places, axis=0).max())
    spec.stat.center, spec.stat.extent = np.round(middle, 3), round(extent, 3)
    view, headlight = spec.visual.global_, spec.visual.headlight
    view.azimuth, view.elevation, view.offwidth, view.offheight = 120, -25, 1280, 960
    headlight.ambient, headlight.diffuse, headlight.specular = [0.35] * 3, [0.5] * 3, [0.1] * 3
    grey = {"builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, "rgb1": (0.80, 0.84, 0.88), "rgb2": (0.40, 0.45, 0.52)}
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384, **grey)
    sun = {"type": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, "dir": (0.2, 0.3, -1), "diffuse": [0.5] * 3}
    spec.worldbody.add_light(name="lamp", castshadow=False, pos=digits(middle + [0, 0, 1]), **sun)


def _add_camera(spec: mujoco.MjSpec, name: str, camera: StationCamera) -> None:
    """Add an ideal camera with the field of view of a station's camera; for a pair, one for each side."""
    model, T_left = camera.model, camera.T_world_camera
    if isinstance(model, StereoRig):
        lenses = {f"{name}_left": (model.left, T_left), f"{name}_right": (model.right, T_left @ model.T_left_right)}
    else:
        lenses = {name: (model, T_left)}
    for label, (lens, T) in lenses.items():
        fovy = float(digits(degrees(2 * atan(0.5 * lens.height / lens.fy))))
        size = {"fovy": fovy, "resolution": (lens.width, lens.height)}
        spec.worldbody.add_camera(name=label, **size, **placed(T @ CAMERA_FROM_OPENCV))


def _add_sites(spec: mujoco.MjSpec, name: str, arm: ArmModel) -> None:
    """Add the frames of the base, which is the remote centre, and of the tip."""
    at_zero = frames(arm, np.zeros(6))
    tip = at_zero[6].inverse() @ at_zero[7]
    green, red = ({"rgba": (*rgb, 1)} for rgb in ((0.1, 0.6, 0.2), (0.8, 0.1, 0.1)))
    spec.body(f"{name}_base").add_site(name=f"{name}_base", size=(0.002, 0.005, 0.005), **green)
    spec.body(f"{name}_link6").add_site(name=f"{name}_tip", size=(0.001, 0.005, 0.005), **red, **placed(tip))


def _set_drives(spec: mujoco.MjSpec, name: str, arm: ArmModel) -> None:
    """Leave one actuator per joint, limited to its range, and one for the opening between both fingers.

    The simulator's own jaw drive acts on one finger, that is, on half the opening; a tendon over both fingers has the
    same stiffness and force for the whole opening.
    """
    for joint in arm.joints:
        label = f"{name}_{joint.name}"
        spec.actuator(label).ctrlrange = digits((joint.lower, joint.upper))
        spec.delete(spec.actuator(f"{label}_feed"))
    label = f"{name}_jaw"
    spec.delete(spec.actuator(label))
    opening = spec.add_tendon(name=label)
    for side, sign in (("left", 1), ("right", -1)):
        opening.wrap_joint(f"{label}_{side}", sign)
    stiffness = JAW_STIFFNESS_NM_RAD / 4
    force, opened = (-SERVO.jaw_torque_nm, SERVO.jaw_torque_nm), digits((arm.jaw.lower, arm.jaw.upper))
    tendon = {"trntype": mujoco.mjtTrn.mjTRN_TENDON, "target": label}
    drive = spec.add_actuator(name=label, ctrlrange=opened, forcerange=force, **tendon)
    drive.set_to_position(kp=stiffness, kv=float(digits(np.sqrt(2 * stiffness * SERVO.jaw_inertia_kg_m2))))


def _add_sensors(spec: mujoco.MjSpec, name: str, arm: ArmModel) -> None:
    kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
    sensors = []
    for label in (f"{name}_{joint.name}" for joint in arm.joints):
        sensors += [
            (f"{label}_position", kinds.mjSENS_JOINTPOS, objects.mjOBJ_JOINT, label),
            (f"{label}_velocity", kinds.mjSENS_JOINTVEL, objects.mjOBJ_JOINT, label),
            (f"{label}_effort", kinds.mjSENS_ACTUATORFRC, objects.mjOBJ_ACTUATOR, label),
        ]
    sensors += [
        (f"{name}_jaw_position", kinds.mjSENS_TENDONPOS, objects.mjOBJ_TENDON, f"{name}_jaw"),
        (f"{name}_jaw_velocity", kinds.mjSENS_TENDONVEL, objects.mjOBJ_TENDON, f"{name}_jaw"),
    ]
    for label, kind, objtype, objname in sensors:
        spec.add_sensor(name=label, type=kind, objtype=objtype, objname=objname)
    tip = {"objtype": objects.mjOBJ_SITE, "objname": f"{name}_tip"}
    base = {"reftype": objects.mjOBJ_SITE, "refname": f"{name}_base"}
    spec.add_sensor(name=f"{name}_tip_position", type=kinds.mjSENS_FRAMEPOS, **tip, **base)
    spec.add_sensor(name=f"{name}_tip_orientation", type=kinds.mjSENS_FRAMEQUAT, **tip, **base)


def _add_park(spec: mujoco.MjSpec, station: Station) -> None:
    """Add the keyframe in which the arms are parked; all else is as in the initial state."""
    model = spec.compile()
    qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
    for name, arm in station.arms.items():
        for joint, value in zip(arm.model.joints, arm.park_q(), strict=True):
            label = f"{name}_{joint.name}"
            qpos[model.joint(label).qposadr[0]] = ctrl[model.actuator(label).id] = value
        for side, share in (("left", 0.5), ("right", -0.5)):
            qpos[model.joint(f"{name}_jaw_{side}").qposadr[0]] = share * arm.park_jaw_rad
        ctrl[model.actuator(f"{name}_jaw").id] = arm.park_jaw_rad
    spec.add_key(name=PARK, qpos=digits(qpos), ctrl=digits(ctrl))
