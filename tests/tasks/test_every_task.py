"""What every registered task must have and do."""

import json
import math
from contextlib import ExitStack
from dataclasses import fields

import pytest
from typer.testing import CliRunner

from pages import assert_fit_to_show
from synthetic import unmarked
from trocar.cell import Outcome
from trocar.cli import app
from trocar.errors import TrocarError
from trocar.eval import TASKS, TaskReport, in_words, methods_of, perceptions_of, pick_method
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.trial import Trial
from trocar.report import files as files_of_a_report
from trocar.report.files import report_of, write_report
from trocar.testing import task as checks

EVERY_TASK = pytest.mark.parametrize("name", TASKS)
CHECKS = (
    checks.check_description,
    checks.check_methods,
    checks.check_station_of,
    checks.check_scene,
    checks.check_world,
    checks.check_score,
)


@EVERY_TASK
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_it_does_what_outsiders_are_told_that_a_task_does(check, name):
    """What is left of `check_task`, a trial in which nothing is done, is looked at more closely below."""
    check(TASKS[name])


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
def test_its_options_have_one_line_of_help_and_a_budget_above_zero(name):
    assert all(field.metadata["help"].endswith(".") for field in fields(TASKS[name]))
    for budget_s in (-1.0, 0.0, math.inf, math.nan):
        with pytest.raises(TrocarError, match=f"budget of a trial is {budget_s} s; give a finite time.*--budget"):
            TASKS[name](budget_s=budget_s)


@EVERY_TASK
def test_its_settings_have_units_in_their_names(name):
    for method in methods_of(TASKS[name]):
        for field, value in vars(pick_method(TASKS[name], method).make_settings()).items():
            if isinstance(value, float):
                assert field.endswith(("_s", "_m", "_rad", "_m_s", "_n", "_share")), f"{field} has no unit"


# What comes of doing nothing.


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A trial of each task in which nothing was done, by a method from outside."""
    found = {}
    with ExitStack() as registered:
        for name, kind in TASKS.items():
            config = RunConfig(kind(), method=registered.enter_context(checks.idle_method(kind)), seed=5)
            folder = tmp_path_factory.mktemp(name)
            found[name] = run_trial(config, prepare(config, 0, folder), 0), folder
        yield found


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
def test_its_report_can_be_made_of_a_trial_in_which_nothing_was_done(name, idle, monkeypatch):
    trial, folder = idle[name]
    report = report_of(trial)
    assert isinstance(report, TaskReport)
    monkeypatch.setattr(files_of_a_report, "MOST_FAILED", 1)
    summary, files = write_report(folder, [trial])
    assert (summary["succeeded"], summary["attempted"]) == (0, len(trial.scores))
    loaded = Trial.load(trial.save(folder / "kept.npz"))
    assert (loaded.scores, loaded.about) == (json.loads(json.dumps(trial.scores)), trial.about)
    assert set(loaded.arrays) == set(trial.arrays)
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
