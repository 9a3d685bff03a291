"""Which runs a shelf finds, what it says of each, and what it reads again."""

import json
import shutil
from dataclasses import replace

import pytest

from browsed import made_run
from synthetic import config, keep, synthetic_trial
from trocar.errors import BadFile, InvalidInput
from trocar.eval.folder import load_trials
from trocar.eval.trial import Trial, trial_file
from trocar.report.browse.all_runs import PROPERTIES, all_runs_page
from trocar.report.browse.shelf import KEYS, Shelf
from trocar.report.summary import summarise


@pytest.fixture(scope="module")
def runs(folder):
    return {run.name: run for run in Shelf([folder]).runs()}


@pytest.fixture
def read(monkeypatch):
    """The files whose headers are read; whole trials must not be."""
    files, load = [], Trial.load_noted
    monkeypatch.setattr(Trial, "load_noted", staticmethod(lambda file: files.append(file) or load(file)))
    monkeypatch.setattr(Trial, "load", lambda file: pytest.fail(f"{file} was read whole"))
    return files


def test_every_run_is_found_by_its_folder_below_the_one_that_was_given(runs, folder):
    assert list(runs) == ["begun", "day/bad", "day/good", "lost", "other", "torn", "unfinished"]
    assert runs["day/good"].folder == folder / "day" / "good"
    assert [run.name for run in Shelf([folder / "other"]).runs()] == ["other"]
    several = Shelf([folder / "day", folder / "other", folder / "day" / "good"]).runs()
    assert [run.name for run in several] == ["day/bad", "day/good", "other"]


def test_figures_are_those_of_the_summary(runs, folder):
    for name in ("day/good", "day/bad", "other"):
        summary = summarise(load_trials(folder / name)[0])
        assert runs[name].figures == {key: summary[key] for key in KEYS}
        assert runs[name].remarks == []
    row = runs["day/bad"].row()
    assert json.loads(json.dumps(row)) == row
    assert (row["sessions"], row["trials"], row["succeeded"], row["attempted"]) == (3, 3, 24, 36)
    assert (row["method"], row["difficulty"], row["version"]) == (
        "uncalibrated",
        "mild",
        config().about()["versions"]["trocar"],
    )


@pytest.mark.parametrize(
    ("name", "trials", "words"),
    [
        ("unfinished", 1, "1 of the run's 2 trials exist"),
        ("torn", 1, "is not a readable trocar trial"),
        ("begun", 0, "no trial is finished yet"),
        ("lost", 0, "run.json cannot be read"),
    ],
)
def test_a_run_that_is_not_whole_is_there_and_says_why(runs, name, trials, words):
    run = runs[name]
    assert len(run.trials) == trials
    assert any(words in said for said in run.remarks)
    assert run.row()["attempted"] == (12 if trials else None)


def test_trials_that_cannot_be_summed_up_do_not_stop_the_others(tmp_path):
    made_run(tmp_path / "odd")
    made_run(tmp_path / "other")
    path = trial_file(tmp_path / "odd", 0, 0)
    replace(Trial.load(path), command_limit_use={}).save(path)
    odd, other = Shelf([tmp_path]).runs()
    assert "cannot be summed up" in odd.remarks[0] and odd.trials == () and odd.about["task"] == "peg-transfer"
    assert other.figures


@pytest.mark.parametrize("record", [{"task": 5, "difficulty": 3, "versions": "1.0"}, {"id": "abc"}])
def test_another_program_s_run_json_does_not_stop_the_others(tmp_path, record):
    made_run(tmp_path / "ours")
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "run.json").write_text(json.dumps(record))
    ours, theirs = Shelf([tmp_path]).runs()
    assert ours.figures and theirs.remarks == ["run.json is not the record of a run, and no trial beside it"]
    assert theirs.row()["difficulty"] is theirs.row()["version"] is theirs.row()["task"] is None
    for by in PROPERTIES:
        assert "theirs" in all_runs_page([ours, theirs], [tmp_path], by, down=True)


def test_headers_alone_are_read_and_only_of_what_has_changed(folder, tmp_path, read):
    shutil.copytree(folder, tmp_path / "lab")
    shelf, ticks = Shelf([tmp_path / "lab"]), []
    shelf.runs(lambda work, done, total, now="": ticks.append((done, total)))
    assert len(read) == len(set(read)) == 13
    assert ticks == [(k, 13) for k in range(13)]
    assert all(not trial.arrays and not trial.spans for run in shelf.runs() for trial in run.trials)
    assert len(read) == 13

    path = keep(synthetic_trial(config(sessions=2, seed=9), session=1), tmp_path / "lab" / "unfinished")
    changed = trial_file(tmp_path / "lab" / "other", 0, 1)
    changed.unlink()
    replace(synthetic_trial(config(sessions=2, trials=2, seed=8), 1), duration_s=50.0).save(changed)
    shutil.rmtree(tmp_path / "lab" / "torn")
    made_run(tmp_path / "lab" / "new", seed=12)
    found = {one.name: one for one in shelf.runs()}
    new = trial_file(tmp_path / "lab" / "new", 0, 0)
    assert sorted(read[13:]) == sorted([changed, path, new])
    assert len(found["unfinished"].trials) == 2 and found["unfinished"].remarks == []
    assert found["other"].trials[1].duration_s == 50.0
    assert "torn" not in found and "new" in found


def test_a_trial_s_notes_are_those_of_the_whole_trial(folder):
    path = trial_file(folder / "day" / "good", 1, 0)
    whole, header = Trial.load(path).noted(), Trial.load_noted(path)
    for name in ("about", "scores", "spans", "events", "collisions", "ended", "duration_s", "computations", "wall_s"):
        assert getattr(header, name) == getattr(whole, name), name
    assert header.scenery.values() == whole.scenery.values()
    assert header.arrays == {} and header.images == {}


def test_the_trials_of_a_run_are_its_own(runs):
    assert runs["day/good"].trial(1, 0).is_file()
    with pytest.raises(InvalidInput, match="has no trial 3 of session 0"):
        runs["day/good"].trial(0, 3)
    with pytest.raises(InvalidInput, match="has no trial 0 of session 0"):
        runs["torn"].trial(0, 0)


def test_a_folder_that_is_not_there_is_one_sentence(folder):
    with pytest.raises(BadFile, match="does not exist; give a folder that holds runs"):
        Shelf([folder / "nowhere"])
    with pytest.raises(BadFile, match="is a file"):
        Shelf([folder / "lost" / "run.json"])
