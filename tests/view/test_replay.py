"""The page of a replay, read without a browser: poses are the trial's, nothing is loaded from elsewhere, it stays
small."""

import os
import re
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay, still_replay
from trocar.errors import TrocarError
from trocar.files.output import mark_of
from trocar.geometry import SE3
from trocar.replay import ToolPath
from trocar.view.film import shoot
from trocar.view.replay import END_S, LARGEST_BYTES, write_replay
from trocar.view.server import close_server, open_server
from trocar.view.stage import ARMS

pytest.importorskip("viser")
from played import Player, Recording

REPLAY = made_up_replay(12.0)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_replay(REPLAY, tmp_path_factory.mktemp("page") / "replay.html")


@pytest.fixture(scope="module")
def recording(page):
    return Recording.of(page.read_text())


def test_poses_are_the_trials_in_single_precision_written_once_a_body_has_moved(recording):
    film = shoot(REPLAY)
    assert film.rate_hz == 30.0
    for kind, field, tracks in (
        ("SetPositionMessage", "position", film.position_m),
        ("SetOrientationMessage", "wxyz", film.wxyz),
    ):
        written = {}
        for at, message in recording.of_kind(kind):
            if at > 0 and message["name"].startswith("/bodies/"):
                written.setdefault(message["name"], []).append((at, message[field]))
        for body, track, moved in zip(film.bodies, tracks, film.moved, strict=True):
            frames = 1 + np.flatnonzero(moved[1:])
            got = written.get(f"/bodies/{body}", [])
            assert_allclose([at for at, _ in got], film.times_s[frames], atol=1e-9)
            assert [tuple(values) for _, values in got] == [
                tuple(row) for row in track[frames].astype(np.float32).astype(float).tolist()
            ]


def test_the_first_frame_stands_at_the_start_and_the_last_one_a_while(recording):
    first = Player(recording).play_to(0.0)
    T = REPLAY.T_world_body["psm1_link4"][0]
    assert_allclose(first["/bodies/psm1_link4"].position, T.translation_m, atol=1e-7)
    assert_allclose(recording.duration_s, REPLAY.times_s[-1] + END_S, atol=1e-6)
    assert_allclose(recording.times_s[-1], REPLAY.times_s[-1], atol=1e-6)


def test_every_solid_is_drawn_in_its_colour(recording):
    meshes = {m["name"]: m["props"] for _, m in recording.of_kind("MeshMessage") if m["name"].startswith("/bodies/")}
    assert {name.split("/")[2] for name in meshes} == {solid.body for solid in REPLAY.solids}
    shaft = recording.array(meshes["/bodies/psm1_link4/1"]["vertices"]).reshape(-1, 3)
    assert_allclose(shaft[:, :2].max(), 0.004, rtol=1e-3)
    assert meshes["/bodies/psm1_link4/1"]["color"] == [26, 28, 33]  # (0.10, 0.11, 0.13)
    blocks = [meshes[f"/bodies/block{k}/0"]["vertices"]["__binary_index"] for k in range(6)]
    assert len(set(blocks)) == 1  # equal meshes are stored once


def test_the_driven_path_ends_at_the_tip_and_the_planned_one_runs_ahead(recording):
    player = Player(recording)
    for time_s in (0.0, 3.3, 7.0, 12.0):
        nodes = player.play_to(time_s)
        tick = round(time_s * 100)
        for arm, path in REPLAY.tools.items():
            driven = recording.array(nodes[f"/paths/{arm} driven, now"].props["points"]).reshape(-1, 3)
            assert_allclose(driven[-1], path.p_world_driven_m[tick], atol=1e-3)
            planned = recording.array(nodes[f"/paths/{arm} planned"].props["points"]).reshape(-1, 3)
            ahead = path.p_world_planned_m[min(tick + 90, 1200)]
            assert np.linalg.norm(planned - ahead, axis=1).min() < 3e-3


POINTS = {
    f"{arm} {kind}": points
    for arm, path in REPLAY.tools.items()
    for kind, points in (("driven", path.p_world_driven_m), ("planned", path.p_world_planned_m))
}


def test_the_path_of_the_present_goal_is_drawn_and_whole_paths_are_hidden(recording):
    player = Player(recording)
    for time_s, start_s in ((0.0, 0.0), (5.3, 0.0), (9.4, 6.0), (12.0, 6.0)):
        nodes = player.play_to(time_s)
        for arm, path in REPLAY.tools.items():
            first, now = round(100 * start_s), round(100 * max(start_s, np.floor(time_s)))
            driven = recording.array(nodes[f"/paths/{arm} driven"].props["points"]).reshape(-1, 3)
            assert_allclose(driven[[0, -1]], path.p_world_driven_m[[first, now]], atol=1e-6)
            planned = recording.array(nodes[f"/paths/{arm} planned"].props["points"]).reshape(-1, 3)
            goal = path.p_world_planned_m[first : first + 601]
            assert_allclose(planned[0], goal[0], atol=1e-6)
            assert_allclose([planned.min(0), planned.max(0)], [goal.min(0), goal.max(0)], atol=3e-3)
    for name, points in POINTS.items():
        node = nodes[f"/paths/{name}, all"]
        assert not node.visible
        line = recording.array(node.props["points"]).reshape(-1, 3)
        assert_allclose([line.min(0), line.max(0)], [points.min(0), points.max(0)], atol=3e-3)


def test_each_arm_has_its_colour_and_its_port_and_all_stands_on_a_table(recording):
    nodes = Player(recording).play_to(0.0)
    for (arm, port_m), colour in zip(REPLAY.ports_m.items(), ARMS, strict=False):
        for kind in ("planned", "driven", "driven, now", "planned, all", "driven, all"):
            shown = recording.array(nodes[f"/paths/{arm} {kind}"].props["colors"]).reshape(-1, 3)
            assert (shown == colour).all()
        assert_allclose(nodes[f"/ports/{arm}"].position, port_m)
    assert "/table" in nodes


def test_contacts_are_seen_at_their_place_while_they_last(recording):
    player = Player(recording)
    for touch in REPLAY.contacts:
        nodes = player.play_to(touch.time_s + 0.05)
        seen = [node for name, node in nodes.items() if re.fullmatch(r"/contacts/\d+", name) and node.visible]
        assert any(np.allclose(node.position, touch.p_world_m) for node in seen)
        texts = [node.props["text"] for name, node in nodes.items() if name.endswith("/label")]
        assert f"{touch.between[0]} - peg 7, 1.5 N" in texts
    nodes = Player(recording).play_to(6.0)
    assert not any(node.visible for name, node in nodes.items() if re.fullmatch(r"/contacts/\d+", name))


def test_a_short_contact_is_seen_for_half_a_second(tmp_path):
    touch = replace(REPLAY.contacts[0], time_s=0.5, end_s=0.51)
    page = write_replay(replace(made_up_replay(1.5), contacts=(touch,)), tmp_path / "replay.html")
    player = Player(Recording.of(page.read_text()))
    assert [player.play_to(at)["/contacts/0"].visible for at in (0.45, 0.55, 0.95, 1.1)] == [False, True, True, False]


def test_labels_stand_over_the_tips_and_say_what_the_arms_do(recording):
    player = Player(recording)
    for time_s, doing in ((0.5, "capture"), (1.5, "perceive"), (4.5, "grasp")):
        nodes = player.play_to(time_s)
        for arm, path in REPLAY.tools.items():
            label, tip = nodes[f"/arms/{arm}"], path.p_world_driven_m[round(100 * time_s)]
            assert label.props["text"] == f"{arm}: {doing}"
            assert_allclose(label.position[:2], tip[:2], atol=3e-3)
            assert label.position[2] > tip[2]


def test_the_camera_looks_at_the_workspace(recording):
    (look,) = [m["look_at"] for _, m in recording.of_kind("SetCameraLookAtMessage")]
    tips = np.concatenate([path.p_world_driven_m for path in REPLAY.tools.values()])
    assert (tips.min(0) <= look).all()
    assert (look <= tips.max(0)).all()


def test_nothing_is_fetched_from_elsewhere(page, recording):
    text = page.read_text()
    shell = re.sub(r'data-p="[^"]*"', "", re.sub(r'__VISER_EMBED_DATA__="[^"]*"', "", text))
    assert set(re.findall(r"(?:https?|wss?|ftp)://[^\s'\"]+", shell)) == {"http://www.w3.org/2000/svg"}
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)\s*=\s*[\"']?(?!data:)[^\"'>\s]", shell)
    assert "default-src 'none'" in shell.split("<script", 1)[0]  # the browser holds it to that
    assert not [m for _, m in recording.messages if "://" in repr({k: v for k, v in m.items() if k != "hdri_data"})]
    assert not recording.of_kind("GlbMessage", "BatchedGlbMessage", "RunJavascriptMessage", "GaussianSplatsMessage")


def test_title_and_legend_are_in_the_page_whatever_the_title_is(tmp_path):
    named = replace(made_up_replay(0.3), title='</head><script>alert("x")</script> & more')
    text = write_replay(named, tmp_path / "replay.html").read_text()
    assert "<script>alert" not in text
    assert text.count("&lt;/head&gt;&lt;script&gt;alert(&quot;x&quot;)&lt;/script&gt; &amp; more") == 2
    for words in (
        "tip, planned",
        "tip, driven",
        "30 frames per second",
        "For research, not for use on patients",
        "psm1",
        "psm2",
    ):
        assert words in text


def test_a_minute_of_two_arms_is_small_and_keeps_its_frames(tmp_path):
    replay = made_up_replay(60.0)
    page = write_replay(replay, tmp_path / "replay.html")
    assert page.stat().st_size < 2_200_000
    assert len(Recording.of(page.read_text()).times_s) == pytest.approx(1801, abs=2)


@pytest.mark.slow
def test_a_long_trial_gets_fewer_frames_a_second_and_stays_small(tmp_path):
    page = write_replay(made_up_replay(200.0), tmp_path / "replay.html")
    assert page.stat().st_size <= LARGEST_BYTES
    assert "15 frames per second" in page.read_text()
    assert len(Recording.of(page.read_text()).times_s) == pytest.approx(3001, abs=3)


def test_much_beside_the_poses_costs_frames(tmp_path, monkeypatch):
    monkeypatch.setattr("trocar.view.replay.LARGEST_BYTES", 1_000_000)
    monkeypatch.setattr("trocar.view.replay.MAX_POSES", 4200)
    assert "7.5 frames per second" in write_replay(REPLAY, tmp_path / "replay.html").read_text()


def test_the_same_replay_makes_the_same_page(tmp_path):
    replay = made_up_replay(1.0)
    first, second = (write_replay(replay, tmp_path / name).read_bytes() for name in ("a.html", "b.html"))
    assert first == second


@pytest.mark.parametrize("replay", [still_replay(), made_up_replay(0.0), made_up_replay(0.5, (), 0)])
def test_what_hardly_moves_or_has_no_arms_makes_a_page(replay, tmp_path):
    recording = Recording.of(write_replay(replay, tmp_path / "replay.html").read_text())
    assert recording.of_kind("MeshMessage")


def test_unknown_stretches_of_a_path_are_bridged_and_unknown_paths_left_out(tmp_path):
    n = len(REPLAY.times_s)
    known = REPLAY.tools["psm1"].p_world_driven_m
    gaps = np.where((np.arange(n) < 300)[:, None], np.nan, known)
    tools = {"psm1": ToolPath(np.full((n, 3), np.nan), gaps)}
    recording = Recording.of(write_replay(replace(REPLAY, tools=tools), tmp_path / "replay.html").read_text())
    nodes = Player(recording).play_to(0.0)
    lines = {name: recording.array(node.props["points"]) for name, node in nodes.items() if name.startswith("/paths/")}
    assert set(lines) == {f"/paths/psm1 driven{part}" for part in ("", ", now", ", all")}
    assert all(np.isfinite(line).all() for line in lines.values())


def test_bodies_with_slashes_in_their_names_do_not_hang_on_each_other(tmp_path):
    replay = still_replay()
    poses = {f"cell/{body}": T for body, T in replay.T_world_body.items()}
    solids = tuple(replace(solid, body=f"cell/{solid.body}") for solid in replay.solids)
    page = write_replay(replace(replay, T_world_body=poses, solids=solids), tmp_path / "replay.html")
    nodes = Player(Recording.of(page.read_text())).play_to(0.0)
    assert "/bodies/cell|world" in nodes
    assert not any(name.startswith("/bodies/cell/") for name in nodes)


def test_it_says_nothing_and_leaves_no_thread_and_no_port_behind(tmp_path):
    code = (
        "import sys, threading, pathlib; sys.path[:0] = ['src', 'tests']\n"
        "from made_up_replay import made_up_replay\nfrom trocar.view.replay import write_replay\n"
        f"write_replay(made_up_replay(0.5), {str(tmp_path / 'replay.html')!r})\n"
        "sys.stderr.write(f'{threading.active_count()} ')\n"
        "tables = [pathlib.Path('/proc/net', name).read_text() for name in ('tcp', 'tcp6')]\n"
        "listening = [line for table in tables for line in table.splitlines() if ' 0A ' in line]\n"
        "own = [f.resolve().name for f in pathlib.Path('/proc/self/fd').iterdir() if 'socket' in str(f.resolve())]\n"
        "sys.stderr.write(str(sum(line.split()[9] in name for line in listening for name in own)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    assert done.stdout == ""
    assert done.stderr == "1 0"


def test_it_does_not_disturb_a_server_that_runs_already_and_only_this_machine_could_reach_its_own(
    tmp_path, monkeypatch
):
    server, seen = open_server(0), []

    def watched(port):
        seen.append((open_server(port), port))
        return seen[-1][0]

    monkeypatch.setattr("trocar.view.replay.open_server", watched)
    try:
        ball = server.scene.add_icosphere("/ball", radius=1.0)
        threads = threading.active_count()
        page = write_replay(made_up_replay(0.2), tmp_path / "replay.html")
        assert [(own.get_host(), port) for own, port in seen] == [("127.0.0.1", 0)]
        assert threading.active_count() == threads
        assert "/ball" not in Player(Recording.of(page.read_text())).play_to(0.0)
        ball.position = (1.0, 2.0, 3.0)
        assert server.scene.get_handle_by_name("/ball") is ball
    finally:
        close_server(server)


def test_a_page_that_is_there_is_replaced_and_one_that_cannot_be_written_is_told(tmp_path):
    path = tmp_path / "replay.html"
    path.write_text(f"an older one, {mark_of('replay')}")
    write_replay(made_up_replay(0.2), path)
    assert path.stat().st_size > 500_000
    assert [file.name for file in tmp_path.iterdir()] == ["replay.html"]
    with pytest.raises(TrocarError, match=r"cannot write '.*gone.*' \(No such file or directory\)"):
        write_replay(made_up_replay(0.2), tmp_path / "gone" / "replay.html")


def test_a_server_is_closed_when_a_replay_does_not_fit_together(tmp_path):
    threads = threading.active_count()
    short = ToolPath(np.zeros((3, 3)), np.zeros((3, 3)))
    with pytest.raises(TrocarError, match=r"the planned path of 'psm1' has shape \(3, 3\)"):
        write_replay(replace(made_up_replay(0.2), tools={"psm1": short}), tmp_path / "replay.html")
    assert threading.active_count() == threads
    assert not list(tmp_path.iterdir())


def test_without_viser_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(TrocarError, match=r"pip install -e '\.\[view\]'"):
        write_replay(made_up_replay(0.2), tmp_path / "replay.html")


def test_poses_at_one_tick_can_be_a_single_pose(tmp_path):
    replay = made_up_replay(0.2)
    poses = {**replay.T_world_body, "block3": SE3(replay.T_world_body["block3"].matrix[0])}
    page = write_replay(replace(replay, T_world_body=poses), tmp_path / "replay.html")
    node = Player(Recording.of(page.read_text())).play_to(0.0)["/bodies/block3"]
    assert_allclose(node.position, poses["block3"].translation_m, atol=1e-9)
