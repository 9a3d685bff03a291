"""What every task has to do, from its options to the report of a trial in which nothing was done."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import MISSING, Field, asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trocar.arms import limit_violations
from trocar.errors import InvalidInput
from trocar.eval import TASKS, AgentContext, Method, Task, methods_of, perceptions_of, pick_method, pick_perception
from trocar.eval.config import RunConfig
from trocar.eval.method import METHODS
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.staged import draw_world
from trocar.eval.task import flag_of
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.lab import SensorFlaws, Station, check_station, load_station
from trocar.lab.session import draw_session
from trocar.motion import PLANNERS
from trocar.report.files import write_report
from trocar.sim.laboratory import SimLaboratory
from trocar.testing.requirement import require

PLAIN = (bool, int, float, str, type(None))
RESERVED = {
    *("out", "jobs", "strict", "raise", "cache", "enable-motion", "yes", "policy", "watch", "confirm", "speed"),
    *("devices", "plugin", "json", "quiet", "help", "config"),
    *("methods", "backend", "scheduler", "report-only", "episodes", "failures", "layout"),  # of studies
}
"""Options of every task's command besides those of ``RunConfig``."""
IDLE_S = 0.5


def check_task(kind: type[Task] | str) -> None:
    """Check a task: names, options, methods, station, scenes, world, score, trial and report; a few seconds.

    Args:
        kind: the class, or its registered name.

    Raises:
        CheckFailed: the task breaks a requirement; the message says which.
    """
    kind = TASKS.pick(kind) if isinstance(kind, str) else kind
    for check in (
        check_description,
        check_methods,
        check_station_of,
        check_scene,
        check_world,
        check_score,
        check_trial,
    ):
        check(kind)


def check_description(kind: type[Task]) -> None:
    """Check a task's names and its options, which the command line offers and which distinguish runs."""
    subject = _subject(kind)
    require(
        re.fullmatch(r"[a-z][a-z0-9-]*", kind.name), subject, "have a name of lower-case letters, digits and dashes"
    )
    texts = [kind.about, kind.goal_noun, *(pick_method(kind, method).about for method in methods_of(kind))]
    plain = all(text and text.strip() == text and "\n" not in text and not text.endswith(".") for text in texts)
    require(plain, subject, "say of itself and its methods what they are in one line without a full stop")
    flags = [flag_of(field).removeprefix("--") for field in _options(kind)]
    for field in _options(kind):
        plain = field.default is not MISSING and isinstance(field.default, PLAIN)
        require(plain, subject, f"have a plain default for its option {field.name}")
        choices = field.metadata.get("choices") or ()
        among = not choices or field.default is None or field.default in choices
        require(among, subject, f"have a default for {field.name} that is among its choices")
    of_run = {flag_of(field).removeprefix("--") for field in fields(RunConfig) if field.metadata}
    taken = (RESERVED | of_run) & set(flags)
    require(len(set(flags)) == len(flags) and not taken, subject, f"have options of its own, not {sorted(taken)}")
    task = kind()
    options = json.loads(json.dumps(task.options(), allow_nan=False))
    require(set(options) == {field.name for field in _options(kind)}, subject, "tell all its options")
    longer = kind(budget_s=task.budget_s + 1.0)  # type: ignore[call-arg]
    apart = RunConfig(longer).fingerprint != RunConfig(task).fingerprint == RunConfig(kind()).fingerprint
    require(apart, subject, "be told apart by its options")


def check_methods(kind: type[Task]) -> None:
    """Check that a task's methods can be picked, and that their settings and parts exist."""
    subject = _subject(kind)
    for name in methods_of(kind):
        method = pick_method(kind, name)
        settings = vars(method.make_settings()) if method.make_settings() is not None else {}
        json.dumps({key: value for key, value in settings.items() if isinstance(value, PLAIN)}, allow_nan=False)
        require(method.planner in PLANNERS, subject, f"name a planner for {name!r} that exists, not {method.planner!r}")
        if method.perception:
            fresh = pick_perception(kind, method.perception) is not pick_perception(kind, method.perception)
            require(fresh, subject, f"make a new perception {method.perception!r} for each trial")


def check_station_of(kind: type[Task]) -> None:
    """Check that the station makes sense with the task in it, and where its arms are calibrated."""
    subject, task = _subject(kind), kind()
    station = _station_of(task)
    for place in (load_station(task.station), station):
        problems = check_station(place)
        require(not problems, subject, f"be done at a station that is in order: {problems}")
    again = task.at(station)
    same = _values(dict(again.T_world_fixture)) == _values(dict(station.T_world_fixture))
    require(same, subject, "change nothing more when it is put into its own station again")
    arms = task.working_arms(station)
    there = arms and set(arms) <= set(station.arms) and len(set(arms)) == len(arms)
    require(there, subject, f"work with arms of its station, not {arms}")
    for arm in arms:
        try:
            box = task.calibration(station, arm)
        except InvalidInput:
            continue  # a task whose methods calibrate nothing needs no box for it
        inside = not limit_violations(station.arms[arm].model, np.array([box.lower, box.upper]))
        require(inside and (box.lower < box.upper).all(), subject, f"calibrate {arm!r} within its joints' ranges")


def check_scene(kind: type[Task]) -> None:
    """Check that goals are the same for everybody, and that a scene depends on its generator alone."""
    subject, first, second = _subject(kind), kind(), kind()
    goals = [tuple(task.goals()) for task in (first, first, second)]
    require(goals[0] and goals[0] == goals[1] == goals[2], subject, "have the same goals every time, at least one")
    require(_values(first.nominal()) == _values(second.nominal()), subject, "know the same beforehand every time")
    station = _station_of(first)
    rng, other = np.random.default_rng(7), np.random.default_rng(7)
    scene = _values(first.scene(rng, station))
    first.scene(np.random.default_rng(8), station)
    require(_values(second.scene(other, station)) == scene, subject, "draw its scene from the generator alone")
    require(rng.integers(2**62) == other.integers(2**62), subject, "draw the same numbers for a scene every time")


def check_world(kind: type[Task]) -> None:
    """Check that one scene always gives the same world, in which nothing moves or collides by itself."""
    subject = _subject(kind)
    first, second = (_laboratory(kind) for _ in range(2))
    same = np.array_equal(first.world.data.qpos, second.world.data.qpos)
    require(same and first.world.model.ngeom == second.world.model.ngeom, subject, "build one world from one scene")
    require(first.run(lambda cell: cell.clock.sleep(1.0), 5.0), subject, "have a world that can be run")
    record = first.record()
    require(not record.collisions, subject, f"have no collisions while nothing moves: {record.collisions}")
    for body, T in record.T_world_body.items():
        moved_m = float(np.ptp(T.translation_m, axis=0).max())
        turned = float(np.abs(T.matrix[-1] - T.matrix[0]).max())
        still = moved_m < 0.2e-3 and turned < 0.01
        require(still, subject, f"let its bodies rest; {body!r} moves by {1e3 * moved_m:.2f} mm in a second")
    depth_m = float(first.world.data.contact.dist[: first.world.data.ncon].min(initial=0.0))
    require(depth_m > -0.2e-3, subject, f"place its bodies apart; one sticks {-1e3 * depth_m:.2f} mm in another")


def check_score(kind: type[Task]) -> None:
    """Check that an agent that does nothing scores nothing, whatever it claims."""
    subject, task, laboratory = _subject(kind), kind(), _laboratory(kind)
    laboratory.run(lambda cell: cell.clock.sleep(0.2), 5.0)
    claims = [
        {"name": task.goal_noun, "time_s": 0.1, "outcome": "DONE"},
        {"name": "stopped", "time_s": 0.2, "outcome": "DONE"},
    ]
    for events in ([], claims[:1], claims):
        scores, wanted = task.score(laboratory.truth(), events), len(task.goals())
        require(len(scores) == wanted, subject, f"return one score for each goal, not {len(scores)} for {wanted}")
        for score in scores:
            json.dumps(asdict(score), allow_nan=False)
            missed = score.attempted and not score.succeeded and score.failure
            require(missed, subject, "count every goal as attempted and, where nothing was done, as failed, by a name")


def check_trial(kind: type[Task]) -> None:
    """Check a trial in which an agent does nothing: it is scored, saved, read back, and reported on."""
    subject = _subject(kind)
    with tempfile.TemporaryDirectory() as place, idle_method(kind) as method:
        folder = Path(place)
        config = RunConfig(kind(), method=method, seed=5)
        trial = run_trial(config, prepare(config, 0, folder), 0)
        require(trial.finished, subject, f"let a trial finish in which nothing is done; {trial.reason}")
        for score in trial.scores:
            ordered = 0.0 <= score["start_s"] <= score["end_s"] <= trial.duration_s
            require(ordered, subject, "score goals with times within the trial")
        loaded = Trial.load(trial.save(folder / "trial.npz"))
        kept = loaded.scores == json.loads(json.dumps(trial.scores)) and loaded.about == trial.about
        require(kept and set(loaded.arrays) == set(trial.arrays), subject, "have trials that can be read back")
        summary, files = write_report(folder / "report", [trial])
        counts = (summary["succeeded"], summary["attempted"])
        require(counts == (0, len(trial.scores)), subject, f"report 0 of {len(trial.scores)}, not {counts}")
        require(all(file.stat().st_size > 0 for file in files), subject, "write no empty file into its report")


@dataclass(frozen=True)
class IdleSettings:
    """Settings of an agent that does nothing."""

    wait_s: float = IDLE_S


class IdleAgent:
    """An agent that waits."""

    def __init__(self, context: AgentContext):
        self._context = context

    async def run(self) -> None:
        """Let half a second pass."""
        await self._context.cell.clock.sleep(self._context.settings.wait_s)


@contextmanager
def idle_method(kind: type[Task]) -> Iterator[str]:
    """Register a task's method that does nothing, and the task if it is not registered, for a while."""
    unregistered, name = kind.name not in TASKS, f"{kind.name}/idle"
    if unregistered:
        TASKS.register(kind.name, kind)
    perception = next(iter(perceptions_of(kind)), "")
    METHODS.register(name, Method("nothing at all", IdleAgent, IdleSettings, perception=perception))
    try:
        yield "idle"
    finally:
        METHODS.forget(name)
        if unregistered:
            TASKS.forget(kind.name)


def _options(kind: type[Task]) -> tuple[Field[Any], ...]:
    return fields(kind)  # type: ignore[arg-type]  # every task is a dataclass: see require_task


def _subject(kind: type[Task]) -> str:
    return f"task {kind.name!r}"


def _station_of(task: Task) -> Station:
    return task.at(load_station(task.station))


def _laboratory(kind: type[Task]) -> SimLaboratory:
    task = kind()
    station = _station_of(task)
    rng = np.random.default_rng(3)
    world = draw_world(task, rng, station)
    return SimLaboratory(draw_session(station, rng), world, rng, flaws=SensorFlaws.none())


def _values(thing: Any) -> Any:
    """Return an object as nested plain values, for comparison."""
    if isinstance(thing, SE3 | np.ndarray):
        return np.asarray(getattr(thing, "matrix", thing)).tolist()
    if is_dataclass(thing):
        return {field.name: _values(getattr(thing, field.name)) for field in fields(thing)}
    if isinstance(thing, dict):
        return {key: _values(value) for key, value in thing.items()}
    return [_values(item) for item in thing] if isinstance(thing, tuple | list) else thing
