"""The examples: scripts that run, and files that a command takes with ``--plugin``, as their own first lines say."""

import ast
import json
import os
import re
import runpy
import shutil
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from browser import browser, find_chromium
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from made_episodes import short
from processes import UNPICTURED, python
from trocar.calibration.plant import PSM1_GREY
from trocar.console.inputs import wishes_of
from trocar.eval.folder import load_trials
from trocar.eval.trial import trial_file
from trocar.files.archive import read_header
from trocar.geometry import SE3, SO3
from trocar.learn.dataset import export_lerobot
from trocar.learn.policy import load_policy
from trocar.view.wishes import Said, Wish
from waypoints import FOUR

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = ("first_trial.py", "move_an_arm.py", "plan_sutures.py")
PLUGINS = ("own_agent.py", "own_cable_model.py", "own_perception.py", "own_planner.py", "own_task.py", "three_dots.py")
LEARNED = ("chunked_mlp.py", "lerobot_act.py", "lerobot_server.py")
DEVICES = ("teleop_phone.py", "gamepad.py")
QUICK = ("--calibration", "joints")
SHORT = ("--transfers", "1", "--flawless-camera", *QUICK)

QUICK_TRIAL = """
import runpy, sys
import trocar.eval.prepare
from trocar.tasks.peg_transfer.task import PegTransfer
goals = PegTransfer.goals
PegTransfer.goals = lambda task: goals(task)[:1]
trocar.eval.prepare.IMAGES_ROWS = 40
runpy.run_path(sys.argv.pop(1), run_name="__main__")
"""


def run(words, folder):
    """Return what a Python process with these words says, in this folder."""
    result = python(words, folder)
    assert result.returncode == 0, result.stderr
    return result.stdout


def trocar(words, folder, code=UNPICTURED):
    return run(["-c", code, *words], folder)


def commands_of(name):
    """Return the command lines in an example's docstring, as words, the example by its full path."""
    text = ast.get_docstring(ast.parse((EXAMPLES / name).read_text()))
    lines = re.findall(r"^ *trocar (.+)$", text, re.MULTILINE)
    assert lines, f"{name} does not say how it is used"
    return [line.replace(f"examples/{name}", str(EXAMPLES / name)).split() for line in lines]


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def assert_complete(folder):
    """Every run leaves a summary, pictures, a page and a replay that asks no network for anything."""
    for picture in ("storyboard.png", "timechart.png"):
        assert (folder / picture).stat().st_size > 10_000
    replay = (folder / "replay.html").read_text()
    assert 100_000 < len(replay) < 3 << 20
    assert "replay.html" in (folder / "report.html").read_text()


def test_every_example_is_tested():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*SCRIPTS, *PLUGINS, *LEARNED, *DEVICES}


# Scripts.


def test_the_first_trial_prints_its_transfers_and_leaves_pictures(tmp_path):
    said = run(["-c", QUICK_TRIAL, EXAMPLES / "first_trial.py"], tmp_path)
    assert re.search(r"^peg  1 to  7: \w+", said, re.MULTILINE)
    assert (tmp_path / "out" / "example" / "storyboard.png").stat().st_size > 10_000


def test_an_arm_is_moved_and_says_where_it_is(tmp_path):
    said = run([EXAMPLES / "move_an_arm.py"], tmp_path)
    assert "the motion ran to its end" in said and "the script came to its end" in said
    tip_mm = np.array(re.search(r"put the tip at \[(.*)\] mm", said)[1].split(), dtype=float)
    assert np.abs(tip_mm - [40.0, 20.0, 30.0]).max() < 0.11


def test_sutures_are_planned_and_drawn(tmp_path):
    said = run([EXAMPLES / "plan_sutures.py"], tmp_path)
    even, freer = map(float, re.findall(r": (\d\.\d+)", said))
    assert 0 < even <= freer <= 1
    assert (tmp_path / "out" / "sutures.png").stat().st_size > 10_000


# Policies. What trains them (PyTorch, LeRobot) is not installed here.


def seen_at(x_m, done=0.0):
    objects = np.zeros(15, np.float32)
    objects[14] = done
    return {"state": np.array([x_m, 0, 0, 0, 0, 0, 1, 0], np.float32), "objects": objects}


def test_the_network_plays_what_it_predicts_until_its_task_is_done(tmp_path):
    code = runpy.run_path(str(EXAMPLES / "chunked_mlp.py"))
    shutil.copy(EXAMPLES / "chunked_mlp.py", tmp_path / "policy.py")
    steps = np.arange(code["CHUNK"])[:, None] * np.ones(8)
    weights = {
        "weight0": np.zeros((4, 18)),
        "bias0": np.zeros(4),
        "weight1": np.zeros((240, 4)),
        "bias1": steps.ravel(),
    }
    scale = {"mean_in": np.zeros(18), "sd_in": np.ones(18), "mean_out": np.full(8, 5.0), "sd_out": np.full(8, 2.0)}
    np.savez(tmp_path / "weights.npz", **weights, **scale)
    with load_policy(str(tmp_path)) as ask:
        played = [ask(seen_at(0.0))[0] for _ in range(code["PLAYED"] + 1)]
        assert played == [5.0 + 2 * k for k in range(code["PLAYED"])] + [5.0]
        while (action := ask(seen_at(0.1, done=1.0))) is not None and action[0] > 5.2:
            pass
        assert action is not None, "it goes on to where it began"
        for _ in range(code["PLAYED"]):
            action = ask(seen_at(0.0, done=1.0))
        assert action is None


def test_what_the_network_predicts_moves_with_the_scene(tmp_path):
    rng = np.random.default_rng(0)
    code = runpy.run_path(str(EXAMPLES / "chunked_mlp.py"))
    weights = {"weight0": rng.normal(size=(240, 18)), "bias0": rng.normal(size=240)}
    scale = {"mean_in": np.zeros(18), "sd_in": np.ones(18), "mean_out": np.zeros(8), "sd_out": np.ones(8)}
    np.savez(tmp_path / "weights.npz", **weights, **scale)
    policy, raw, by_m = code["make"](tmp_path), rng.normal(size=26), rng.normal(size=3)
    moved = raw.copy()
    for at in (0, 13, 19, 23):  # tip, grasp, target, first position
        moved[at : at + 3] += by_m
    expected = policy.predicted(raw)
    expected[:, :3] += by_m
    np.testing.assert_allclose(policy.predicted(moved), expected, atol=1e-9)
    with pytest.raises(ValueError, match="give --transfers 1"):
        policy.predicted(np.append(raw, np.zeros(15)))  # of two transfers


def test_the_network_learns_from_an_exported_data_set(tmp_path):
    noted = {"observed_state": np.zeros((91, 8), np.float32), "observed_objects": np.ones((91, 15), np.float32)}
    events = [{"name": "observed", "time_s": 0.0, "objects": [f"number{k}" for k in range(15)]}]
    trials = [replace(one, arrays=one.arrays | noted, events=one.events + events) for one in (short(0), short(1))]
    export_lerobot(trials, tmp_path)
    seen, chunks = runpy.run_path(str(EXAMPLES / "chunked_mlp.py"))["frames_of"](tmp_path)
    assert [part.shape for part in (*seen, *chunks)] == [(91, 26)] * 2 + [(91, 30, 8)] * 2
    np.testing.assert_allclose(chunks[0][0, 1:], chunks[0][1, :-1])
    np.testing.assert_allclose(chunks[0][-1], np.tile(chunks[0][-1, 0], (30, 1)))


STAND_INS = """
import sys, types
def module(name, **members):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__dict__.update(members)
class Rows(list):
    def __getitem__(self, key): return self if key is None else list.__getitem__(self, key)
    def tolist(self): return list(self)
class Nothing:
    def __enter__(self): pass
    def __exit__(self, *_): pass
class Policy:
    config = None
    from_pretrained = classmethod(lambda cls, folder: cls())
    def reset(self): pass
    def select_action(self, batch):
        return [Rows([batch["observation.state"][0], batch["observation.environment_state"][0]])]
module("torch", tensor=lambda values, dtype: Rows(values), float32=None, no_grad=Nothing, set_num_threads=print)
for name in ("lerobot", "lerobot.policies", "lerobot.policies.act"):
    module(name)
module("lerobot.policies.act.modeling_act", ACTPolicy=Policy)
same = lambda values: values
module("lerobot.policies.factory", make_pre_post_processors=lambda config, folder: (same, same))
import runpy
runpy.run_path(sys.argv.pop(1), run_name="__main__")
"""


def test_a_policy_of_lerobot_is_served(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, "-c", STAND_INS, EXAMPLES / "lerobot_server.py", tmp_path, "--port", str(port)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as server:
        try:
            while b"serving" not in (line := server.stdout.readline()):
                assert line, "it has ended"
            with load_policy(f"tcp://127.0.0.1:{port}") as ask, load_policy(f"tcp://127.0.0.1:{port}") as other:
                assert ask(seen_at(0.25)) == [0.25, 0.0] and other(seen_at(0.5)) == [0.5, 0.0]
                assert ask(seen_at(0.25, done=1.0)) is None and other(seen_at(0.6, done=1.0)) is not None
        finally:
            server.terminate()


# Devices. The package that they speak to is not installed here.


class Teleop:
    """Calls back as the package does, with a telephone's poses in axes that point forward, left and up."""

    def __init__(self, port):
        self.port = port

    def subscribe(self, callback):
        self.callback = callback

    def run(self):
        pose = SE3.from_parts(SO3.exp([0.3, 0.0, 0.0]), [0.1, 0.0, 0.2]).matrix
        for move, gripper in ((True, "close"), (False, "open"), (False, "open")):
            self.callback(pose, {"move": move, "gripper": gripper})


def test_a_telephone_moves_an_arm_as_its_holder_sees_it_until_the_console_ends(monkeypatch, capsys):
    quaternions = SimpleNamespace(mat2quat=lambda matrix: SO3(matrix).as_quaternion())
    euler = SimpleNamespace(euler2mat=lambda *angles: SO3.exp(angles).matrix)
    monkeypatch.setitem(sys.modules, "transforms3d", SimpleNamespace(quaternions=quaternions, euler=euler))
    monkeypatch.setitem(sys.modules, "teleop", SimpleNamespace(Teleop=Teleop))
    with socket.create_server(("127.0.0.1", 0)) as console, ThreadPoolExecutor() as aside:

        def two_lines():
            with console.accept()[0] as connection, connection.makefile("rwb") as stream:
                for _ in range(2):
                    yield from wishes_of(stream.readline(), "telephone", {"psm1": {}})
                    stream.write(b'{"words": "In your hands: psm1"}\n')
                    stream.flush()

        heard = aside.submit(lambda: list(two_lines()))
        monkeypatch.setattr(sys, "argv", ["teleop_phone.py", "--console", str(console.getsockname()[1])])
        monkeypatch.setattr(os, "_exit", sys.exit)
        with pytest.raises(SystemExit):
            runpy.run_path(str(EXAMPLES / "teleop_phone.py"), run_name="__main__")
        hold, close, release, opened = heard.result()
    assert [said.wish for said in (hold, close, release, opened)] == [Wish.HOLD, Wish.JAW, Wish.RELEASE, Wish.JAW]
    np.testing.assert_allclose(hold.value.position_m, [0.0, 0.1, 0.2], atol=1e-12)  # in the pictures, y is forward
    np.testing.assert_allclose(hold.value.wxyz, SO3.exp([0.0, 0.3, 0.0]).as_quaternion(), atol=1e-12)
    assert hold.value.scale < 1 and close.value == 0 and opened.value > 0
    assert capsys.readouterr().out == "In your hands: psm1\nthe console has ended\n"


GAMEPAD = """
window.pad = {mapping: "standard", axes: [0, 0, 0, 0], buttons: Array.from({length: 17}, () => ({value: 0}))}
Object.defineProperty(navigator, "getGamepads", {value: () => [null, {...window.pad, buttons: window.pad.buttons.map(
  button => ({value: button.value, pressed: button.value > 0.5}))}]})
"""
"""A gamepad that is not there, as browsers tell of one."""


def came(heard, wish, times):
    """Wait until a wish has come so many times."""
    end_s = time.monotonic() + 30.0
    while sum(said.wish is wish for said in heard) < times:
        assert time.monotonic() < end_s, f"no {wish}"
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.skipif(find_chromium() is None, reason="no Chromium found: nothing reads a gamepad")
def test_a_gamepad_moves_an_arm_while_its_shoulder_button_is_held_and_no_other_page_does(tmp_path):
    heard: list[Said] = []
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]

    def console(listening):
        with listening.accept()[0] as connection, connection.makefile("rwb") as stream:
            for line in stream:
                heard.extend(wishes_of(line, "gamepad", {"psm1": {}}))
                stream.write(b'{"words": "In your hands: psm1"}\n')
                stream.flush()

    with socket.create_server(("127.0.0.1", 0)) as listening, browser() as page:
        Thread(target=console, args=(listening,), daemon=True).start()
        devices = str(listening.getsockname()[1])
        words = [sys.executable, EXAMPLES / "gamepad.py", "--devices", devices, "--port", str(port)]
        with subprocess.Popen([*words, "--console", "about:blank"], stdout=subprocess.PIPE) as served:
            try:
                address = served.stdout.readline().decode().strip()
                with pytest.raises(InvalidStatus):
                    connect(address.replace("http", "ws"), origin="http://elsewhere.example")
                page.call("Page.addScriptToEvaluateOnNewDocument", source=GAMEPAD)
                page.call("Page.navigate", url=address)
                page.until("document.querySelector('#words')?.textContent.startsWith('In your hands')")
                assert {said.wish for said in heard} <= {Wish.RELEASE}, "nobody has touched it"
                presses = (
                    (7, [0, 0, 0, 0], Wish.JAW, 1),
                    (5, [0.9, -1, 0, 0], Wish.HOLD, 20),
                    (1, [0, 0, 0, 0], Wish.STOP, 1),
                )
                for button, axes, wish, times in presses:
                    page.evaluate(f"window.pad.axes = {axes}; window.pad.buttons[{button}].value = 1; 0")
                    came(heard, wish, times)
                page.evaluate("window.pad.buttons[5].value = window.pad.buttons[7].value = 0; 0")
                came(heard, Wish.JAW, 2)
                came(heard, Wish.RELEASE, sum(said.wish is Wish.RELEASE for said in heard) + 1)
            finally:
                served.terminate()
    did = [said.wish for said in heard]
    assert did.index(Wish.JAW) < did.index(Wish.HOLD) < did.index(Wish.STOP) < len(did) - 1 - did[::-1].index(Wish.JAW)
    jaws, held = ([said.value for said in heard if said.wish is wish] for wish in (Wish.JAW, Wish.HOLD))
    assert jaws[0] == 0 < jaws[1] and len(jaws) == 2 and did.count(Wish.STOP) == 1 and did[-1] is Wish.RELEASE
    right, away, up = np.array(held[-1].position_m)
    assert 0.5 * away < right < away and away > 0.003 and up == 0.0, "in the pictures, y is away"


# Plugins.


@pytest.fixture(scope="module")
def own_task(tmp_path_factory):
    folder = tmp_path_factory.mktemp("task")
    (words,) = commands_of("own_task.py")
    assert {"--trials", "--seed"} <= set(words)
    return folder / "out" / "own-task", trocar([*words, *QUICK], folder, "from trocar.cli import main; main()")


@pytest.mark.parametrize(("name", "most"), [("three_dots.py", 70), ("own_task.py", 160), ("own_planner.py", 22)])
def test_an_own_thing_takes_few_lines(name, most):
    assert len([line for line in (EXAMPLES / name).read_text().splitlines() if line.strip()]) <= most


def test_three_dots_are_a_task_of_which_two_trials_succeed(tmp_path):
    (words,) = commands_of("three_dots.py")
    trocar([*words, "--out", str(tmp_path / "dots")], tmp_path)
    summary = summary_of(tmp_path / "dots")
    assert (summary["attempted"], summary["trials"]) == (6, 2)
    assert summary["succeeded"] == 6, "in this session the cables happen to err little"
    trial, _ = load_trials(tmp_path / "dots")
    ends = [score["end_s"] for score in trial[0].scores]
    assert ends == sorted(ends) and ends[0] > 0.0


def test_an_own_task_runs_to_summary_pictures_and_replay(own_task):
    folder, said = own_task
    summary = summary_of(folder)
    assert (summary["task"], summary["goal_noun"], summary["trials"], summary["seed"]) == ("own-task", "ball", 2, 3)
    assert summary["attempted"] == 8 and summary["succeeded"] >= 7
    assert f"{summary['succeeded']} of 8" in said and "balls" in said
    assert_complete(folder)


def test_an_own_task_can_be_resumed_and_reported_on_even_without_its_file(own_task):
    folder, _ = own_task
    before = {path: path.read_bytes() for path in folder.rglob("*.npz")}
    (words,) = commands_of("own_task.py")
    summary = summary_of(folder)
    trial_file(folder, 0, 1).unlink()
    trocar([*words, *QUICK], folder.parents[1])
    assert {path: path.read_bytes() for path in folder.rglob("*.npz")} == before
    counted = ("task", "attempted", "succeeded", "mean_time_s", "fingerprint")
    reported = json.loads(trocar(["report", folder, "--json"], folder))
    assert [reported[key] for key in counted] == [summary[key] for key in counted]


@pytest.mark.slow
def test_an_own_agent_runs_and_what_it_does_of_its_own_is_in_the_trial(tmp_path):
    (words,) = commands_of("own_agent.py")
    trocar([*words, *SHORT], tmp_path)
    folder = tmp_path / "out" / "second-look"
    assert (summary_of(folder)["method"], summary_of(folder)["succeeded"]) == ("second-look", 1)
    ((trial,), _) = load_trials(folder)
    (look,) = [event for event in trial.events if event["name"] == "second look"]
    assert look["peg"] == 7
    assert trial.about["settings"]["settle_s"] == 0.12


@pytest.mark.slow
def test_an_own_perception_is_what_the_agent_sees_with(tmp_path):
    (words,) = commands_of("own_perception.py")
    trocar([*words, *SHORT], tmp_path)
    folder = tmp_path / "out" / "twice"
    assert summary_of(folder)["succeeded"] == 1
    assert load_trials(folder)[0][0].about["perception"] == "twice"


@pytest.mark.slow
def test_an_own_cable_model_is_fitted_evaluated_and_used_in_a_run(tmp_path):
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (200, 6)), axis=0), -1, 1)
    np.savez(tmp_path / "RECORDING.npz", q_cmd=q, q_phy=PSM1_GREY.measure(PSM1_GREY.run(q), rng))
    fit, *evaluate, run_it = commands_of("own_cable_model.py")
    assert "fitted plane on 200 rows" in " ".join(trocar(fit, tmp_path).split())
    assert read_header(tmp_path / "plane.npz", "trocar cable model", 2)["name"] == "plane"
    (words,) = evaluate
    scored = json.loads(trocar([*words, "--json"], tmp_path))
    assert scored["model"] == "plane"
    assert np.all(np.array(scored["rmse_after"])[3:] < 0.75 * np.array(scored["rmse_before"])[3:])
    trocar([*run_it, *SHORT], tmp_path)
    folder = tmp_path / "out" / "plane"
    assert (summary_of(folder)["model"], summary_of(folder)["attempted"]) == ("plane", 1)
    assert read_header(folder / "session_00" / "cables_psm1.npz", "trocar cable model", 2)["name"] == "plane"


@pytest.mark.slow
def test_an_own_planner_plans_and_drives(tmp_path):
    np.save(tmp_path / "WAYPOINTS.npy", FOUR)
    (words,) = commands_of("own_planner.py")
    assert "Transfers by 'stop-and-go'" in trocar(words, tmp_path)
    plugin = ("--plugin", EXAMPLES / "own_planner.py", "--planner", "stop-and-go")
    folder = tmp_path / "out"
    trocar(["run", "peg-transfer", *plugin, *SHORT, "--seed", 3, "--out", folder], tmp_path)
    assert (summary_of(folder)["planner"], summary_of(folder)["attempted"]) == ("stop-and-go", 1)
    assert summary_of(folder)["command_limit_use"]["acceleration"] <= 1.0 + 1e-6
