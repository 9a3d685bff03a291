"""Agents see pixels and encoders. Everything else of the simulator is poison to them."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trocar.agents
from simulated import ideal_session
from trocar.agents import AGENTS, SETTINGS
from trocar.cell import Assistant, Camera, Cell, Log, Robot
from trocar.sim.cell import SimulatedCell
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.tasks import TASKS
from trocar.trials import TrialLog

FORBIDDEN = ("trocar.sim", "trocar.scene.truth", "trocar.tasks", "trocar.trials", "trocar.report", "mujoco")


class Poisoned(AssertionError):
    """An agent reached for something that no laboratory has."""


def hidden(method):
    """Return the method without its object."""

    def call(*args, **kwargs):
        return method(*args, **kwargs)

    return call


class Only:
    """A device that shows the names of a protocol and raises at any other."""

    def __init__(self, device, protocol):
        names = {name for name in vars(protocol) if not name.startswith("_")}
        object.__setattr__(self, "_hidden", (device, names, type(device).__name__))

    def __getattribute__(self, name):
        device, names, kind = object.__getattribute__(self, "_hidden")
        if name in names:
            value = getattr(device, name)
            return hidden(value) if callable(value) else value
        raise Poisoned(f"an agent reached for {name!r} of {kind}")

    def __setattr__(self, name, value):
        raise Poisoned(f"an agent set {name!r}")


def poisoned_cell(task, seed: int) -> tuple[SimulatedCell, Cell, TrialLog]:
    """Return a simulated cell, what an agent may see of it, and the log."""
    session = ideal_session(task.T_world_base)
    simulated = SimulatedCell(
        session, task.scene(np.random.default_rng(seed)), np.random.default_rng(seed), SensorFlaws.none()
    )
    log = TrialLog(lambda: simulated.world.time_s)
    cell = Cell(
        robot=Only(simulated.robot, Robot),
        camera=Only(simulated.camera, Camera),
        arms=session.arms,
        T_world_base=session.T_world_base_found,
        T_world_camera=simulated.T_world_camera,
        T_world_board=task.T_world_board,
        log=Only(log, Log),
        assistant=simulated.assistant and Only(simulated.assistant, Assistant),
    )
    return simulated, cell, log


@pytest.mark.parametrize(("task_name", "variant"), AGENTS, ids=["/".join(key) for key in AGENTS])
def test_an_agent_works_with_every_other_name_poisoned(task_name, variant):
    task = TASKS[task_name](variant)
    simulated, cell, log = poisoned_cell(task, seed=1)
    agent = AGENTS[task_name, variant](cell, SETTINGS[task_name, variant]())
    assert simulated.run(lambda: agent.run(task.work[:1]), task.budget_s)
    (score,) = task.score(log.events, simulated.referee.truth())
    assert score.attempted
    assert score.succeeded, score.failure


@pytest.mark.parametrize(
    "peek",
    [
        lambda cell: cell.robot.world,
        lambda cell: cell.robot._drives,
        lambda cell: cell.robot.__dict__,
        lambda cell: cell.robot.read.__self__,
        lambda cell: cell.camera._world,
        lambda cell: cell.log.events,
        lambda cell: setattr(cell.robot, "read", None),
    ],
)
def test_the_poison_bites(peek):
    _, cell, _ = poisoned_cell(TASKS["peg-transfer"](), seed=1)
    with pytest.raises((Poisoned, AttributeError)):
        peek(cell)


def agent_files() -> list[Path]:
    return sorted(Path(trocar.agents.__file__).parent.glob("*.py"))


@pytest.mark.parametrize("path", agent_files(), ids=lambda path: path.stem)
def test_no_agent_imports_truth_or_simulator(path):
    imported = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            imported += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imported += [f"{node.module}.{alias.name}" for alias in node.names]
            assert node.level == 0, "a relative import hides what it takes"
        elif isinstance(node, ast.Call):
            assert getattr(node.func, "id", getattr(node.func, "attr", "")) not in {"import_module", "__import__"}
    reached = [name for name in imported if name.startswith(FORBIDDEN)]
    assert reached == []


def test_not_even_what_agents_import_loads_truth_or_simulator():
    code = "import sys, trocar.agents; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in loaded if name.startswith(FORBIDDEN)] == []
