"""``trocar export``: which trials are exported, what is said about the others, where files go."""

import csv
import json
from dataclasses import replace

import pytest

from synthetic import config, keep, synthetic_trial
from trocar.eval.folder import open_folder
from trocar.eval.trial import trial_file

RUN = config(trials=3)


def short(trial):
    return replace(trial, arrays={name: array[:20] for name, array in trial.arrays.items() if len(array) > 4})


@pytest.fixture
def run(tmp_path):
    """A run of three trials of which one is there, one is of another run, and one is damaged."""
    folder = tmp_path / "run"
    open_folder(RUN, folder)
    whole = keep(short(synthetic_trial(RUN, 0)), folder)
    keep(short(synthetic_trial(config(seed=5), 1)), folder)
    trial_file(folder, 0, 2).write_bytes(whole.read_bytes()[:500])
    return folder


def test_only_the_runs_own_trials_are_exported_and_strangers_are_named(trocar, run, tmp_path):
    code, out, err = trocar("export", run, "--out", tmp_path / "tables", "--json")
    assert code == 0
    said = json.loads(out)
    assert said["trials"] == 1 and said["tables"]["goals.csv"]["rows"] == 12
    assert "samples/session_00_trial_000.csv" in said["tables"]
    assert [path.name for path in (tmp_path / "tables" / "samples").iterdir()] == ["session_00_trial_000.csv"]
    assert "trial_001.npz' is of another run" in err and "trial_002.npz' is not a readable" in err
    assert "1 of the run's 3 trials exist" in err
    assert len(said["left_aside"]) == 3


def test_one_file_is_exported_unless_it_is_a_stranger_where_it_lies(trocar, run, tmp_path):
    code, out, _ = trocar("export", trial_file(run, 0, 0), "--out", tmp_path / "tables")
    assert code == 0
    assert f"{tmp_path / 'tables' / 'goals.csv'}: 12 rows of 14 columns" in out
    code, _, err = trocar("export", trial_file(run, 0, 1), "--out", tmp_path / "more")
    assert code == 2 and "belongs to another run than its folder" in err
    moved = trial_file(run, 0, 0).rename(run / "session_00" / "trial_007.npz")
    code, _, err = trocar("export", moved, "--out", tmp_path / "more")
    assert code == 2 and "is session 0, trial 0 under another name" in err
    elsewhere = trial_file(run, 0, 1).rename(tmp_path / "trial.npz")
    assert trocar("export", elsewhere, "--out", tmp_path / "more")[0] == 0


def test_tables_of_ones_own_are_written_again_and_those_of_others_are_not(trocar, run, tmp_path):
    words = ("export", run, "--out", tmp_path / "tables")
    assert trocar(*words)[0] == trocar(*words)[0] == 0
    (tmp_path / "tables" / "goals.csv").write_text("my,own\n1,2\n")
    code, _, err = trocar(*words)
    assert code == 2 and "goals.csv' already exists" in err
    with (tmp_path / "tables" / "goals.csv").open() as file:
        assert next(csv.reader(file)) == ["my", "own"]


def test_a_trial_becomes_a_recording_of_messages(trocar, run, tmp_path):
    code, out, err = trocar("export", run, "--out", tmp_path / "mcap", "--format", "mcap", "--json")
    assert code == 0 and "1 of the run's 3 trials exist" in err
    said = json.loads(out)
    assert said["trials"] == 1 and len(said["left_aside"]) == 3
    assert said["files"]["session_00_trial_000.mcap"]["/PSM1/measured_js"] == 20
    assert [path.name for path in (tmp_path / "mcap").iterdir()] == ["session_00_trial_000.mcap"]
    code, out, _ = trocar("recording", "show", tmp_path / "mcap" / "session_00_trial_000.mcap")
    assert code == 0 and "arms with commands and measurements: /PSM1, /PSM2" in out


def test_a_data_set_for_learning_is_written_with_the_layout_that_is_asked_for(trocar, run, tmp_path):
    code, out, err = trocar("export", run, "--format", "lerobot", "--out", tmp_path / "a", "--json")
    said = json.loads(out)
    assert code == 0 and (said["episodes"], said["frames"], said["layout"]) == (1, 6, "lerobot")
    assert len(said["left_aside"]) == 3 and "trial_001.npz' is of another run" in err
    assert not [name for name in said["features"] if "truth" in name]
    words = ("export", run, "--format", "lerobot", "--layout", "open-h", "--truth", "--commanded")
    code, out, _ = trocar(*words, "--out", tmp_path / "b")
    assert code == 0 and f"{tmp_path / 'b'}: 1 episode, 6 frames, layout open-h" in out
    info = json.loads((tmp_path / "b" / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v2.1" and "truth.joints" in info["features"]
    listed = json.loads((tmp_path / "b" / "meta" / "episodes.jsonl").read_text())
    assert listed["commanded"] is True and listed["success"] is True
