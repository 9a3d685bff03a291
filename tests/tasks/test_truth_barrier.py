"""Agents see pixels and encoders. Everything else of the simulator is poisoned for them, in every registered task."""

import ast
import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulated import coarse, ideal_session
from trocar.calibration.fleet import expected, load_prior
from trocar.cell import Camera, Cell, Clock, Log, Robot
from trocar.eval import TASKS, AgentContext, methods_of, perceptions_of, pick_method, pick_perception
from trocar.eval.method import PERCEPTIONS
from trocar.lab import SensorFlaws, load_station
from trocar.motion import PLANNERS
from trocar.registry import Lazy
from trocar.robots import Adaptive
from trocar.sim.laboratory import SimLaboratory

FORBIDDEN = (
    "trocar.sim",
    "trocar.lab.session",
    "trocar.lab.laboratory",
    "trocar.eval.config",
    "trocar.eval.run",
    "trocar.eval.staged",
    "trocar.eval.trial",
    "trocar.report",
    "mujoco",
)
OF_A_TASK = ("world", "truth", "score", "scene", "task", "report")
"""Modules of a task's own folder that know the truth, or those who do."""

ALIKE = {("debridement", "best-1cm"), ("peg-transfer", "uncalibrated"), ("suture", "uncalibrated")}
"""Methods that are another one with a shorter step, or without the compensation that no arm of these cells wears."""
METHODS = [(task, method) for task in TASKS for method in methods_of(TASKS[task]) if (task, method) not in ALIKE]
EVERY_METHOD = pytest.mark.parametrize(("name", "method"), METHODS, ids=["/".join(pair) for pair in METHODS])
EVERY_TASK = pytest.mark.parametrize("name", TASKS)

BRISK = {
    "debridement": {
        "tip_speed_m_s": 0.05,
        "descent_speed_m_s": 0.025,
        "watch_s": 0.4,
        "close_s": 0.0,
        "vision_lag_s": 0.1,
        "plan_budget_s": 0.05,
        "watch_binning": 1,
    },
    "suture": {"driving_speed_m_s": 0.016},
}
"""Settings by which a task's agents hurry, where they have them: how long an arm takes says nothing of what it sees."""


class Poisoned(AssertionError):
    """An agent reached for something that no laboratory has."""


def brisk(name, settings):
    """Return settings of a task's agent with less waiting and fewer looks on the way."""
    return replace(
        settings, **{field: value for field, value in BRISK.get(name, {}).items() if hasattr(settings, field)}
    )


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


def poisoned(name, seed: int) -> tuple[SimLaboratory, Cell]:
    """Return an ideal laboratory with a task in it and coarse cameras, and what an agent may see of it."""
    task = TASKS[name]()
    station = coarse(task.at(load_station(task.station)))
    world = task.world(task.scene(np.random.default_rng(seed), station))
    lab = SimLaboratory(ideal_session(station), world, np.random.default_rng(seed), flaws=SensorFlaws.none())
    cell = replace(
        lab.cell,
        robot=Only(lab.cell.robot, Robot),
        cameras={name: Only(camera, Camera) for name, camera in lab.cell.cameras.items()},
        clock=Only(lab.cell.clock, Clock),
        log=Only(lab.cell.log, Log),
        assistants={what: hidden(who) for what, who in lab.cell.assistants.items()},
    )
    return lab, cell


def dressed(chosen, task, cell: Cell, station):
    """Return the robot as a method's agent has it."""
    if not chosen.learns:
        return chosen.wrapped(cell, chosen.make_settings())
    arms, prior = task.working_arms(station), load_prior("fleet")
    models = {arm: expected(prior, task.calibration(station, arm)) for arm in arms}
    limits = {name: arm.limits for name, arm in station.arms.items()}
    priors = dict.fromkeys(arms, prior)
    return Adaptive(cell.robot, cell.arms, models, limits, cell.clock, cell.log, priors=priors)


@EVERY_METHOD
def test_an_agent_works_with_every_other_name_poisoned(name, method):
    lab, cell = poisoned(name, seed=1)
    kind, task, chosen = TASKS[name], TASKS[name](), pick_method(TASKS[name], method)
    context = AgentContext(
        cell=replace(cell, robot=dressed(chosen, task, cell, lab.session.station)),
        goals=task.goals()[:1],
        nominal=task.nominal(),
        arms=task.working_arms(lab.session.station),
        planner=PLANNERS[chosen.planner],
        perception=pick_perception(kind, chosen.perception) if chosen.perception else None,
        rng=np.random.default_rng(0),
        settings=brisk(name, chosen.make_settings()),
    )
    agent = chosen.make_agent(context)
    assert lab.run(lambda _: agent.run(), task.budget_s)
    first, *others = task.score(lab.truth(), lab.log.events)
    assert first.attempted
    assert first.succeeded, first.failure
    assert not any(score.succeeded for score in others)


PEEKS = {
    "the world behind the robot": lambda cell: cell.robot.world,
    "the robot's driver": lambda cell: cell.robot._driver,
    "the robot's insides": lambda cell: cell.robot.__dict__,
    "the owner of a verb": lambda cell: cell.robot.read.__self__,
    "the world behind the camera": lambda cell: next(iter(cell.cameras.values()))._world,
    "what the camera took before": lambda cell: next(iter(cell.cameras.values())).taken,
    "the laboratory behind the clock": lambda cell: cell.clock.now_s.__self__,
    "what other scripts noted": lambda cell: cell.log.events,
    "the task behind an assistant": lambda cell: [who.__self__ for who in (*cell.assistants.values(), print_nothing)],
    "another robot's verb": lambda cell: setattr(cell.robot, "read", None),
}


def print_nothing():
    """Stand in for an assistant where there is none."""


@EVERY_TASK
@pytest.mark.parametrize("peek", PEEKS.values(), ids=list(PEEKS))
def test_the_poison_bites(name, peek):
    _, cell = poisoned(name, seed=1)
    with pytest.raises((Poisoned, AttributeError)):
        peek(cell)


# What agents and perceptions import.


def module_of(thing) -> str:
    return thing.where.partition(":")[0] if isinstance(thing, Lazy) else thing.__module__


def modules_that_act(name) -> list[str]:
    """Return the modules of a task's agents, settings and perceptions."""
    task, found = TASKS[name], []
    for method in methods_of(task):
        chosen = pick_method(task, method)
        found += [module_of(chosen.agent), module_of(chosen.settings)]
    own = [task.perceptions[p] for p in task.perceptions]
    outside = [PERCEPTIONS[f"{name}/{p}"] for p in perceptions_of(task) if p not in task.perceptions]
    return sorted({*found, *map(module_of, [*own, *outside])})


def folder_of(name) -> str:
    return TASKS[name].__module__.rpartition(".")[0]


def forbidden(name) -> tuple[str, ...]:
    return (*FORBIDDEN, *(f"{folder_of(name)}.{module}" for module in OF_A_TASK))


def is_forbidden(module, name) -> bool:
    return any(module == other or module.startswith(f"{other}.") for other in forbidden(name))


def imports_of(path) -> list[str]:
    """Return all names that a file imports anywhere in it."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "a relative import hides what it takes"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "id", getattr(node.func, "attr", ""))
            assert called not in {"import_module", "__import__", "exec", "eval"}, "an import that nobody can read"
    return found


def file_of(module) -> Path | None:
    """Return the file of a module; None of a name inside one."""
    try:
        spec = importlib.util.find_spec(module)
    except (ModuleNotFoundError, AttributeError):
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


@EVERY_TASK
def test_no_agent_imports_truth_or_simulator_not_even_by_way_of_its_own_folder(name):
    todo, seen, reached = modules_that_act(name), set(), []
    assert todo
    while todo:
        module = todo.pop()
        path = file_of(module) or file_of(module.rpartition(".")[0])
        if path is None or path in seen:
            continue
        seen.add(path)
        for imported in imports_of(path):
            if is_forbidden(imported, name):
                reached.append(f"{path.name}: {imported}")
            elif imported.startswith(f"{folder_of(name)}."):
                todo.append(imported)
    assert reached == []
    assert len(seen) >= 2


@EVERY_TASK
def test_not_even_what_agents_import_loads_truth_or_simulator(name):
    code = f"import sys; import {', '.join(modules_that_act(name))}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert [module for module in loaded if is_forbidden(module, name)] == []


def test_the_search_for_imports_finds_what_it_should(tmp_path):
    """Else a barrier that looks at nothing would stand for ever."""
    sneaky = tmp_path / "sneaky.py"
    sneaky.write_text("def f():\n    from trocar.tasks.peg_transfer.truth import PegTruth\n    import mujoco\n")
    reached = [module for module in imports_of(sneaky) if is_forbidden(module, "peg-transfer")]
    assert reached == ["trocar.tasks.peg_transfer.truth.PegTruth", "mujoco"]
    assert not is_forbidden("trocar.tasks.peg_transfer.scenery", "peg-transfer")
    for line in ("from . import truth", "__import__('mujoco')", "importlib.import_module('mujoco')"):
        sneaky.write_text(line)
        with pytest.raises(AssertionError):
            imports_of(sneaky)
