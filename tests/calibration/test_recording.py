import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.recording import Recording, load_recording, require_motion, sampling_interval, why_invalid
from trocar.errors import TrocarError

N = 50


@pytest.fixture
def arrays():
    rng = np.random.default_rng(0)
    q = rng.normal(0, 0.1, (N, 6))
    return {"q_cmd": q, "q_phy": q + 0.1, "valid": rng.random(N) > 0.2, "t_s": np.arange(N) * 0.8}


def test_npz_and_folders_hold_the_same(tmp_path, arrays):
    np.savez(tmp_path / "one.npz", **arrays)
    for commanded, measured in (("q_cmd", "q_phy"), ("q_des", "q_act")):
        folder = tmp_path / commanded
        folder.mkdir()
        np.save(folder / f"{commanded}.npy", arrays["q_cmd"])
        np.save(folder / f"{measured}.npy", arrays["q_phy"])
        loaded = load_recording(folder)
        assert_allclose(loaded.q_cmd, arrays["q_cmd"])
        assert_allclose(loaded.q_phy, arrays["q_phy"])
        assert loaded.valid.all()
    one = load_recording(tmp_path / "one.npz")
    assert_array_equal(one.valid, arrays["valid"])


def test_bad_rows_are_masked_and_their_commands_kept(arrays):
    arrays["valid"][:] = True
    arrays["q_phy"][3, 2] = np.nan
    arrays["q_phy"][7, 3] += np.pi
    recording = Recording(**arrays)
    assert_array_equal(np.flatnonzero(~recording.valid), [3, 7])
    assert len(recording.q_cmd) == N


def test_scored_rows_keep_the_history(arrays):
    part = Recording(**arrays).scored(30)
    assert len(part) == N
    assert not part.valid[:30].any()
    assert_array_equal(part.valid[30:], arrays["valid"][30:])


def test_pauses_do_not_count_in_the_sampling_interval():
    q = np.repeat(np.arange(5.0)[:, None] * 0.1, 3, axis=0) * np.ones(6)
    assert_allclose(sampling_interval(q), 0.1)


@pytest.mark.parametrize(
    "change",
    [
        {"q_cmd": np.zeros((N, 5))},
        {"q_cmd": np.zeros(N)},
        {"q_phy": np.zeros((N - 1, 6))},
        {"q_cmd": np.full((N, 6), np.nan)},
        {
            "q_cmd": np.empty((0, 6)),
            "q_phy": np.empty((0, 6)),
            "valid": np.empty(0, bool),
            "t_s": np.empty(0),
        },
        {"q_cmd": np.array([["a"] * 6] * N)},
        {"valid": np.ones(N - 1, bool)},
        {"valid": np.full(N, 2)},
        {"t_s": np.arange(N)[::-1]},
    ],
    ids=["five joints", "flat", "lengths", "nan", "empty", "text", "mask length", "mask values", "time"],
)
def test_malformed_arrays_are_one_sentence(arrays, change, tmp_path):
    np.savez(tmp_path / "bad.npz", **(arrays | change))
    with pytest.raises(TrocarError) as error:
        load_recording(tmp_path / "bad.npz")
    assert "\n" not in str(error.value)


def test_malformed_files_are_one_sentence(tmp_path, arrays):
    np.savez(tmp_path / "good.npz", **arrays)
    (tmp_path / "truncated.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:700])
    (tmp_path / "empty.npz").write_bytes(b"")
    np.savez(tmp_path / "lacking.npz", q_cmd=arrays["q_cmd"])
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.csv").write_text("1,2,3")
    names = ("truncated.npz", "empty.npz", "lacking.npz", "folder", "text.csv", "missing.npz")
    for name in names:
        with pytest.raises(TrocarError) as error:
            load_recording(tmp_path / name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (np.degrees([1, 1, np.pi / 180, 1, 1, 1]), "q4 is commanded to 30.0, which looks like degrees"),
        ([1, 1, 1e3, 1, 1, 1], "q3 is commanded to 200.0, which looks like millimetres"),
    ],
)
def test_other_units_are_recognised(tmp_path, arrays, scale, said):
    arrays["q_cmd"] = np.clip(arrays["q_cmd"], -0.2, 0.2)
    arrays["q_cmd"][0] = [0.1, 0.1, 0.2, np.radians(30.0), 0.1, 0.1]
    np.savez(tmp_path / "good.npz", **arrays)
    load_recording(tmp_path / "good.npz")
    scaled = {key: arrays[key] * scale for key in ("q_cmd", "q_phy")}
    np.savez(tmp_path / "other.npz", **(arrays | scaled))
    with pytest.raises(TrocarError, match=said):
        load_recording(tmp_path / "other.npz")


def test_a_wrist_that_rests_says_nothing_of_its_cables(arrays):
    recording = Recording(**arrays)
    require_motion(recording)
    for joint, name in ((3, "q4"), (5, "q6")):
        q_cmd = arrays["q_cmd"].copy()
        q_cmd[arrays["valid"], joint] = 0.25  # what it does in bad rows says nothing either
        with pytest.raises(TrocarError, match=f"{name} rests at 0.2500 rad in all"):
            require_motion(Recording(**(arrays | {"q_cmd": q_cmd, "q_phy": q_cmd})))


def test_rows_that_do_not_count_are_counted_by_the_rule_that_says_so(arrays):
    arrays["valid"] = np.arange(N) >= 5
    arrays["q_phy"][10:20, 1] = np.nan
    arrays["q_phy"][20:27, 4] += 1.0
    recording = Recording(**arrays)
    assert recording.valid.sum() == N - 22
    assert why_invalid(recording) == (
        "10 have a measurement that is not a number, 7 are misdetected, a wrist angle 1 rad or more from its command, "
        "5 are marked as not valid"
    )
    assert why_invalid(Recording(arrays["q_cmd"], arrays["q_cmd"], np.ones(N, bool), arrays["t_s"])) == ""
    with pytest.raises(TrocarError, match=r"28 valid rows of 50 \(10 have .* 7 are .* 5 are .*\); a fit needs 30"):
        TrainingMotion.of(recording)
