"""A trial's file: read back, refused if invalid, never half-written."""

import zipfile

import numpy as np
import pytest

from synthetic import config, synthetic_trial
from trocar.errors import TrocarError
from trocar.eval import trial as module
from trocar.eval.trial import Trial, timing_file, trial_about, trial_file, trial_files
from trocar.files.archive import Archive, read_archive
from trocar.log import Computation

RUN = config()


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The bytes of a good trial's file."""
    return synthetic_trial(RUN, 7).save(tmp_path_factory.mktemp("saved") / "trial.npz").read_bytes()


@pytest.fixture
def path(tmp_path, saved):
    """A good trial's file, to be spoiled."""
    (tmp_path / "trial.npz").write_bytes(saved)
    return tmp_path / "trial.npz"


def changed(path, header=None, **arrays):
    """Rewrite a trial's file with another header, or with other arrays; None takes one out."""
    was = read_archive(path, module.FORMAT, module.VERSION)
    kept = {k: v for k, v in {**was.arrays, **arrays}.items() if v is not None}
    path.unlink()  # what is no trial is not replaced by one, nor the other way round
    Archive(was.header if header is None else header, kept, was.blobs).save(path)


def header_of(path):
    return read_archive(path, module.FORMAT, module.VERSION).header


def assert_refused(path, words):
    with pytest.raises(TrocarError, match=words) as caught:
        Trial.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


# What is kept.


def test_the_files_of_a_run_lie_by_session_and_sort_by_number(tmp_path):
    places = [(session, index) for session in (0, 1, 10) for index in (0, 2, 119)]
    for place in places:
        file = trial_file(tmp_path, *place)
        file.parent.mkdir(exist_ok=True)
        file.touch()
    assert trial_file(tmp_path, 1, 2) == tmp_path / "session_01" / "trial_002.npz"
    assert trial_files(tmp_path) == [trial_file(tmp_path, *place) for place in places]


def test_what_was_saved_comes_back(path):
    trial = synthetic_trial(RUN, 7, {3: "DROPPED"})
    trial.images["overhead_000.webp"] = b"an image"
    loaded = Trial.load(trial.save(path))
    for name in ("about", "scores", "spans", "events", "collisions", "ended", "reason", "duration_s", "images"):
        assert getattr(loaded, name) == getattr(trial, name), name
    assert loaded.command_limit_use == trial.command_limit_use
    assert loaded.computations == trial.computations
    assert (loaded.machine_speed, loaded.wall_s) == (trial.machine_speed, trial.wall_s) == (0.9, 10.0)
    assert loaded.scenery.values() == trial.scenery.values()
    assert set(loaded.arrays) == set(trial.arrays)
    for key, array in trial.arrays.items():
        assert loaded.arrays[key].dtype == array.dtype
        assert np.array_equal(loaded.arrays[key], array)


def test_numbers_of_numpy_lose_no_trial(path):
    trial, plainly = synthetic_trial(RUN, 7), synthetic_trial(RUN, 7)
    for one, kind in ((trial, np.float32), (plainly, float)):
        one.scores[0]["end_s"] = kind(2.5)
        one.about["settings"] = {"wait_s": kind(0.5), "sure": np.True_ if one is trial else True}
        one.computations[0] = Computation("planning", kind(0.25), kind(0.5))
    assert trial.save(path).read_bytes() == plainly.save(path.with_name("plain.npz")).read_bytes()
    loaded = Trial.load(path)
    assert loaded.scores == plainly.scores and loaded.about == plainly.about
    assert loaded.computations == plainly.computations


def test_the_speed_of_the_machine_is_not_in_the_trial(tmp_path):
    fast, slow = synthetic_trial(RUN), synthetic_trial(RUN)
    object.__setattr__(slow, "wall_s", 99.0)
    object.__setattr__(slow, "machine_speed", 0.1)
    slow.computations.clear()
    first, second = fast.save(tmp_path / "fast.npz"), slow.save(tmp_path / "slow.npz")
    assert first.read_bytes() == second.read_bytes()
    assert timing_file(first).read_bytes() != timing_file(second).read_bytes()
    assert len(list(tmp_path.iterdir())) == 4, "nothing but the trials and their times"


@pytest.mark.parametrize("content", [None, '{"wall_s": 1.0, "compu', "{}", "[]", '{"wall_s": 1, "computations": [3]}'])
def test_lost_times_are_no_loss_of_the_trial(path, content):
    if content is not None:
        timing_file(path).write_text(content)
    trial = Trial.load(path)
    assert (trial.computations, trial.machine_speed, trial.wall_s) == ([], 1.0, 0.0)
    assert len(trial.scores) == 12


def test_the_header_is_read_without_the_arrays(path):
    """Every byte of the arrays is spoiled, and what the file says of itself is still read."""
    with zipfile.ZipFile(path) as file:
        members = [member for member in file.infolist() if member.filename.endswith(".npy")]
    content = bytearray(path.read_bytes())
    for member in members:
        start = member.header_offset + 30 + len(member.filename)
        content[start : start + member.compress_size] = bytes(member.compress_size)
    path.write_bytes(content)
    about = trial_about(path)
    assert (about["index"], about["session"], about["fingerprint"]) == (7, 0, RUN.fingerprint)
    assert_refused(path, "is damaged at")


# What is refused.


def test_a_damaged_file_is_named(path, saved):
    content = bytearray(saved)
    content[len(saved) // 2 : len(saved) // 2 + 60] = bytes(60)
    path.write_bytes(content)
    assert_refused(path, "is damaged at")


def test_files_of_others_are_named(path):
    path.write_text("not a trial at all")
    assert_refused(path, "not a readable trocar trial")
    for save, what in ((np.savez, np.zeros(3)), (np.save, np.zeros(3)), (np.savez, np.array([{}], dtype=object))):
        with path.open("wb") as file:
            save(file, what)
        assert_refused(path, "is not a trocar trial|not a readable trocar trial")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", "trocar cable model", "is a 'trocar cable model' of version 3, not a 'trocar trial' of version 3"),
        ("version", 1, "of version 1, not"),
        ("version", 2, "of version 2, not"),
        ("version", "2", "is a"),
    ],
)
def test_another_format_or_version_says_so(path, key, value, words):
    changed(path, header_of(path) | {key: value})
    assert_refused(path, words)
    with pytest.raises(TrocarError, match="version"):
        trial_about(path)


KEYS = ("about", "scores", "spans", "events", "collisions", "ended", "reason", "duration_s", "command_limit_use")


ABOUT = ("fingerprint", "task", "goal_noun", "arms", "session", "index", "seed", "versions")


@pytest.mark.parametrize("keys", [*((key,) for key in (*KEYS, "scenery")), *(("about", key) for key in ABOUT)])
def test_a_header_without_one_of_its_keys_is_no_trial(path, keys):
    header = header_of(path)
    within = header if len(keys) == 1 else header[keys[0]]
    del within[keys[-1]]
    changed(path, header)
    assert_refused(path, "not a readable trocar trial; run that trial again")


@pytest.mark.parametrize("value", [None, 3, "words", [1, 2], [[1], [2]], {"a": 1}, {"a": [1, 2, 3]}], ids=str)
@pytest.mark.parametrize("key", ["about", "scores", "spans", "duration_s", "command_limit_use", "scenery"])
def test_a_header_with_something_else_under_a_key_is_no_trial(path, key, value):
    if key == "duration_s" and value == 3:
        return
    changed(path, header_of(path) | {key: value})
    assert_refused(path, "not a readable trocar trial; run that trial again")


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("T_world_base", {"psm1": [[1.0, 0.0], [0.0, 1.0]]}),
        ("T_world_body", {"world": "nowhere"}),
        ("arms", {"psm1": {"name": "half an arm"}}),
        ("solids", [{"body": "board"}]),
        ("tick_s", "fast"),
    ],
)
def test_a_scenery_that_is_none_is_no_trial(path, key, change):
    header = header_of(path)
    header["scenery"][key] = change
    changed(path, header)
    assert_refused(path, "is not a (readable )?trocar trial|is damaged")


@pytest.mark.parametrize("name", ["desired_psm1", "commanded_psm1", "measured_psm2", "true_psm2", "body_block0"])
def test_arrays_that_are_not_what_they_are_called_are_named(path, name):
    trial = Trial.load(path)
    for array in (trial.arrays[name][:-1], trial.arrays[name][:, :6], trial.arrays[name].ravel()):
        changed(path, **{name: array})
        assert_refused(path, r"damaged: '\w+_\w+' has shape .*, not \(\d+, 7\)")
    for value in (np.nan, np.inf):
        array = trial.arrays[name].copy()
        array[5, 2] = value
        changed(path, **{name: array})
        assert_refused(path, f"'{name}' is not finite")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"true_psm2": None}, "damaged: it lacks 'true_psm2'"),  # a replay has nowhere to put its bodies then
        ({"T_world_board": np.full((4, 4), np.nan)}, "'T_world_board' is not finite"),  # the task's own, too
    ],
)
def test_arrays_that_lack_or_are_not_finite_are_named(path, arrays, words):
    changed(path, **arrays)
    assert_refused(path, words)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(TrocarError, match=r"cannot write .*no such folder.*choose another folder"):
        synthetic_trial(RUN).save(tmp_path / "no such folder" / "trial_000.npz")
