"""Scene, time line, camera and joints show the same moment, whether time is played, moved by the slider, or jumped
to."""

import asyncio
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay, still_replay
from trocar.errors import TrocarError
from trocar.replay import CameraImage, Goal

pytest.importorskip("viser")
from visitor import busy, visitor_of

from trocar.view.camera_panel import CameraPanel, decoded
from trocar.view.film import STILL_M
from trocar.view.joints_panel import JointsPanel
from trocar.view.timeline import ErrorPanel, TimeLinePanel
from trocar.view.trial_view import TrialView, jumps

REPLAY = made_up_replay(12.0)
SOMEBODY = SimpleNamespace(client=object())
NOBODY = SimpleNamespace(client=None)


@pytest.fixture(scope="module")
def view():
    view = TrialView(REPLAY, 0)
    yield view
    view.close()


def panel(view, kind):
    return next(panel for panel in view._panels if isinstance(panel, kind))


def drawn_at(view, time_s):
    """Return whether every body stands where it was at the film's frame before a time."""
    film = view.stage.film
    frame = film.frame_at(time_s)
    for body, T in REPLAY.T_world_body.items():
        if body in film.bodies:
            node = view.server.scene.get_handle_by_name(f"/bodies/{body}")
            if np.linalg.norm(node.position - T.translation_m[film.ticks[frame]]) > 1.05 * STILL_M:
                return False
    return True


@pytest.mark.parametrize("time_s", [0.0, 3.21, 11.99, 12.0, 1.5])
def test_a_time_is_shown_by_the_scene_the_slider_and_the_joints(view, time_s):
    view.show(time_s)
    assert drawn_at(view, time_s)
    assert view._slider.value == pytest.approx(time_s, abs=0.006)
    joints = panel(view, JointsPanel)
    assert joints._table.content == joints._joints.table(round(100 * time_s))


def test_beyond_its_ends_the_end_is_shown(view):
    for asked, shown in ((-3.0, 0.0), (99.0, 12.0)):
        view.show(asked)
        assert view.time_s == shown


def test_the_camera_shows_what_it_took_last(view):
    camera = panel(view, CameraPanel)
    view.show(0.2)
    assert not camera._picture.visible
    assert camera._said.content == "takes its first image at 0.50 s"
    for time_s, image in ((0.5, 0), (3.4, 0), (3.5, 1), (11.0, 3)):
        view.show(time_s)
        assert camera._picture.visible
        assert (camera._picture.image == decoded(REPLAY.images[image])).all()
        assert camera._said.content == f"taken at {REPLAY.images[image].time_s:.2f} s"


def test_a_damaged_image_is_told():
    damaged = replace(REPLAY, images=(CameraImage(0.0, "overhead", b"no image"),))
    view = TrialView(damaged, 0)
    try:
        camera = panel(view, CameraPanel)
        assert camera._said.content == "taken at 0.00 s, unreadable"
        assert not camera._picture.visible
    finally:
        view.close()


def test_the_time_line_follows(view):
    view.show(2.0)
    before = panel(view, TimeLinePanel)._whole.image
    view.show(8.0)
    assert (panel(view, TimeLinePanel)._whole.image != before).any()


def test_time_runs_at_the_chosen_speed_and_stops_at_the_end(view):
    view.show(2.0)
    view.run(True)
    assert view._button.label == "Pause"
    view.advance(1.0)
    assert_allclose(view.time_s, 3.0)
    view._speed.value = "x 4"
    view.advance(1.0)
    assert_allclose(view.time_s, 7.0)
    assert drawn_at(view, 7.0)
    assert view.plays
    view.advance(99.0)
    assert view.time_s == 12.0
    assert not view.plays
    assert view._button.label == "Play"
    view._speed.value = "x 1"
    view.run(True)  # again from the start
    assert view.time_s == 0.0
    view.run(False)


def test_play_lets_time_go_by_until_somebody_ends_it(view, monkeypatch):
    naps = []

    def nap(seconds):
        naps.append(seconds)
        if len(naps) > 5:
            raise KeyboardInterrupt

    monkeypatch.setattr("trocar.view.trial_view.time", SimpleNamespace(sleep=nap, monotonic=lambda: 0.1 * len(naps)))
    view.show(1.0)
    view.run(True)
    with pytest.raises(KeyboardInterrupt):
        view.play()
    view.run(False)
    assert_allclose(view.time_s, 1.5)


def test_a_hand_on_the_slider_moves_the_scene_and_the_program_on_it_does_not(view):
    view.show(1.0)
    view._slider.value = 5.0
    asyncio.run(view._slid(NOBODY))
    assert view.time_s == 1.0
    asyncio.run(view._slid(SOMEBODY))
    assert view.time_s == 5.0
    assert drawn_at(view, 5.0)


def test_a_hand_on_the_slider_counts_though_the_next_frame_sets_it_back(view):
    view.show(1.0)
    with visitor_of(view.server) as visitor, busy(view.server):
        visitor.choose(view._slider, 5.0)
        view.advance(0.1)
        view.show(view.time_s)
    assert view.time_s == pytest.approx(5.1)


def test_events_and_contacts_can_be_jumped_to(view):
    assert list(view.jumps.values()) == sorted(view.jumps.values())
    assert view.jumps["1.00 s  grasp, arm psm1"] == 1.0
    touch = "2.20 s  contact: psm1 left finger - peg 7, 1.5 N"
    view.run(True)
    view._menu.value = touch
    view._chosen(SOMEBODY)
    assert_allclose(view.time_s, 2.2)
    assert not view.plays
    assert view.server.scene.get_handle_by_name("/contacts/0").visible
    event = {"name": "pick failed", "time_s": 3.27, "peg": 1, "jaw_rad": -0.1014, "path": [1, 2]}
    assert jumps(replace(REPLAY, events=(event,), contacts=(), goals=())) == {"3.27 s  pick failed, peg 1": 3.27}


def test_goals_are_counted_from_one_as_in_the_report():
    goals, event = (
        (Goal("psm1", 0, 1.0, 4.0, True),),
        {"name": "transfer", "time_s": 4.0, "goal": 0, "reason": "slipped"},
    )
    told = jumps(replace(REPLAY, events=(event,), contacts=(), goals=goals))
    assert list(told) == ["4.00 s  missed: goal 1, psm1", "4.00 s  transfer, goal 1, reason slipped"]


def test_the_menu_of_joints_changes_the_curves(view):
    view.show(6.0)
    joints = panel(view, JointsPanel)
    joints._menu.value = "insertion"
    for _ in range(100):
        if joints._curves.title == "insertion: difference from desired, mm":
            break
        time.sleep(0.02)
    assert joints._curves.title == "insertion: difference from desired, mm"
    assert_allclose(joints._curves.data[1], 2.0)  # commanded: 2 mm more


@pytest.mark.parametrize(
    ("replay", "kinds"),
    [
        (still_replay(), {TimeLinePanel, CameraPanel, JointsPanel}),
        (replace(made_up_replay(0.5), spans=(), joints={}, images=(), events=()), {ErrorPanel}),
    ],
)
def test_what_a_trial_does_not_have_is_left_out(replay, kinds):
    view = TrialView(replay, 0)
    try:
        view.show(0.3)
        assert {type(panel) for panel in view._panels} == kinds
    finally:
        view.close()


def test_only_this_machine_can_open_it_and_it_says_nothing_on_stdout(capsys):
    view = TrialView(still_replay(), 0)
    assert view.server.get_host() == "127.0.0.1"
    view.close()
    assert not view.server._websock_server._server_thread.is_alive()
    assert capsys.readouterr().out == ""


def test_a_port_out_of_range_is_told():
    with pytest.raises(TrocarError, match="the port is 65536; give 1 to 65535, or 0 for any that is free"):
        TrialView(still_replay(), 65536)


def test_the_slider_is_marked_where_something_touched_or_a_goal_was_missed(view):
    wanted = sorted({touch.time_s for touch in REPLAY.contacts} | {12.0})
    assert [mark.value for mark in view._slider._marks] == pytest.approx(wanted)
    assert view.jumps["12.00 s  missed: goal 2, psm2"] == 12.0


def test_whole_paths_are_shown_on_request(view):
    whole = view.server.scene.get_handle_by_name("/paths/psm2 driven, all")
    assert not whole.visible
    view.stage.paths.show_whole(True)
    assert whole.visible
    view.stage.paths.show_whole(False)
