"""What every registered task must have and do."""

import json
import re
from dataclasses import MISSING, asdict, dataclass, fields, is_dataclass

import numpy as np
import pytest
from typer.testing import CliRunner

from pages import assert_fit_to_show
from simulated import ideal_session
from synthetic import unmarked
from trocar.arms import limit_violations
from trocar.cell import Outcome
from trocar.cli import app
from trocar.errors import TrocarError
from trocar.eval import (
    TASKS,
    Method,
    Task,
    TaskReport,
    in_words,
    methods_of,
    perceptions_of,
    pick_method,
    pick_perception,
)
from trocar.eval.config import RunConfig
from trocar.eval.method import METHODS
from trocar.eval.run import prepare, run_trial
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.lab import SensorFlaws, check_station, load_station
from trocar.motion import PLANNERS
from trocar.report import files as files_of_a_report
from trocar.report.files import report_of, write_report
from trocar.sim.laboratory import SimLaboratory

EVERY_TASK = pytest.mark.parametrize("name", TASKS)
PLAIN = (bool, int, float, str, type(None))


def station_of(task):
    return task.at(load_station(task.station))


def laboratory_of(name, seed=3):
    task = TASKS[name]()
    station = station_of(task)
    world = task.world(task.scene(np.random.default_rng(seed), station))
    lab = SimLaboratory(ideal_session(station), world, np.random.default_rng(seed), flaws=SensorFlaws.none())
    return task, lab


def values(thing):
    """Return a thing as nested plain values, to be compared."""
    if isinstance(thing, SE3 | np.ndarray):
        return np.asarray(getattr(thing, "matrix", thing)).tolist()
    if is_dataclass(thing):
        return {field.name: values(getattr(thing, field.name)) for field in fields(thing)}
    if isinstance(thing, dict):
        return {key: values(value) for key, value in thing.items()}
    return [values(item) for item in thing] if isinstance(thing, tuple | list) else thing


# What it says of itself.


@EVERY_TASK
def test_it_says_what_it_is(name):
    task = TASKS[name]
    assert issubclass(task, Task) and task.name == name
    assert re.fullmatch(r"[a-z][a-z0-9-]*", name)
    for text in (task.about, task.goal_noun, *(pick_method(task, method).about for method in methods_of(task))):
        assert text.strip() == text and "\n" not in text and not text.endswith(".")
    assert issubclass(type(task().variant), str)


@EVERY_TASK
def test_each_of_its_options_can_be_offered_on_a_command_line(name):
    flags = []
    for field in fields(TASKS[name]):
        about = field.metadata
        assert about["help"].endswith("."), field.name
        assert field.default is not MISSING, "an option that has to be given is an argument"
        assert field.default is None or isinstance(field.default, PLAIN)
        if about["choices"] and field.default is not None:
            assert field.default in about["choices"]
        flags.append((about["flag"] or field.name).replace("_", "-"))
    assert len(set(flags)) == len(flags)
    assert not set(flags) & {"method", "seed", "trials", "sessions", "station", "out", "json", "plugin", "help"}


@EVERY_TASK
def test_its_help_names_methods_perceptions_options_and_an_example(name):
    result = CliRunner().invoke(app, ["run", name, "--help"], env={"COLUMNS": "200", "TERM": "dumb"})
    assert result.exit_code == 0, result.output
    text = " ".join(result.stdout.split())
    task = TASKS[name]
    for field in fields(task):
        assert f"--{(field.metadata['flag'] or field.name).replace('_', '-')}" in text
    for word in (*methods_of(task), *perceptions_of(task), f"trocar run {name}"):
        assert word in text
    for method in methods_of(task):
        assert pick_method(task, method).about in text


@EVERY_TASK
def test_what_it_is_told_is_json_and_tells_runs_apart(name):
    task = TASKS[name]()
    options = json.loads(json.dumps(task.options(), allow_nan=False))
    assert set(options) == {field.name for field in fields(task)}
    assert TASKS[name]().options() == options
    longer = TASKS[name](budget_s=task.budget_s + 1.0)
    assert longer.options() != options
    prints = {RunConfig(t).fingerprint for t in (task, longer, TASKS[name]())}
    assert len(prints) == 2
    with pytest.raises(TrocarError, match="budget of a trial is -1"):
        TASKS[name](budget_s=-1.0)


@EVERY_TASK
def test_its_methods_can_be_picked_and_have_settings_with_units(name):
    task = TASKS[name]
    assert task.methods and pick_method(task, "") is pick_method(task, next(iter(task.methods)))
    for method in methods_of(task):
        chosen = pick_method(task, method)
        settings = chosen.make_settings()
        json.dumps({k: v for k, v in vars(settings).items() if isinstance(v, PLAIN)}, allow_nan=False)
        for field, value in vars(settings).items():
            if isinstance(value, float):
                assert field.endswith(("_s", "_m", "_rad", "_m_s", "_n", "_share")), f"{field} has no unit"
        assert chosen.planner in PLANNERS
        if chosen.perception:
            assert pick_perception(task, chosen.perception) is not pick_perception(task, chosen.perception)


@EVERY_TASK
def test_its_station_is_there_and_makes_sense_with_the_task_in_it(name):
    task = TASKS[name]()
    station = station_of(task)
    assert check_station(load_station(task.station)) == []
    assert check_station(station) == []
    again = task.at(station)
    assert values(dict(again.T_world_fixture)) == values(dict(station.T_world_fixture))
    for arm in station.arms:
        assert values(again.arms[arm].T_world_base) == values(station.arms[arm].T_world_base)
    arms = task.working_arms(station)
    assert arms and set(arms) <= set(station.arms) and len(set(arms)) == len(arms)


@EVERY_TASK
def test_its_calibrations_move_within_the_joints_ranges(name):
    task = TASKS[name]()
    station = station_of(task)
    for arm in task.working_arms(station):
        box = task.calibration(station, arm)
        assert (box.lower < box.upper).all()
        assert limit_violations(station.arms[arm].model, np.array([box.lower, box.upper])) == []


# What lies on the table.


@EVERY_TASK
def test_its_goals_are_the_same_for_everybody(name):
    first, second = TASKS[name](), TASKS[name]()
    assert len(first.goals()) > 0
    assert tuple(first.goals()) == tuple(first.goals()) == tuple(second.goals())
    assert values(first.nominal()) == values(second.nominal())


@EVERY_TASK
def test_a_scene_depends_on_its_generator_alone(name):
    task = TASKS[name]()
    station = station_of(task)
    first = values(task.scene(np.random.default_rng(7), station))
    np.random.seed(0)  # noqa: NPY002 (what nobody may use)
    task.scene(np.random.default_rng(8), station)
    assert values(TASKS[name]().scene(np.random.default_rng(7), station)) == first
    rngs = [np.random.default_rng(7) for _ in range(2)]
    for rng in rngs:
        task.scene(rng, station)
    assert rngs[0].integers(2**62) == rngs[1].integers(2**62)


@EVERY_TASK
def test_its_world_settles_and_nothing_stirs_or_collides(name):
    _, lab = laboratory_of(name)
    assert lab.run(lambda cell: cell.clock.sleep(1.0), 5.0)
    record = lab.record()
    assert record.collisions == ()
    assert record.T_world_body, "there is nothing in it"
    for body, T in record.T_world_body.items():
        assert np.ptp(T.translation_m, axis=0).max() < 0.2e-3, body
        assert np.abs(T.matrix[-1] - T.matrix[0]).max() < 0.01, body
    depth = lab.world.data.contact.dist[: lab.world.data.ncon]
    assert depth.min(initial=0.0) > -0.2e-3, "something sticks in something else"


@EVERY_TASK
def test_the_same_scene_is_the_same_world(name):
    first, second = (laboratory_of(name)[1].world for _ in range(2))
    assert np.array_equal(first.data.qpos, second.data.qpos)
    assert first.model.ngeom == second.model.ngeom


# What comes of doing nothing.


@dataclass(frozen=True)
class Idle:
    """Settings of nobody."""

    wait_s: float = 0.5


class Idler:
    """An agent that waits."""

    def __init__(self, context):
        self.context = context

    async def run(self):
        await self.context.cell.clock.sleep(self.context.settings.wait_s)


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A trial of each task in which nothing was done, by a method from outside."""
    found = {}
    for name in TASKS:
        perception = next(iter(TASKS[name].perceptions), "")
        METHODS.register(f"{name}/idle", Method("nothing at all", Idler, Idle, perception=perception))
        config = RunConfig(TASKS[name](), method="idle", seed=5)
        folder = tmp_path_factory.mktemp(name)
        found[name] = run_trial(config, prepare(config, 0, folder), 0), folder
    yield found
    for name in TASKS:
        METHODS.forget(f"{name}/idle")


@EVERY_TASK
def test_who_does_nothing_has_tried_everything_and_done_nothing(name, idle):
    trial, _ = idle[name]
    assert trial.finished and trial.duration_s == pytest.approx(0.5, abs=0.011)
    assert len(trial.scores) == len(TASKS[name]().goals())
    outcomes = {member.name for kind in Outcome.__subclasses__() for member in kind}
    for score in trial.scores:
        assert score["attempted"] is True and score["succeeded"] is False
        assert score["failure"] in outcomes - {"DONE"} and score["reason"]
        assert 0.0 <= score["start_s"] <= score["end_s"] <= trial.duration_s
    json.dumps(trial.scores, allow_nan=False)


@EVERY_TASK
def test_what_an_agent_claims_changes_nothing(name):
    """Not even that it is done, or that it was stopped."""
    task, lab = laboratory_of(name)
    assert lab.run(lambda cell: cell.clock.sleep(0.2), 5.0)
    stopped = {"name": "stopped", "time_s": 0.2, "outcome": "DONE"}
    claims = [{"name": task.goal_noun, "time_s": 0.1, "outcome": "DONE"}, stopped]
    for events in ([], claims[:1], claims):
        scores = task.score(lab.truth(), events)
        assert len(scores) == len(task.goals())
        assert all(score.attempted and not score.succeeded for score in scores)
        json.dumps([asdict(score) for score in scores], allow_nan=False)


@EVERY_TASK
def test_a_trial_can_be_kept_and_comes_back(name, idle, tmp_path):
    trial, _ = idle[name]
    loaded = Trial.load(trial.save(tmp_path / "trial.npz"))
    assert loaded.scores == json.loads(json.dumps(trial.scores))
    assert loaded.about == trial.about
    assert set(loaded.arrays) == set(trial.arrays)


@EVERY_TASK
def test_its_report_can_be_made_of_a_trial_in_which_nothing_was_done(name, idle, monkeypatch):
    trial, folder = idle[name]
    report = report_of(trial)
    assert isinstance(report, TaskReport)
    monkeypatch.setattr(files_of_a_report, "MOST", 1)
    summary, files = write_report(folder, [trial])
    assert (summary["succeeded"], summary["attempted"]) == (0, len(trial.scores))
    assert unmarked(folder / "summary.json") == summary
    assert all(file.stat().st_size > 0 for file in files)
    assert [time_s for _, time_s in report.moments(trial)] == sorted(t for _, t in report.moments(trial))
    for row in report.paper_rows(summary):
        assert 0 <= row.succeeded <= row.attempted
    page = assert_fit_to_show(folder / "report.html")
    assert f"0 of {len(trial.scores)}" in page.text
    failed = [image for image in page.images if "_goal_" in image["title"]]
    assert len(failed) == 1 and (folder / "failed" / failed[0]["title"]).stat().st_size > 1000
    assert all(in_words(name) in page.text for name in summary["failures"])
    assert report.tables(summary) is not None and all(isinstance(note, str) for note in report.notes([trial]))
