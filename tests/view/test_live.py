"""A live page draws the present moment, says how each arm fares, and goes on whatever its process does."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("viser")
from live_scene import REPLAY, MadeUpScene, messages, moment, until

from trocar.errors import MachineError
from trocar.geometry import SE3, SO3
from trocar.replay import Contact, ToolPath
from trocar.view.camera_panel import FOUND
from trocar.view.film import STILL_M, STILL_RAD
from trocar.view.live import TRAIL_S, LiveView, Picture, legend
from trocar.view.live_page import LivePage
from trocar.view.replay import notice

LIMIT_S = 60.0
SHIFT = SE3.from_parts(translation_m=[0.003, -0.002, 0.0])


@pytest.fixture
def view():
    view = LiveView(MadeUpScene(), "made up", moment(0), port=0)
    yield view
    view.close()


def node(view, name):
    return view.server.scene.get_handle_by_name(name)


def test_bodies_tips_and_labels_are_where_they_are_at_the_moment(view):
    for tick in (150, 320):
        view.show(moment(tick))
        for body in view._moving:
            T = REPLAY().T_world_body[body][tick]
            assert_allclose(node(view, f"/bodies/{body}").position, T.translation_m, atol=1e-6)
            turned = np.abs(node(view, f"/bodies/{body}").wxyz @ T.rotation.as_quaternion())
            assert_allclose(turned, 1.0, atol=1e-6)
        for arm, path in REPLAY().tools.items():
            dot = node(view, f"/paths/{arm} by its encoders, now")
            assert_allclose(dot.position, path.p_world_planned_m[tick], atol=1e-6)
            (true,) = (tip._lines[1] for tip in view._tips if tip.arm == arm)
            assert_allclose(true.points[-1, 1], path.p_world_driven_m[tick], atol=1e-6)
    assert "block0" in view._moving and "psm1_finger_left" in view._moving


def test_how_an_arm_fares_is_told_with_its_tips_error_and_no_text_becomes_html(view):
    view._due_s = 0.0
    view.show(moment(200, "PAUSED"))
    told = view._state.content
    path = REPLAY().tools["psm1"]
    off_mm = 1e3 * np.linalg.norm(path.p_world_planned_m[200] - path.p_world_driven_m[200])
    assert "PAUSED" in told and "ENABLED" not in told and f"{off_mm:.1f} mm" in told
    assert "&lt;nobody&gt;" in told and "<nobody>" not in told
    assert node(view, "/arms/psm1").text == "psm1: PAUSED"


def test_events_and_contacts_are_listed_newest_first_and_a_contacts_ball_goes(view):
    touch = Contact(1.0, 1.1, ("psm1", "peg 3"), (0.0, 0.0, 0.02), 2.5)
    view.show(moment(110, events=({"name": "refused", "time_s": 1.02, "arm": "psm1", "topic": "servo_jf"},)))
    view._due_s = 0.0
    view.show(moment(112, contacts=(touch,)))
    listed = view._events.content
    assert listed.index("contact: psm1 - peg 3, 2.5 N") < listed.index("refused, arm psm1, topic servo_jf")
    assert node(view, "/contacts/1") is not None
    view.show(moment(330))
    assert node(view, "/contacts/1") is None


def test_joints_are_those_of_the_last_seconds(view):
    for tick in range(5, 600, 5):
        view._due_s = 0.0
        view.show(moment(tick))
    joints = view._joints["psm1"]._joints
    assert joints.times_s[-1] == 5.95 and 4.9 < joints.times_s[-1] - joints.times_s[0] < 5.01
    assert_allclose(joints.values["true"][-1, 0], np.rad2deg(REPLAY().joints["psm1"]["true"][595, 0]))


def test_an_image_is_shown_with_its_words(view):
    for shade in (40, 200):
        view.show_image(Picture("overhead", np.full((90, 1680, 3), shade, np.uint8), f"shade {shade}"))
    words, picture = view._cameras["overhead"]
    assert words.content == "shade 200" and picture.image.shape == (45, 840, 3) and (picture.image == 200).all()


def test_another_trial_begins_without_paths_contacts_and_events_of_the_one_before(view):
    touch = Contact(4.0, 4.1, ("psm1", "peg 3"), (0.0, 0.0, 0.02), 2.5)
    for tick in (300, 400):
        view.show(moment(tick, contacts=(touch,)))
    view.begin(MadeUpScene())
    for tick in (0, 100, 200, 300):
        view._due_s = 0.0
        view.show(moment(tick))
    assert all(len(tip._points) <= 3 for tip in view._tips)
    assert not view._balls and node(view, "/contacts/1") is None and "contact" not in view._events.content


class Shifted(MadeUpScene):
    """Its fixed bodies stand elsewhere."""

    def shown(self, *about):
        replay = super().shown(*about)
        still = {body: SHIFT @ T for body, T in replay.T_world_body.items() if T.matrix.ndim == 2}
        return replace(replay, T_world_body={**replay.T_world_body, **still})


class Trembling(MadeUpScene):
    """Everything that moves moves 6 um up and down besides."""

    def shown(self, title, times_s, *about):
        replay = super().shown(title, times_s, *about)
        up_m = np.array([0.0, 0.0, 6e-6 * (round(20 * times_s[0]) % 2)])
        up = SE3.from_parts(translation_m=up_m)
        bodies = {body: up @ T if T.matrix.ndim == 3 else T for body, T in replay.T_world_body.items()}
        tools = {a: ToolPath(p.p_world_planned_m, p.p_world_driven_m + up_m) for a, p in replay.tools.items()}
        return replace(replay, T_world_body=bodies, tools=tools)


class Repainted(MadeUpScene):
    """Its first block is of another colour."""

    def shown(self, *about):
        replay = super().shown(*about)
        paint = {"block0": (0.1, 0.2, 0.3, 1.0)}
        return replace(replay, solids=tuple(replace(s, rgba=paint.get(s.body, s.rgba)) for s in replay.solids))


def test_another_trial_has_its_board_where_it_is():
    """Each session has its own; a person works by what the page shows."""
    view = LiveView(MadeUpScene(), "made up", moment(0), port=0)
    drawn = {solid.body for solid in REPLAY().solids}
    board = next(body for body, T in REPLAY().T_world_body.items() if T.matrix.ndim == 2 and body in drawn)
    before_m = np.array(node(view, f"/bodies/{board}").position)
    nodes = len(view.server.scene._handle_from_node_name)
    view.begin(Shifted())
    view.show(moment(0))
    shifted_m = np.array(node(view, f"/bodies/{board}").position) - before_m
    assert_allclose(shifted_m, SHIFT.translation_m, atol=1e-9)
    assert len(view.server.scene._handle_from_node_name) == nodes, "nothing is left of the board before"
    view.show(moment(100))
    view.close()


def test_another_trial_draws_only_bodies_again_that_look_different(view):
    before = {body: node(view, f"/bodies/{body}") for body in view._moving}
    view.begin(Repainted())
    view.show(moment(100))
    assert {body for body, drawn in before.items() if node(view, f"/bodies/{body}") is not drawn} == {"block0"}
    assert node(view, "/bodies/block0/0").color == (26, 51, 76)
    assert_allclose(
        node(view, "/bodies/block0").position, REPLAY().T_world_body["block0"].translation_m[100], atol=1e-6
    )


def test_a_browser_that_comes_late_gets_every_body_where_it_is(view):
    view.show(moment(100))
    view.begin(Shifted())
    for tick in (250, 350):
        view.show(moment(tick))
    at_m = {}
    for message in messages(view.port):
        if message["type"] in ("FrameMessage", "SetPositionMessage"):
            at_m[message["name"]] = message.get("position", at_m.get(message["name"]))
        if message["type"] == "ReplayDoneMessage":
            break
    now = view._replay(moment(350))
    for body in {solid.body for solid in now.solids}:
        wanted = now.T_world_body[body].translation_m.reshape(-1, 3)[0]
        assert_allclose(at_m[f"/bodies/{body}"], wanted, atol=STILL_M, err_msg=body)


def test_of_a_cell_that_rests_nothing_is_sent(view):
    """Of arms that tremble too little to be seen neither, once their trails have shrunk to points."""
    view.begin(Trembling())
    view._due_s = np.inf  # leaves out the panel
    for k in range(60):
        view.show(replace(moment(200), time_s=2.0 + 0.05 * k))
    sent = view.server._websock_server.get_message_buffer()
    before = sent.message_counter
    view.show(replace(moment(200), time_s=5.0))
    assert sent.message_counter == before
    assert all(np.ptp(line.points, axis=0).max() == 0 for tip in view._tips for line in tip._lines)
    view.show(replace(moment(300), time_s=5.05))
    for tip in view._tips:
        assert_allclose(tip._lines[1].points[-1, 1], REPLAY().tools[tip.arm].p_world_driven_m[300], atol=STILL_M)


def test_while_the_clock_stands_nothing_is_kept(view):
    for _ in range(50):
        view.show(moment(100))
    assert len(view._joints_at) == 3 and all(len(tip._points) <= 3 for tip in view._tips)


def test_in_slow_motion_a_trail_has_few_points_and_ends_at_the_tip(view):
    for tick in range(300, 560):  # 10 ms apart
        view.show(moment(tick))
    for tip in view._tips:
        trail = np.array([time_s for time_s, _ in tip._points])
        assert len(trail) < 0.4 * 260 and trail[0] == pytest.approx(trail[-1] - TRAIL_S, abs=0.04)
        assert_allclose(tip._lines[1].points[-1, 1], REPLAY().tools[tip.arm].p_world_driven_m[559], atol=1e-6)


def test_only_the_present_row_becomes_a_replay(view):
    """The rows before it have been one already, and only their joints are needed again."""
    rows = []

    class Counting(MadeUpScene):
        def shown(self, title, times_s, *about):
            rows.append(len(times_s))
            return super().shown(title, times_s, *about)

    view.begin(Counting())
    for tick in range(0, 200, 20):
        view._due_s = 0.0
        view.show(moment(tick))
    assert rows == [1] * 10 and len(view._joints["psm1"]._joints.times_s) == 10


@pytest.mark.parametrize(
    ("step_m", "step_rad"), [((5e-6, 0, 0), 0.0), ((0, 0, 0), 25e-6)], ids=["moves slowly", "turns slowly"]
)
def test_a_body_is_moved_once_it_is_far_enough_from_where_it_is_drawn(view, step_m, step_rad):
    shown = node(view, f"/bodies/{view._moving[0]}")
    start_m, start = view._bodies._drawn_m.copy(), view._bodies._drawn_wxyz.copy()
    drawn = []
    for k in range(1, 41):
        turn = SO3.axis("x", k * step_rad)
        there = SE3.from_parts(turn @ SO3.from_quaternion(start), start_m + k * np.array(step_m))
        view._bodies.place(there.translation_m.astype(np.float32), there.rotation.as_quaternion().astype(np.float32))
        off_rad = (SO3.from_quaternion(shown.wxyz).inverse() @ there.rotation[0]).angle()
        assert np.linalg.norm(shown.position - there.translation_m[0]) < 1.05 * STILL_M and off_rad < 1.05 * STILL_RAD
        drawn.append((*shown.position, *shown.wxyz))
    assert 5 <= len(set(drawn)) <= 10, "of 40 steps, each a fourth of what is seen"


def test_what_perception_found_is_drawn_into_the_image(view):
    color, square = np.full((200, 400, 3), 40, np.uint8), np.array([[10.0, 10.0], [50, 10], [50, 50], [10, 50]])
    view.show_image(Picture("overhead", color, "", {"block": square}))
    assert (view._cameras["overhead"][1].image[30, 10] == FOUND).all()


def test_steps_are_told_over_the_arms_and_in_the_time_line_once_there_are_any(view):
    assert not view._steps.visible
    view._due_s = 0.0
    view.show(
        moment(100, spans=(("psm1", "capture", 0.2, 0.4),), begun=(("psm1", "pick", 0.4), ("psm1", "motion", 0.5)))
    )
    assert view._steps.visible and "capture" in view._time_line._legend.content
    assert node(view, "/arms/psm1").text == "psm1: motion, ENABLED"
    assert node(view, "/arms/psm2").text == "psm2: ENABLED"


def test_of_real_arms_nothing_is_called_simulated_or_true():
    made_up = REPLAY()
    joints = {arm: {kind: q for kind, q in kinds.items() if kind != "true"} for arm, kinds in made_up.joints.items()}
    real = replace(made_up, joints=joints)
    assert "Simulated" in notice(made_up) and "true" in legend(made_up)
    assert "Simulated" not in notice(real) and "patients" in notice(real) and "true" not in legend(real)


def test_the_clocks_rate_is_that_of_the_last_seconds(view):
    wall_s = 1000.0
    view.begin(MadeUpScene())
    for tick in range(10, 590, 10):
        wall_s += 0.2 if tick < 100 else 0.05
        view._due_s = 0.0
        view.show(moment(tick, made_s=wall_s))
    assert view.rate == pytest.approx(2.0, rel=0.05) and "2.0" in view._state.content


def shown(page, tick):
    """Show a moment as soon as the page waits for one."""
    until(lambda: page.waits)
    page.show(moment(tick))


@pytest.mark.realtime
def test_a_program_that_opens_the_page_gets_what_is_shown():
    wanted = REPLAY().T_world_body["psm1_link6"].translation_m[250]
    with LivePage(MadeUpScene(), "made up", moment(0), port=0) as page:
        shown(page, 250)
        for message in messages(page.port):
            is_link = message["type"] == "SetPositionMessage" and message["name"] == "/bodies/psm1_link6"
            if is_link and np.allclose(message["position"], wanted, atol=1e-6):
                return


@pytest.mark.realtime
def test_a_page_that_stands_still_or_has_gone_holds_nobody_up():
    with LivePage(MadeUpScene(), "made up", moment(0), port=0) as page:
        until(lambda: page.waits)
        os.kill(page._process.pid, signal.SIGSTOP)
        page.show(moment(10))
        time.sleep(0.3)
        assert not page.waits and page.unanswered_s >= 0.3
        os.kill(page._process.pid, signal.SIGCONT)
        until(lambda: page.waits)
        assert page.unanswered_s == 0.0
        os.kill(page._process.pid, signal.SIGKILL)
        page._process.join(LIMIT_S)
        assert not page.waits
        page.show(moment(40))
        assert not page.waits


@pytest.mark.realtime
def test_a_page_that_cannot_start_is_told():
    with pytest.raises(MachineError, match="did not start"), LivePage(None, "made up", moment(0), port=0):  # type: ignore[arg-type]
        pass
