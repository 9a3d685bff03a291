"""The simulated cell as MuJoCo reads it: drives, stops, contacts and what collides with what."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, PSM_CLASSIC, RAVEN2_LEFT
from trocar.geometry import SE3, SO3
from trocar.sim.spec import SOLID, Servo, Surface, digits
from trocar.sim.world import World

PLACED = SE3.from_parts(SO3.exp([0.1, 0.2, 0.3]), [0.3, 0.0, 0.2])


@pytest.fixture(scope="module")
def world():
    return World({"a": PSM_CLASSIC, "b": RAVEN2_LEFT}, {"a": SE3.identity(), "b": PLACED})


def test_a_servos_damping_is_critical_and_its_joints_answer_within_hundredths_of_a_second():
    servo = Servo(stiffness=(4.0, 9.0), inertia=(1.0, 4.0))
    assert_allclose(servo.damping, [4.0, 12.0])
    usual = Servo()
    times = np.sqrt(np.divide(usual.inertia, usual.stiffness))
    assert times.min() > 9.9e-3 and times.max() < 13.2e-3, "all alike: a third of a tick more at most"


def test_at_the_tip_an_arm_yields_a_millimetre_a_newton():
    """Yaw and pitch: a force across the shaft at 150 mm; insertion: along it; wrist: with a lever of a cm."""
    stiffness = np.array(Servo().stiffness)
    across, along, wrist = 0.15**2 / stiffness[0], 1 / stiffness[2], 0.01**2 / stiffness[4]
    assert 0.3e-3 < across < 0.6e-3 and 0.3e-3 < along < 0.4e-3 and 0.1e-3 < wrist < 0.2e-3
    assert 0.5e-3 < across + along + wrist < 1.5e-3
    assert stiffness[0] == stiffness[1] and stiffness[4] == stiffness[5] and 0.5 < stiffness[3] < 1.5


def test_every_joint_has_its_range_its_inertia_and_its_drives(world):
    servo, m = Servo(), world.model
    for name, arm in (("a", PSM_CLASSIC), ("b", RAVEN2_LEFT)):
        for k, joint in enumerate(arm.joints):
            found = m.joint(f"{name}_{joint.name}")
            assert_allclose(found.range, [joint.lower, joint.upper])
            assert m.dof_armature[found.dofadr[0]] == servo.inertia[k]
            drive, feed = m.actuator(f"{name}_{joint.name}"), m.actuator(f"{name}_{joint.name}_feed")
            assert drive.trnid[0] == feed.trnid[0] == found.id
            assert_allclose(drive.gainprm[0], servo.stiffness[k])
            assert_allclose(drive.biasprm[1:3], [-servo.stiffness[k], -servo.damping[k]])
            index = world.arms[name]
            assert (index.drive[k], index.feed[k], index.dof[k]) == (drive.id, feed.id, found.dofadr[0])
        assert_allclose(world.arms[name].damping, servo.damping)
    assert m.opt.timestep == 1e-3


def test_jaws_are_driven_on_one_finger_for_both_and_open_a_little_further_than_they_are_told(world):
    servo, m = Servo(), world.model
    for name, arm in (("a", PSM_CLASSIC), ("b", RAVEN2_LEFT)):
        left, right = (m.joint(f"{name}_jaw_{side}") for side in ("left", "right"))
        widest = arm.jaw.upper / 2 + 0.1
        assert_allclose(left.range, [0.0, widest])
        assert_allclose(right.range, [-widest, 0.0])
        assert m.dof_armature[left.dofadr[0]] == m.dof_armature[right.dofadr[0]] == servo.jaw_inertia_kg_m2
        drive = m.actuator(f"{name}_jaw")
        stiffness = drive.gainprm[0]
        assert_allclose(drive.forcerange, [-2 * servo.jaw_torque_nm, 2 * servo.jaw_torque_nm])
        assert_allclose(drive.biasprm[2], -2 * np.sqrt(stiffness * 2 * servo.jaw_inertia_kg_m2))
        assert 0.015 < servo.jaw_torque_nm / stiffness < 0.03, "rad by which it lags when it pulls with all it has"
        assert 1.0 < servo.jaw_torque_nm / arm.instrument.finger_length_m < 4.0, "N at the ends of the fingers"
        for side, sign in (("left", 1), ("right", -1)):
            turned = SO3.from_quaternion(m.body(f"{name}_finger_{side}").quat)
            assert_allclose(turned.matrix[:, 0], [0, 1, 0], atol=1e-12)  # a finger points along y of frame 6
            finger = m.geom(f"{name}_finger_{side}")
            assert_allclose(finger.friction, [1.0, 0.002, 0.0001])
            mesh = m.mesh_vert[m.mesh_vertadr[finger.dataid[0]] :][: m.mesh_vertnum[finger.dataid[0]]]
            local = SE3.from_parts(SO3.from_quaternion(finger.quat), finger.pos).apply(mesh.astype(float))
            corners = (
                {tuple(np.rint(1e6 * point).astype(int)) for point in p} for p in (local, arm.instrument.finger_m(sign))
            )
            assert next(corners) == next(corners), "to a micrometre"


def test_contacts_are_those_that_were_asked_for():
    surface = Surface(0.2, 0.7, (0.003, 0.0002), (0.005, 1.5), (0.9, 0.95, 0.001))
    m = World({"a": PSM_CLASSIC}, {"a": SE3.identity()}, surface=surface).model
    assert_allclose(m.geom("a_shaft").friction, [0.2, 0.003, 0.0002])
    assert_allclose(m.geom("a_finger_left").friction, [0.7, 0.003, 0.0002])
    assert_allclose(m.geom_solref, [[0.005, 1.5]] * m.ngeom)
    assert_allclose(m.geom_solimp[:, :3], [[0.9, 0.95, 0.001]] * m.ngeom)


def test_dry_plastic_slides_before_the_jaws_let_go():
    """mu of ABS on ABS; the jaws' teeth hold better. Contacts are stiff: below a tenth of a mm, within a few steps."""
    surface = Surface()
    assert 0.3 <= surface.abs_friction <= 0.5 < surface.jaw_friction <= 1.2
    torsion, rolling = surface.patch_m
    assert 1e-3 < torsion < 3e-3 and rolling < 0.1 * torsion
    assert 2 * 1e-3 <= surface.solref[0] <= 6e-3 and surface.solref[1] == 1.0
    least, most, width = surface.solimp
    assert 0.9 < least < most < 1.0 and width < 0.5e-3


@pytest.mark.parametrize("name", ["raven2-left", "raven2-right"])
def test_marks_are_painted_through_each_finger_in_its_own_colour(name):
    arm = ARMS[name]
    marks, shape = arm.instrument.marks, arm.instrument
    m = World({"x": arm}, {"x": SE3.identity()}).model
    for side, sign in (("left", 1), ("right", -1)):
        for number, center in enumerate(marks.centers_m(sign, 0.0)):
            geom = m.geom(f"x_mark_{side}{number}")
            assert m.body(geom.bodyid[0]).name == f"x_finger_{side}"
            assert_allclose(geom.pos, center, atol=1e-12)
            assert_allclose(geom.size[:2], [marks.radius_m, shape.finger_width_m / 2 + marks.proud_m])
            assert_allclose(geom.rgba, [*marks.colors[0 if sign > 0 else 1], 1.0], rtol=1e-6)


def test_solids_hang_on_their_links_with_their_sizes(world):
    m = world.model
    drive, shaft = m.geom("a_drive"), m.geom("a_shaft")
    assert_allclose(drive.size * 2, [0.06, 0.09, 0.08])
    assert m.body(drive.bodyid[0]).name == m.body(shaft.bodyid[0]).name == "a_link4"
    assert (
        m.body(m.geom("a_wrist").bodyid[0]).name == "a_link5"
        and m.body(m.geom("b_knuckle").bodyid[0]).name == "b_link6"
    )
    assert_allclose(m.body("b_base").pos, PLACED.translation_m)
    assert set(world.geom_arm.tolist()) == {0, 1} and world.geom_arm[drive.id] == 0
    assert (world.geom_arm == 1).sum() == len(world.geoms("b_"))


def test_an_instrument_collides_with_all_but_itself():
    places = [SE3.from_parts(translation_m=[0.3 * k, 0.0, 0.0]) for k in range(4)]
    m = World({f"arm{k}": PSM_CLASSIC for k in range(4)}, {f"arm{k}": T for k, T in enumerate(places)}).model
    bits = [(SOLID["contype"], SOLID["conaffinity"])]
    bits += [(m.geom(f"arm{k}_shaft").contype[0], m.geom(f"arm{k}_shaft").conaffinity[0]) for k in range(4)]
    for k, one in enumerate(bits):
        for n, other in enumerate(bits):
            assert bool(one[0] & other[1] or other[0] & one[1]) == (k != n or k == 0)


def test_numbers_are_as_a_model_file_has_them():
    assert digits(0.1 + 0.2) == 0.3 and digits([[1, 2]]).shape == (1, 2)
    assert digits(np.pi) == pytest.approx(np.pi, abs=1e-15)
