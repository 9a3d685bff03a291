"""``--plugin FILE``: what a user's file adds, and the message for one that adds nothing."""

import json

import numpy as np
import pytest

from waypoints import FOUR

COMMANDS = {
    "run": "run {flag} peg-transfer",
    "run, after the task": "run peg-transfer {flag}",
    "plan": "plan transfer four.npy {flag}",
    "calibrate fit": "calibrate fit recording.npz --out m.npz {flag}",
    "calibrate evaluate": "calibrate evaluate m.npz recording.npz {flag}",
    "report": "report . {flag}",
    "station": "station show peg-transfer {flag}",
}
pytestmark = pytest.mark.usefixtures("registries")
EVERY_COMMAND = pytest.mark.parametrize("line", COMMANDS.values(), ids=COMMANDS)


@pytest.fixture
def said(trocar, tmp_path, monkeypatch):
    """Run a line in a folder with a plugin of this text; return its one sentence of refusal."""
    monkeypatch.chdir(tmp_path)
    np.save("four.npy", FOUR)

    def run(line, text=None, name="mine.py"):
        if text is not None:
            (tmp_path / name).write_text(text)
        before = sorted(tmp_path.rglob("*"))
        code, out, err = trocar(*line.replace("{flag}", f"--plugin {name}").split())
        assert (code, out) == (2, ""), err
        assert err.startswith("trocar: ") and err.count("\n") == 1
        assert sorted(tmp_path.rglob("*")) == before, "something was written"
        return err

    return run


@EVERY_COMMAND
def test_a_file_that_is_not_there_is_named(said, line):
    assert "plugin 'mine.py' is not a Python file; give one that registers what it adds" in said(line)


@EVERY_COMMAND
def test_a_file_that_raises_is_named_with_its_error(said, line):
    assert "plugin 'mine.py' cannot be loaded, line 2: ZeroDivisionError: division" in said(line, "import os\n1 / 0\n")


def test_a_file_of_another_kind_is_named(said):
    assert "plugin 'mine.txt' is not a Python file" in said(COMMANDS["run"], "VALUE = 1\n", "mine.txt")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "from trocar.eval import TASKS\nTASKS.register('suture', TASKS['suture'])\n",
            "task 'suture' is already registered; register yours under another name",
        ),
        (
            "from trocar.motion import PLANNERS\nPLANNERS.register('spline', None)\n",
            "planner 'spline' is already registered; register yours under another name",
        ),
    ],
)
def test_a_name_that_is_taken_is_told_with_the_file(said, text, words):
    for command in ("run", "plan"):
        assert f"plugin 'mine.py' is refused, line 2: {words}" in said(COMMANDS[command], text)


def test_several_files_may_be_given_and_are_loaded_in_order(trocar, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("four.npy", FOUR)
    first = "from trocar.motion import PLANNERS\nPLANNERS.register('test-first', PLANNERS['spline'])\n"
    second = "from trocar.motion import PLANNERS\nPLANNERS.register('test-second', PLANNERS['test-first'])\n"
    (tmp_path / "first.py").write_text(first)
    (tmp_path / "second.py").write_text(second)
    words = ("plan", "transfer", "four.npy", "--plugin", "first.py", "--plugin", "second.py", "--json")
    code, out, err = trocar(*words, "--planner", "test-second")
    assert code == 0, err
    assert json.loads(out)


@pytest.mark.parametrize("line", ["run --plugin mine.py my-task --help", "run my-task --plugin=mine.py --help"])
def test_a_task_of_ones_own_has_a_command_with_its_options(trocar, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from dataclasses import dataclass\n"
        "from trocar.eval import TASKS\n"
        "from trocar.eval import Method, Task, option\n"
        "@dataclass(frozen=True)\n"
        "class Mine(Task):\n"
        "    knots: int = option(3, 'How many knots.', metavar='N')\n"
        "    budget_s: float = option(9.0, 'A trial that takes longer is stopped.', flag='budget')\n"
        "    name, about, goal_noun, station = 'my-task', 'knots', 'knot', 'peg-transfer'\n"
        "    methods = {'by-hand': Method('by hand', object)}\n"
        "    goals = scene = world = score = lambda self, *given: None\n"
        "TASKS.register('my-task', Mine)\n"
    )
    code, out, err = trocar(*line.split())
    assert code == 0, err
    assert "--knots" in out and "How many knots." in out
    assert "--transfers" not in out


def test_a_method_of_ones_own_is_in_the_help_of_its_task_alone(trocar, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from trocar.eval import METHODS, Method\n"
        "METHODS.register('peg-transfer/by-magic', Method('a wand does it', object, object))\n"
    )
    shown = {task: trocar("run", "--plugin", "mine.py", task, "--help")[1] for task in ("peg-transfer", "suture")}
    text = " ".join(shown["peg-transfer"].split()).replace("- ", "-")
    others = "policy, policy-calibrated, person, person-calibrated"
    assert f"One of calibrated, uncalibrated, adaptive, optimized, best, by-magic, {others}." in text
    assert "by-magic" not in shown["suture"]


def test_a_method_of_ones_own_replaces_none_of_the_tasks(said):
    text = (
        "from trocar.eval import METHODS, Method\n"
        "METHODS.register('peg-transfer/calibrated', Method('a wand does it', object, object))\n"
    )
    words = said("run peg-transfer {flag}", text)
    assert "method 'peg-transfer/calibrated' would replace one of the task's own; register it under another" in words


@pytest.mark.parametrize("line", ["run --plugin mine.py peg-transfer", "run peg-transfer --plugin mine.py"])
def test_a_run_knows_its_plugins_wherever_they_stand_in_the_line(trocar, played, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    plugin = tmp_path / "mine.py"
    plugin.write_text("VALUE = 1\n")
    run = [*line.split(), "--method", "uncalibrated", "--out", "run"]
    code, _, err = trocar(*run)
    assert code == 0, err
    assert json.loads((tmp_path / "run" / "run.json").read_text())["plugins"]
    plugin.write_text("VALUE = 2\n")
    code, _, err = trocar(*run, "--trials", "2")
    assert code == 2 and "holds another run (other plugins)" in err


def test_a_quiet_run_still_tells_what_an_agent_raised(trocar, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from trocar.eval import METHODS, Method\n"
        "class Clumsy:\n"
        "    def __init__(self, context): pass\n"
        "    async def run(self): raise NameError('which block?')\n"
        "METHODS.register('peg-transfer/clumsy', Method('drops all', Clumsy))\n"
    )
    words = ("run", "peg-transfer", "--transfers", 1, "--plugin", "mine.py", "--method", "clumsy", "--out", "out")
    code, out, _ = trocar(*words, "--quiet")
    assert code == 0 and "was stopped (AGENT_ERROR): the agent raised NameError: which block?" in " ".join(out.split())
