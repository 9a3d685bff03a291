"""A trial's file: what comes back, what is refused, what is never half-written."""

import json

import numpy as np
import pytest

from synthetic import synthetic_trial
from trocar.errors import TrocarError
from trocar.trials import Plan, Trial, trial_file
from trocar.trials import trial as module
from trocar.trials.trial import timing_file

PLAN = Plan()


@pytest.fixture
def path(tmp_path):
    return trial_file(tmp_path, 7)


def test_the_files_of_a_run_sort_by_number(tmp_path):
    names = [trial_file(tmp_path, k).name for k in range(120)]
    assert names == sorted(names) and len(set(names)) == 120
    assert trial_file(tmp_path, 0).name == "trial_000.npz"


def test_what_was_saved_comes_back(path):
    trial = synthetic_trial(PLAN, 7, {3: "DROPPED"})
    trial.save(path)
    loaded = Trial.load(path)
    for name in ("about", "transfers", "spans", "events", "collisions", "finished", "duration_s", "captions"):
        assert getattr(loaded, name) == getattr(trial, name), name
    assert loaded.computations == trial.computations
    assert loaded.wall_s == trial.wall_s
    assert set(loaded.arrays) == set(trial.arrays)
    for key, array in trial.arrays.items():
        assert loaded.arrays[key].dtype == array.dtype
        assert np.array_equal(loaded.arrays[key], array)


def test_the_machines_speed_is_not_in_the_trial(path, tmp_path):
    fast, slow = synthetic_trial(PLAN), synthetic_trial(PLAN)
    object.__setattr__(slow, "wall_s", 99.0)
    slow.computations.clear()
    fast.save(path)
    slow.save(other := trial_file(tmp_path, 8))
    assert path.read_bytes() == other.read_bytes()
    assert timing_file(path).read_bytes() != timing_file(other).read_bytes()


def test_nothing_but_the_trial_is_left_in_the_folder(path, tmp_path):
    synthetic_trial(PLAN).save(path)
    assert {p.name for p in tmp_path.iterdir()} == {path.name, timing_file(path).name}


@pytest.mark.parametrize("kept", [0, 1, 100, 2000])
def test_a_truncated_file_is_named_in_one_sentence(path, kept):
    synthetic_trial(PLAN).save(path)
    path.write_bytes(path.read_bytes()[:kept])
    assert_refused(path, "not a readable trial")


def test_a_damaged_file_is_named_in_one_sentence(path):
    synthetic_trial(PLAN).save(path)
    content = bytearray(path.read_bytes())
    content[200:260] = bytes(60)
    path.write_bytes(content)
    assert_refused(path, "not a readable trial")


def test_foreign_files_are_named_in_one_sentence(path):
    timing_file(path).write_text("{}")
    path.write_text("not a trial at all")
    assert_refused(path, "not a readable trial")
    with path.open("wb") as file:
        np.savez(file, x=np.zeros(3))
    assert_refused(path, "not a readable trial")
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    assert_refused(path, "not a readable trial")
    with path.open("wb") as file:
        np.savez(file, log=np.array([{"pickled": True}], dtype=object))
    assert_refused(path, "not a readable trial")


@pytest.mark.parametrize(("name", "value"), [("FORMAT", "another's trial"), ("VERSION", 99)])
def test_another_format_or_version_says_so(path, monkeypatch, name, value):
    monkeypatch.setattr(module, name, value)
    synthetic_trial(PLAN).save(path)
    monkeypatch.undo()
    assert_refused(path, str(value))


def test_a_log_without_its_fields_is_no_trial(path):
    timing_file(path).write_text(json.dumps({"wall_s": 1.0, "computations": []}))
    log = json.dumps({"format": module.FORMAT, "version": module.VERSION}).encode()
    with path.open("wb") as file:
        np.savez(file, log=np.frombuffer(log, dtype=np.uint8))
    assert_refused(path, "not a readable trial")


def test_broken_times_are_named(path):
    synthetic_trial(PLAN).save(path)
    timing_file(path).write_text('{"wall_s": 1.0, "compu')
    assert_refused(path, "not a readable trial")
    timing_file(path).write_text("{}")
    assert_refused(path, "not a readable trial")


def test_missing_files_are_named(path):
    assert_refused(path, "does not exist")
    synthetic_trial(PLAN).save(path)
    timing_file(path).unlink()
    assert_refused(timing_file(path), "does not exist", load=path)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(TrocarError, match="cannot write trial"):
        synthetic_trial(PLAN).save(tmp_path / "no such folder" / "trial_000.npz")


def assert_refused(named, words, load=None):
    with pytest.raises(TrocarError, match=words) as caught:
        Trial.load(load or named)
    assert str(named) in str(caught.value)
    assert "\n" not in str(caught.value)
