"""A simulated cell as MuJoCo's ``MjSpec``, made from the arms' models; no robot's dimensions are repeated here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtJoint
from numpy.typing import ArrayLike

from trocar.arms import ArmModel, frames
from trocar.arms.solids import STEEL, Part, parts_of
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.perception.fiducials import COLORS, Fixture

TIMESTEP_S = 1e-3

ALL_BITS = 2**31 - 1
SOLID = {"contype": 1, "conaffinity": ALL_BITS}
"""Attributes of a geom that collides with the scene and with every arm."""
INTANGIBLE = {"contype": 0, "conaffinity": 0}
"""Attributes of a geom that is visible but collides with nothing."""
UNSEEN_GROUP = 4
"""Group of geoms that no camera sees."""

STOP_CLOSED_RAD, STOP_BEYOND_RAD = 0.0, 0.1
"""Stops of one finger: at the middle, where it meets the other finger, and this far beyond the widest opening. The
stops are stiff: under the drive's force they yield by 2e-5 rad."""
STOP_SOLREF, STOP_SOLIMP = (0.002, 1.0), (0.99, 0.9999, 0.0001, 0.5, 2.0)
"""MuJoCo's parameters of these stops; with its defaults, closed jaws would read -.015 rad."""
JAW_STIFFNESS_NM_RAD = 1.5
"""Stiffness of the jaw drive on one finger (assumed)."""
ROD_RGB = (0.03, 0.03, 0.03)
"""Colour of the cross that carries the spheres of the jaws."""
SHAPES = {
    "box": mjtGeom.mjGEOM_BOX,
    "sphere": mjtGeom.mjGEOM_SPHERE,
    "capsule": mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mjtGeom.mjGEOM_CYLINDER,
    "hull": mjtGeom.mjGEOM_MESH,
}
"""MuJoCo's shapes of solids and parts."""


@dataclass(frozen=True)
class Servo:
    """Stiffness and inertia with which each joint follows its target; elastic cables limit the stiffness.

    Estimated so that the tip yields by about 1 mm/N; no source gives these numbers for the PSM or the Raven.

    Attributes:
        stiffness: each joint's stiffness, N m/rad, or N/m if prismatic.
        inertia: each joint's reflected inertia, kg m^2, or kg if prismatic; damping is critical.
        jaw_torque_nm: largest torque of the jaw drive on one finger.
        jaw_inertia_kg_m2: reflected inertia of the jaw drive.
    """

    stiffness: tuple[float, ...] = (60.0, 60.0, 3000.0, 1.0, 0.8, 0.8)
    inertia: tuple[float, ...] = (1e-2, 1e-2, 0.5, 1e-4, 1e-4, 1e-4)
    jaw_torque_nm: float = 0.03
    jaw_inertia_kg_m2: float = 2e-4

    @property
    def damping(self) -> tuple[float, ...]:
        """Return the critical damping of each joint."""
        return tuple(2.0 * float(np.sqrt(k * m)) for k, m in zip(self.stiffness, self.inertia, strict=True))


SERVO = Servo()
"""The servo of every simulated arm."""


@dataclass(frozen=True)
class Surface:
    """Contact parameters: dry printed ABS, serrated jaws (assumed).

    Attributes:
        abs_friction: friction of blocks, pegs and plate on each other.
        jaw_friction: friction of the jaws' teeth on a block.
        patch_m: lengths of torsional and rolling friction. Real jaws hold by patches of some square millimetres; with
            mere contact points, objects would turn.
        solref: MuJoCo's time constant and damping ratio of contacts.
        solimp: MuJoCo's impedance of contacts: .05 mm of penetration at the jaws' grip.
    """

    abs_friction: float = 0.35
    jaw_friction: float = 1.0
    patch_m: tuple[float, float] = (0.002, 0.0001)
    solref: tuple[float, float] = (0.004, 1.0)
    solimp: tuple[float, float, float] = (0.98, 0.999, 0.0003)


@dataclass(frozen=True, eq=False)
class CellArms:
    """The arms of a cell by name, as the simulator needs them.

    Attributes:
        models: the arms' models.
        T_world_base: true poses of the bases.
        surface: contact parameters.
        fixtures: spheres for calibration on the instruments.
        q_start: joints (6,) in MuJoCo's initial state; zero if not given.
    """

    models: Mapping[str, ArmModel]
    T_world_base: Mapping[str, SE3]
    surface: Surface = field(default_factory=Surface)
    fixtures: Mapping[str, Fixture] = field(default_factory=dict)
    q_start: Mapping[str, Array] = field(default_factory=dict)


def digits(values: ArrayLike) -> Array:
    """Return numbers rounded to the sixteen digits of a model file, so that spec and file give the same trials."""
    values = np.asarray(values, dtype=np.float64)
    return np.array([float(f"{value:.16g}") for value in values.flat]).reshape(values.shape)


def placed(T: SE3) -> dict[str, Array]:
    """Return the attributes of a body or geom at this pose in its parent."""
    return {"pos": digits(T.translation_m), "quat": digits(T.rotation.as_quaternion())}


def cell_spec(arms: CellArms, add_bodies: Callable[[mujoco.MjSpec], None], *, sleeps: bool = False) -> mujoco.MjSpec:
    """Return a cell: a task's bodies, and arms on position servos, each with its own collision bit.

    Args:
        arms: the arms of the cell.
        add_bodies: adds the bodies that are not arms.
        sleeps: whether bodies at rest may be left out of the physics until something touches them.
    """
    spec = _empty_spec(arms.surface, sleeps)
    add_bodies(spec)
    for number, body in enumerate(spec.bodies):
        body.name = body.name or f"body {number}"  # replays know bodies by name
    for index, name in enumerate(arms.models):
        bit = SOLID["contype"] << (index + 1)
        # an arm collides with everything but itself, because its neighbouring links overlap at their joints
        _add_arm(spec, arms, name, {"contype": bit, "conaffinity": ALL_BITS & ~bit})
    return spec


def _empty_spec(surface: Surface, sleeps: bool) -> mujoco.MjSpec:
    """Return a spec without bodies, with the solver and contact settings of all cells."""
    spec = mujoco.MjSpec()
    spec.modelname = "trocar"
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.impratio, option.noslip_iterations = TIMESTEP_S, 10, 3
    option.integrator, option.solver = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    if sleeps:
        option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    geom = spec.default.geom
    geom.solref, geom.solimp[:3], geom.condim, geom.density = surface.solref, surface.solimp, 4, 1000
    geom.friction = (surface.abs_friction, *surface.patch_m)
    return spec


def _add_arm(spec: mujoco.MjSpec, arms: CellArms, name: str, bits: Mapping[str, int]) -> None:
    arm, q_start = arms.models[name], arms.q_start.get(name, np.zeros(6))
    at_start = frames(arm, q_start)
    body = spec.worldbody.add_body(name=f"{name}_base", gravcomp=1, **placed(arms.T_world_base[name]))
    links = []
    for index, joint in enumerate(arm.joints):
        pose = at_start[index].inverse() @ at_start[index + 1]
        body = body.add_body(name=f"{name}_link{index + 1}", gravcomp=1, **placed(pose), **_inertia(0.01, 1e-6))
        body.add_joint(
            name=f"{name}_{joint.name}",
            type=mjtJoint.mjJNT_SLIDE if joint.prismatic else mjtJoint.mjJNT_HINGE,
            axis=(0, 0, 1),
            range=digits((joint.lower, joint.upper)),
            ref=float(digits(q_start[index])),
            armature=SERVO.inertia[index],
        )
        links.append(body)
    for part in parts_of(arm):
        _add_part(links[part.link - 1], name, part, bits)
    for side in (1, -1):
        _add_finger(spec, links[5], arms, name, side, bits)
    if name in arms.fixtures:
        _add_fixture(links[3], links[5], name, arm, arms.fixtures[name], bits)
    _add_drives(spec, name, arm)


def _inertia(mass: float, moment: float, x_m: float = 0.0) -> dict[str, Any]:
    """Return the attributes of a body with a given mass, independent of its geoms."""
    return {"explicitinertial": True, "mass": mass, "inertia": (moment,) * 3, "ipos": (x_m, 0, 0)}


def _add_part(link: mujoco.MjsBody, name: str, part: Part, bits: Mapping[str, int]) -> None:
    if part.shape == "box":
        shape: dict[str, Any] = {"size": digits(0.5 * np.array(part.size_m)), "pos": digits(part.at_m[0])}
    else:
        shape = {"size": (*digits(part.size_m), 0, 0), "fromto": digits(part.at_m.ravel())}
    link.add_geom(name=f"{name}_{part.name}", type=SHAPES[part.shape], rgba=(*part.rgb, 1), **shape, **bits)


def _add_finger(
    spec: mujoco.MjSpec, yaw: mujoco.MjsBody, arms: CellArms, name: str, side: int, bits: Mapping[str, int]
) -> None:
    """Attach a finger, left (1) or right (-1), with its marks, to the yaw link."""
    arm, which = arms.models[name], "left" if side > 0 else "right"
    shape, label = arm.instrument, f"{name}_finger_{which}"
    along_y = SE3.from_parts(SO3.axis("z", np.pi / 2))  # a finger's x is frame 6's y, along which the jaws point
    widest = 0.5 * arm.jaw.upper + STOP_BEYOND_RAD
    finger = yaw.add_body(name=label, gravcomp=1, **placed(along_y), **_inertia(0.001, 1e-8, 0.005))
    finger.add_joint(
        name=f"{name}_jaw_{which}",
        type=mjtJoint.mjJNT_HINGE,
        axis=(0, 0, 1),
        range=digits(sorted((side * STOP_CLOSED_RAD, side * widest))),
        solref_limit=STOP_SOLREF,
        solimp_limit=STOP_SOLIMP,
        armature=SERVO.jaw_inertia_kg_m2,
    )
    spec.add_mesh(name=label, uservert=digits(shape.finger_m(side)).ravel())
    friction = (arms.surface.jaw_friction, *arms.surface.patch_m)
    steel = {"friction": friction, "condim": 6, "rgba": (*STEEL, 1)}
    finger.add_geom(name=label, type=mjtGeom.mjGEOM_MESH, meshname=label, **steel, **bits)
    if shape.marks is None:
        return
    half = 0.5 * shape.finger_width_m + shape.marks.proud_m
    for number, center in enumerate(shape.marks.centers_m(side, 0.0)):
        finger.add_geom(
            name=f"{name}_mark_{which}{number}",
            type=mjtGeom.mjGEOM_CYLINDER,
            size=(*digits((shape.marks.radius_m, half)), 0),
            pos=digits(center),
            rgba=(*shape.marks.colors[0 if side > 0 else 1], 1),
            **bits,  # rays miss a geom that collides with nothing, unless the body's other geoms are near it
        )


def _add_fixture(
    roll: mujoco.MjsBody, yaw: mujoco.MjsBody, name: str, arm: ArmModel, fixture: Fixture, bits: Mapping[str, int]
) -> None:
    """Attach a fixture's spheres to the roll link (frame 4) and the yaw link (frame 6) of an arm.

    The spheres collide, like the marks, so that rays do not miss them.
    """
    centers = fixture.frame_centers_m(arm)
    for number, (sphere, center) in enumerate(zip(fixture.spheres, centers, strict=True)):
        (roll if fixture.on_shaft[number] else yaw).add_geom(
            name=f"{name}_sphere{number}",
            type=mjtGeom.mjGEOM_SPHERE,
            size=(float(digits(sphere.radius_m)), 0, 0),
            pos=digits(center),
            rgba=(*COLORS[sphere.color], 1),
            **bits,
        )
    for number in np.flatnonzero(~fixture.on_shaft):
        yaw.add_geom(
            name=f"{name}_rod{number}",
            type=mjtGeom.mjGEOM_CAPSULE,
            size=(fixture.arm_radius_m, 0, 0),
            fromto=digits((*fixture.hub_m, *centers[number])),
            rgba=(*ROD_RGB, 1),
            **bits,
        )


def _add_drives(spec: mujoco.MjSpec, name: str, arm: ArmModel) -> None:
    """Add a position servo and a feed-forward motor for each joint, and one servo for the two coupled fingers."""

    def drive(label: str, joint: str, **attributes: Any) -> mujoco.MjsActuator:
        return spec.add_actuator(name=label, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint, **attributes)

    labels = [f"{name}_{joint.name}" for joint in arm.joints]
    for label, stiffness, damping in zip(labels, SERVO.stiffness, SERVO.damping, strict=True):
        drive(label, label).set_to_position(kp=stiffness, kv=float(digits(damping)))
    for label in labels:
        drive(f"{label}_feed", label).set_to_motor()
    jaw, torque = f"{name}_jaw_left", 2 * SERVO.jaw_torque_nm
    damping = float(digits(2 * np.sqrt(JAW_STIFFNESS_NM_RAD * 2 * SERVO.jaw_inertia_kg_m2)))
    drive(f"{name}_jaw", jaw, forcerange=(-torque, torque)).set_to_position(kp=JAW_STIFFNESS_NM_RAD, kv=damping)
    fingers = {"name1": jaw, "name2": f"{name}_jaw_right"}
    coupling = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, solref=(0.004, 1.0), **fingers)
    coupling.data[:2] = 0.0, -1.0
