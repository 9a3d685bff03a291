"""URDF of every arm: its forward kinematics, limits and names are the arm's, and MuJoCo can load it."""

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from trocar.arms import ARMS, PSM_CLASSIC, fk, frames
from trocar.arms.solids import CARBON, STEEL
from trocar.arms.urdf import BASE, TIP, arm_urdf, joint_names, roll_pitch_yaw
from trocar.geometry import SE3, SO3

EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)


def parsed(arm) -> Any:
    return ElementTree.fromstring(arm_urdf(arm))


def numbers(element, key):
    return np.array(element.get(key).split(), dtype=float)


def pose(origin):
    roll, pitch, yaw = numbers(origin, "rpy")
    turn = SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)
    return SE3.from_parts(turn, numbers(origin, "xyz"))


def poses(robot, values):
    """The pose in the base of every link of a URDF, as its standard says, joints at these values by name."""
    found, joints = {BASE: SE3.identity()}, list(robot.iter("joint"))
    while joints:
        joint = next(joint for joint in joints if joint.find("parent").get("link") in found)
        joints.remove(joint)
        mimic = joint.find("mimic")
        if mimic is None:
            value = values.get(joint.get("name"), 0.0)
        else:
            value = float(mimic.get("multiplier")) * values[mimic.get("joint")] + float(mimic.get("offset"))
        at = found[joint.find("parent").get("link")] @ pose(joint.find("origin"))
        if joint.get("type") != "fixed":
            axis = numbers(joint.find("axis"), "xyz")
            slides = joint.get("type") == "prismatic"
            at = at @ (SE3.from_parts(translation_m=value * axis) if slides else SE3.from_parts(SO3.exp(value * axis)))
        found[joint.find("child").get("link")] = at
    return found


@EVERY_ARM
def test_the_forward_kinematics_is_the_arms(arm):
    robot, rng = parsed(arm), np.random.default_rng(0)
    for q in rng.uniform(arm.lower, arm.upper, (20, 6)):
        found = poses(robot, {**dict(zip(joint_names(arm), q, strict=True)), "jaw": 0.4})
        assert np.abs(found[TIP].matrix - fk(arm, q).matrix).max() < 1e-9
        for name, there in zip(joint_names(arm), frames(arm, q).matrix[1:7], strict=True):
            assert np.abs(found[f"{name}_link"].matrix - there).max() < 1e-9


@EVERY_ARM
def test_limits_and_speeds_are_the_arms_and_every_joint_and_link_has_a_name(arm):
    robot = parsed(arm)
    joints = {joint.get("name"): joint for joint in robot.iter("joint")}
    for name, joint in zip((*joint_names(arm), "jaw"), (*arm.joints, arm.jaw), strict=True):
        limit = joints[name].find("limit")
        assert joints[name].get("type") == ("prismatic" if joint.prismatic else "revolute")
        told = [float(limit.get(key)) for key in ("lower", "upper", "velocity")]
        assert told == pytest.approx([joint.lower, joint.upper, joint.max_speed], abs=1e-9)
    links = [link.get("name") for link in robot.iter("link")]
    assert len(set(links)) == len(links) and len(joints) == len(links) - 1
    children = [joint.find("child").get("link") for joint in joints.values()]
    assert sorted([BASE, *children]) == sorted(links), "a tree with one root"


def test_a_psm_is_named_as_in_the_dvrks_models_and_a_raven_as_its_own_joints():
    outer = "outer_yaw outer_pitch outer_insertion outer_roll outer_wrist_pitch outer_wrist_yaw"
    assert joint_names(PSM_CLASSIC) == tuple(outer.split())
    assert joint_names(ARMS["raven2-left"])[:3] == ("shoulder", "elbow", "insertion")


@EVERY_ARM
def test_the_solids_are_where_the_instrument_is(arm):
    """The shaft's axis goes through the remote centre; open fingers are mirror images and end at their length."""
    robot, q = parsed(arm), arm.middle
    found = poses(robot, {**dict(zip(joint_names(arm), q, strict=True)), "jaw": 0.6})
    links = {link.get("name"): link for link in robot.iter("link")}
    roll = links[f"{joint_names(arm)[3]}_link"]
    shaft = next(v for v in roll.iter("visual") if v.get("name").startswith("shaft"))
    assert float(shaft.find("geometry/cylinder").get("radius")) == arm.instrument.shaft_radius_m
    there = found[f"{joint_names(arm)[3]}_link"] @ pose(shaft.find("origin"))
    assert np.linalg.norm(np.cross(there.translation_m, there.rotation.matrix[:, 2])) < 1e-9
    yaw = found[f"{joint_names(arm)[5]}_link"]
    ends = []
    for side in ("left", "right"):
        box = links[f"jaw_{side}_link"].find("visual")
        corner = [0.5 * numbers(box.find("geometry/box"), "size")[0], 0, 0]
        end = found[f"jaw_{side}_link"] @ pose(box.find("origin"))
        ends.append(yaw.inverse().apply(end.apply([corner]))[0])
    assert ends[0][0] == pytest.approx(-ends[1][0]) and ends[0][0] < 0 < ends[1][0]
    assert ends[0][1] == pytest.approx(ends[1][1])
    assert 0.9 * arm.instrument.finger_length_m < ends[0][1] <= 1.01 * arm.instrument.finger_length_m


@EVERY_ARM
def test_every_moving_link_has_a_mass_and_an_inertia(arm):
    robot = parsed(arm)
    for link in robot.iter("link"):
        if link.get("name") in (BASE, TIP):
            continue
        assert float(link.find("inertial/mass").get("value")) == 0.1
        i = {key: float(value) for key, value in link.find("inertial/inertia").items()}
        assert i == {"ixx": 1e-4, "ixy": 0, "ixz": 0, "iyy": 1e-4, "iyz": 0, "izz": 1e-4}


@EVERY_ARM
def test_mujoco_reads_it_with_the_same_limits_and_kinematics(arm):
    mujoco = pytest.importorskip("mujoco")
    robot = parsed(arm)
    keep = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(keep, "compiler", fusestatic="false", discardvisual="false")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))
    data = mujoco.MjData(model)
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper)
    for name, value, joint in zip(joint_names(arm), q, arm.joints, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
        assert model.joint(name).range == pytest.approx([joint.lower, joint.upper], abs=1e-9)
    mujoco.mj_kinematics(model, data)
    tip = SE3.from_parts(SO3(data.body(TIP).xmat.reshape(3, 3)), data.body(TIP).xpos)
    assert np.abs(tip.matrix - fk(arm, q).matrix).max() < 1e-6


def test_angles_come_back_also_where_the_pitch_is_a_right_angle():
    rng = np.random.default_rng(2)
    angles = [*rng.uniform(-1.5, 1.5, (20, 3)), [0.3, np.pi / 2, 0.4], [0.3, -np.pi / 2, 0.4], [np.pi, 0.0, -np.pi]]
    for roll, pitch, yaw in angles:
        turn = SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)
        r, p, y = roll_pitch_yaw(turn)
        again = SO3.axis("z", y) @ SO3.axis("y", p) @ SO3.axis("x", r)
        assert np.abs(again.matrix - turn.matrix).max() < 1e-9


@EVERY_ARM
def test_fingers_are_boxes_of_their_mean_thickness_that_follow_the_opening_by_half(arm):
    robot, shape, jaw = parsed(arm), arm.instrument, arm.jaw
    thick = (shape.finger_base_m + shape.finger_tip_m) / 2
    for side, sign in (("left", 1), ("right", -1)):
        link = next(link for link in robot.iter("link") if link.get("name") == f"jaw_{side}_link")
        solid = link.find("collision")
        assert numbers(solid.find("geometry/box"), "size") == pytest.approx(
            [shape.finger_length_m, thick, shape.finger_width_m]
        )
        assert numbers(solid.find("origin"), "xyz") == pytest.approx([shape.finger_length_m / 2, sign * thick / 2, 0])
        joint = next(joint for joint in robot.iter("joint") if joint.get("name") == f"jaw_{side}")
        limit, mimic = joint.find("limit"), joint.find("mimic")
        ends = sorted([sign * jaw.lower / 2, sign * jaw.upper / 2])
        assert [float(limit.get(key)) for key in ("lower", "upper")] == pytest.approx(ends)
        assert float(limit.get("velocity")) == pytest.approx(jaw.max_speed / 2)
        assert (float(mimic.get("multiplier")), float(mimic.get("offset"))) == (sign * 0.5, 0.0)


@EVERY_ARM
def test_what_is_seen_is_what_collides_and_bears_a_colour(arm):
    robot = parsed(arm)
    shape, names = arm.instrument, joint_names(arm)
    links = {link.get("name"): link for link in robot.iter("link")}
    for link in links.values():
        seen, solid = link.findall("visual"), link.findall("collision")
        assert len(seen) == len(solid)
        for one, other in zip(seen, solid, strict=True):
            (shown,), (solid_one,) = one.find("geometry"), other.find("geometry")
            assert (shown.tag, shown.attrib) == (solid_one.tag, solid_one.attrib)
            assert one.find("material") is not None and other.find("material") is None
    materials = {m.get("name"): numbers(m.find("color"), "rgba").tolist() for m in robot.findall("material")}
    assert materials["steel"] == [*STEEL, 1] and materials["carbon"] == [*CARBON, 1]
    rod, *caps = links[f"{names[4]}_link"].findall("visual")  # the clevis, a capsule
    length = float(rod.find("geometry/cylinder").get("length"))
    assert length == pytest.approx(0.75 * arm.wrist_length_m)
    assert [float(cap.find("geometry/sphere").get("radius")) for cap in caps] == [shape.wrist_radius_m] * 2
    ends = [numbers(cap.find("origin"), "xyz") for cap in caps]
    middle = numbers(rod.find("origin"), "xyz")
    assert middle == pytest.approx(np.mean(ends, axis=0)) and np.linalg.norm(ends[0] - ends[1]) == pytest.approx(length)
    box = links[f"{names[3]}_link"].find("visual/geometry/box")  # the drive unit
    assert (numbers(box, "size") > 0.05).all()
