"""The browser draws everything where the kinematics and the primitive put it, for any position of the slider."""

import time

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy.testing import assert_allclose
from triangles import edges_cancel, volume_m3

from trocar.arms import RAVEN2_LEFT, fk, frames
from trocar.errors import InvalidValue, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.report.style import PATHS
from trocar.tasks.suture.planning import (
    PRESETS,
    Circle,
    Needle,
    Suture,
    SutureSetup,
    base_beside,
    dexterity,
    plan_even,
    suture_joints,
    sutures_at,
)
from trocar.tasks.suture.planning.primitive import grasp_pose, needle_poses, tip_poses, turned_to
from trocar.tasks.suture.report.circle import ring_radii_mm, texture

pytest.importorskip("viser")
from trocar.tasks.suture.view import PlanView, needle_mesh, suture_motion

PLAIN = PRESETS["default"].setup
MOVED = SE3.from_parts(SO3.exp([0.2, -0.3, 0.4]), [0.02, -0.05, 0.3])
LEANING = SutureSetup(
    T_world_base=MOVED @ PLAIN.T_world_base, grasp=PLAIN.grasp, circle=Circle(PLAIN.circle.radius_m, MOVED)
)
PORT = 8765


@pytest.fixture(params=[PLAIN, LEANING], ids=["level", "leaning"], scope="module")
def view(request):
    map = dexterity(request.param, positions=72)
    view = PlanView(map, plan_even(map), PORT)
    yield view
    view.close()


def pose(node):
    return SE3.from_parts(SO3.from_quaternion(node.wxyz), node.position)


def jaw_tip(view):
    """Return where the tip is from the drawn link that carries the jaws."""
    at_zero = frames(view.setup.arm, np.zeros(6))
    return pose(view._instrument.links[6]) @ at_zero[6].inverse() @ at_zero[7]


@pytest.mark.parametrize(("number", "place"), [(0, 0), (1, 20), (2, 47), (3, 95)])
def test_the_drawn_tip_is_where_fk_and_the_primitive_put_it(view, number, place):
    view.show(number, place)
    setup, motion = view.setup, view.motions[number]
    by_joints = setup.T_world_base @ fk(setup.arm, motion.q[place])
    assert_allclose(jaw_tip(view).matrix, by_joints.matrix, atol=1e-9)
    assert_allclose(jaw_tip(view).matrix, motion.T_world_tip.matrix[place], atol=1e-9)


def test_motion_follows_the_primitive_and_the_plans_joints(view):
    setup, plan = view.setup, view.plan
    for motion, theta, direction in zip(view.motions, plan.positions_rad, plan.directions, strict=True):
        row = 0 if direction == 1 else 1
        start = turned_to(tip_poses(setup, [0.0], [0.0]), [theta])[row, 0, 0]
        assert_allclose(motion.T_world_tip.matrix[0], (setup.circle.T_world_circle @ start).matrix, atol=1e-12)
        end = needle_poses(setup, [setup.insertion.straight_m], [np.radians(70 + 2 * 35)])
        end = setup.circle.T_world_circle @ turned_to(end, [theta])[row, 0, 0]
        assert_allclose(motion.T_world_needle.matrix[-1], end.matrix, atol=1e-12)
        planned = suture_joints(setup, [theta]).q[row, 0]
        assert_allclose(motion.q[0], planned[0], atol=1e-9)  # the winding of the roll too
        assert np.abs(motion.q[:, 3]).max() < np.abs(planned[:, 3]).max() + 0.05


def test_the_jaws_hold_the_needle_but_in_regrasps(view):
    for motion in view.motions:
        held = motion.opening_rad == 0
        T_needle_tip = motion.T_world_needle.inverse() @ motion.T_world_tip
        radius = np.linalg.norm(T_needle_tip.translation_m, axis=-1)
        assert_allclose(radius, view.setup.needle.radius_m)  # on the wire all along
        first = np.array([name in ("penetrate", "rotate") for name in motion.step])
        assert_allclose(
            T_needle_tip.matrix[first], np.broadcast_to(grasp_pose(view.setup).matrix, (32, 4, 4)), atol=1e-9
        )
        assert set(np.array(motion.step)[~held]) == {"regrasp 1", "regrasp 2"}


def pixel(rgba, side_m, x_m, y_m):
    """Return what a picture (k, k, 4) shows at a point of the circle's plane."""
    column, row = (int((value / side_m + 0.5) * len(rgba)) for value in (x_m, y_m))
    return rgba[row, column].astype(int)


def test_colours_run_over_both_directions_as_in_the_picture_of_the_plan():
    map = dexterity(PLAIN, positions=72)
    plan = plan_even(map)
    rgba, side_m = texture(map, plan)
    can = map.joints.feasible
    assert map.span(plan.rewards) == (map.values[can].min(), map.values[can].max())
    shade = Normalize(*map.span(plan.rewards))
    planned = sutures_at(PLAIN, plan.positions_rad, plan.directions)
    beside = np.abs(np.angle(np.exp(1j * (plan.positions_rad[:, None] - map.thetas_rad)))).min(0) > 0.1
    rings = 1e-3 * ring_radii_mm(PLAIN)
    assert (rings[0] > rings[1].max()).all(), "clockwise sutures are in the outer ring"
    for row, radius in enumerate(rings.mean(1)):
        for k in np.flatnonzero(beside):
            if can[row, k]:
                shown = pixel(rgba, side_m, radius * np.cos(map.thetas_rad[k]), radius * np.sin(map.thetas_rad[k]))
                assert_allclose(shown, 255 * np.array(colormaps[PATHS](shade(map.values[row, k]))), atol=2)
    for suture, reward in zip(planned, plan.rewards, strict=True):
        shown = pixel(rgba, side_m, *suture.ends_m.mean(0))
        assert_allclose(shown, 255 * np.array(colormaps[PATHS](shade(reward))), atol=2)
    assert pixel(rgba, side_m, 0.0, 0.0)[3] == 0, "the mesh within stays visible"


def test_a_number_stands_beside_the_middle_of_each_arrow(view):
    for number, suture in enumerate(sutures_at(view.setup, view.plan.positions_rad, view.plan.directions), start=1):
        label = view.server.scene._handle_from_node_name[f"/circle/label_{number}"]
        assert np.hypot(*(label.position[:2] - suture.ends_m.mean(0))) == pytest.approx(0.004)


@pytest.mark.parametrize("needle", [Needle(), Needle(0.012, np.radians(120))], ids=str)
def test_the_needle_is_drawn_closed_along_its_wire(needle):
    mesh = needle_mesh(needle)
    assert edges_cancel(mesh) and volume_m3(mesh) > 0
    off = np.abs(needle.distance_m(mesh.vertices_m.astype(float)))
    assert off.max() < 0.5 * needle.wire_m and np.median(off) < 0.02e-3
    assert np.linalg.norm(mesh.vertices_m - needle.p_tip_m, axis=1).min() < 0.1e-3


def eventually(true):
    for _ in range(100):
        if true():
            return True
        time.sleep(0.02)
    return False


def test_slider_and_menu_move_the_needle_and_the_text(view):
    view.show(0, 0)
    view._slider.value = 40
    assert eventually(lambda: np.allclose(pose(view._needle).matrix, view.motions[0].T_world_needle.matrix[40]))
    view._menu.value = view.sutures[2]
    assert eventually(lambda: np.allclose(pose(view._needle).matrix, view.motions[2].T_world_needle.matrix[40]))
    assert view.motions[2].step[40] in view._text.content
    assert f"{np.degrees(view.motions[2].q[40, 3]):.1f} deg" in view._text.content


def test_the_table_of_joints_says_what_is_outside():
    motion = suture_motion(Suture(PLAIN, 0.0, 1))
    q = motion.q.copy()
    q[5, 4] = np.radians(83.0)
    q[5, 2] = 0.25
    object.__setattr__(motion, "q", q)
    table = motion.joint_table(5).splitlines()
    assert table[2 + 4] == "| wrist pitch | 83.0 deg | -80 to 80 | **-3 outside** |"
    assert table[2 + 2] == "| insertion | 250.0 mm | 0 to 240 | **-10 outside** |"


@pytest.mark.parametrize(("at", "what"), [((4, 0), "suture is 4"), ((-1, 0), "suture is -1"), ((0, 96), "frame is 96")])
def test_what_is_not_there_cannot_be_shown(view, at, what):
    with pytest.raises(InvalidValue, match=f"number of the {what}"):
        view.show(*at)


def test_a_suture_without_solution_is_told():
    arm = RAVEN2_LEFT
    setup = SutureSetup(arm=arm, T_world_base=base_beside(0.0, 0.0, 0.1), grasp=PLAIN.grasp)
    gone = ~np.isfinite(suture_joints(setup, np.arange(0, 6.3, 0.1)).q).all((2, 3))
    row, k = np.argwhere(gone)[0]
    with pytest.raises(OutOfReach, match="cannot point its instrument there"):
        suture_motion(Suture(setup, 0.1 * k, (1, -1)[row]))
