"""A simulated cell as MJCF, generated from the arms' models; no number of a robot is repeated here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, frames
from trocar.arms.instrument import Instrument
from trocar.arms.parts import STEEL, Part, parts_of
from trocar.geometry import SE3, SO3
from trocar.perception.fiducials import Fixture
from trocar.sim.elements import add, arm_bits, placed, text
from trocar.sim.fixture import add_fixture
from trocar.sim.task_world import TaskWorld

TIMESTEP_S = 1e-3

MIN_CLOSED_RAD, MAX_OPEN_BEYOND_RAD = 0.0, 0.1
"""Stops of one finger: the other finger, and this far beyond the arm's widest opening. They are stiff: under the
drive's force they yield by 2e-5 rad."""
STOP_SOLREF, STOP_SOLIMP = "0.002 1", "0.99 0.9999 0.0001"
"""MuJoCo's parameters of these stops; with its defaults, closed jaws would read -.015 rad."""
JAW_STIFFNESS_NM_RAD = 1.5
"""Stiffness of the jaw drive on one finger (assumed)."""


@dataclass(frozen=True)
class Servo:
    """Spring and inertia between the joint's target and the joint: the stiffness that the stretching cables leave.

    Estimated, so that the tip yields about 1 mm/N; no source gives these for the PSM or the Raven.

    Attributes:
        stiffness: N m/rad, or N/m if prismatic, one per joint.
        inertia: reflected inertia kg m^2, or kg if prismatic, one per joint; damping is critical.
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


@dataclass(frozen=True)
class Surface:
    """Contact of the solids: dry printed ABS, serrated jaws (assumed).

    Attributes:
        abs_friction: of blocks, pegs and plate on each other.
        jaw_friction: of the jaws' teeth on a block.
        patch_m: lengths of torsional and rolling friction; the jaws hold by patches of some square millimetres, and
            with mere contact points objects would turn.
        solref: MuJoCo's time constant and damping ratio of contacts.
        solimp: MuJoCo's impedance of contacts: .05 mm of penetration at the jaws' grip.
    """

    abs_friction: float = 0.35
    jaw_friction: float = 1.0
    patch_m: tuple[float, float] = (0.002, 0.0001)
    solref: tuple[float, float] = (0.004, 1.0)
    solimp: tuple[float, float, float] = (0.98, 0.999, 0.0003)


@dataclass(frozen=True, eq=False)
class CellModel:
    """The ingredients of the MJCF.

    Attributes:
        arms: model of each arm by name.
        T_world_base: true pose of each arm's base.
        task: what the task puts into the world.
        servo: how the joints are driven.
        surface: contact parameters.
        worn: spheres for calibration, by the arm whose instrument wears them.
        q_start: joints (6,) of an arm in MuJoCo's state as loaded; zero if it has none.
    """

    arms: Mapping[str, ArmModel]
    T_world_base: Mapping[str, SE3]
    task: TaskWorld = field(default_factory=TaskWorld)
    servo: Servo = field(default_factory=Servo)
    surface: Surface = field(default_factory=Surface)
    worn: Mapping[str, Fixture] = field(default_factory=dict)
    q_start: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


def build_mjcf(cell: CellModel) -> str:
    """Return the cell as MJCF text."""
    root = cell_element(cell)
    indent(root)
    return tostring(root, encoding="unicode")


def cell_element(cell: CellModel) -> Element:
    """Return the cell as MJCF: the task's bodies, and arms on position servos."""
    root = Element("mujoco", model="trocar")
    add(root, "compiler", angle="radian", autolimits="true")
    option = add(
        root,
        "option",
        timestep=text(TIMESTEP_S),
        integrator="implicitfast",
        cone="elliptic",
        impratio="10",
        noslip_iterations="3",
        solver="Newton",
    )
    add(option, "flag", sleep="enable" if cell.task.sleeps else "disable")
    surface = cell.surface
    default = add(root, "default")
    add(
        default,
        "geom",
        solref=text(surface.solref),
        solimp=text(surface.solimp),
        friction=text((surface.abs_friction, *surface.patch_m)),
        condim="4",
        density="1000",
    )
    assets = add(root, "asset")
    world = add(root, "worldbody")
    cell.task.add(world, assets)
    sections = {name: add(root, name) for name in ("equality", "actuator")}
    for index, (name, arm) in enumerate(cell.arms.items()):
        _add_arm(world, assets, sections, cell, name, arm, arm_bits(index))
    return root


def _add_arm(
    world: Element,
    assets: Element,
    sections: Mapping[str, Element],
    cell: CellModel,
    name: str,
    arm: ArmModel,
    bits: Mapping[str, str],
) -> None:
    servo = cell.servo
    q_start = cell.q_start.get(name, np.zeros(6))
    at_start = frames(arm, q_start)
    body = add(world, "body", name=f"{name}_base", gravcomp="1", **placed(cell.T_world_base[name]))
    links = []
    for index, joint in enumerate(arm.joints):
        pose = at_start[index].inverse() @ at_start[index + 1]
        body = add(body, "body", name=f"{name}_link{index + 1}", gravcomp="1", **placed(pose))
        add(body, "inertial", pos="0 0 0", mass="0.01", diaginertia="1e-6 1e-6 1e-6")
        add(
            body,
            "joint",
            name=f"{name}_{joint.name}",
            type="slide" if joint.prismatic else "hinge",
            axis="0 0 1",
            range=text((joint.lower, joint.upper)),
            ref=text(q_start[index]),
            armature=text(servo.inertia[index]),
        )
        links.append(body)
    for part in parts_of(arm):
        _add_part(links[part.link - 1], name, part, bits)
    _add_fingers(links[5], assets, cell, name, arm, bits)
    if name in cell.worn:
        add_fixture(links[3], links[5], name, arm, cell.worn[name], bits)
    _add_drives(sections, servo, name, arm)


def _add_part(link: Element, name: str, part: Part, bits: Mapping[str, str]) -> None:
    """Attach one solid of an instrument to its link."""
    geom = {"name": f"{name}_{part.name}", "type": part.shape, "rgba": text((*part.rgb, 1)), **bits}
    if part.shape == "box":
        add(link, "geom", **geom, size=text(0.5 * np.array(part.size_m)), pos=text(part.at_m))
    else:
        add(link, "geom", **geom, size=text(part.size_m), fromto=text(part.at_m))


def _add_fingers(
    yaw: Element, assets: Element, cell: CellModel, name: str, arm: ArmModel, bits: Mapping[str, str]
) -> None:
    shape, servo = arm.instrument, cell.servo
    along_y = SE3.from_parts(SO3.axis("z", np.pi / 2))  # a finger's x is y of frame 6, which the jaws point along
    widest = 0.5 * arm.jaw.upper + MAX_OPEN_BEYOND_RAD
    for finger, side in (("left", 1), ("right", -1)):
        add(assets, "mesh", name=f"{name}_finger_{finger}", vertex=text(shape.finger_m(side)))
        body = add(yaw, "body", name=f"{name}_finger_{finger}", gravcomp="1", **placed(along_y))
        add(body, "inertial", pos="0.005 0 0", mass="0.001", diaginertia="1e-8 1e-8 1e-8")
        add(
            body,
            "joint",
            name=f"{name}_jaw_{finger}",
            type="hinge",
            axis="0 0 1",
            range=text(sorted((side * MIN_CLOSED_RAD, side * widest))),
            solreflimit=STOP_SOLREF,
            solimplimit=STOP_SOLIMP,
            armature=text(servo.jaw_inertia_kg_m2),
        )
        add(
            body,
            "geom",
            name=f"{name}_finger_{finger}",
            type="mesh",
            mesh=f"{name}_finger_{finger}",
            friction=text((cell.surface.jaw_friction, *cell.surface.patch_m)),
            condim="6",
            rgba=text((*STEEL, 1)),
            **bits,
        )
        _add_marks(body, shape, name, side, bits)


def _add_marks(finger: Element, shape: Instrument, name: str, side: int, bits: Mapping[str, str]) -> None:
    """Add the marks of one finger. They collide, since rays miss geoms that nothing collides with (``worn``)."""
    marks = shape.marks
    if marks is None:
        return
    half = 0.5 * shape.finger_width_m + marks.proud_m
    for number, center in enumerate(marks.centers_m(side, 0.0)):
        add(
            finger,
            "geom",
            name=f"{name}_mark_{'left' if side > 0 else 'right'}{number}",
            type="cylinder",
            size=text((marks.radius_m, half)),
            pos=text(center),
            rgba=text((*marks.colors[0 if side > 0 else 1], 1)),
            **bits,
        )


def _add_drives(sections: Mapping[str, Element], servo: Servo, name: str, arm: ArmModel) -> None:
    """Add a spring to the target and a feed-forward motor for each joint; the two fingers are coupled."""
    actuators = sections["actuator"]
    for joint, stiffness, damping in zip(arm.joints, servo.stiffness, servo.damping, strict=True):
        label = f"{name}_{joint.name}"
        add(actuators, "position", name=label, joint=label, kp=text(stiffness), kv=text(damping))
    for joint in arm.joints:
        label = f"{name}_{joint.name}"
        add(actuators, "motor", name=f"{label}_feed", joint=label)
    jaw = f"{name}_jaw_left"
    add(
        actuators,
        "position",
        name=f"{name}_jaw",
        joint=jaw,
        kp=text(JAW_STIFFNESS_NM_RAD),
        kv=text(2 * np.sqrt(JAW_STIFFNESS_NM_RAD * 2 * servo.jaw_inertia_kg_m2)),
        forcerange=text((-2 * servo.jaw_torque_nm, 2 * servo.jaw_torque_nm)),
    )
    add(
        sections["equality"],
        "joint",
        joint1=jaw,
        joint2=f"{name}_jaw_right",
        polycoef="0 -1 0 0 0",
        solref="0.004 1",
    )
