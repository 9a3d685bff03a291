"""Recordings, and the files that they come in."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trocar.calibration import study
from trocar.calibration.models.base import TrainingMotion, sampling_interval
from trocar.calibration.recording import COMMANDED, MEASURED, Recording, load_recording, looks_like_recording
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


@pytest.mark.parametrize(
    "change",
    [
        {"q_cmd": np.zeros((N, 5))},
        {"q_cmd": np.zeros(N)},
        {"q_phy": np.zeros((N - 1, 6))},
        {"q_cmd": np.full((N, 6), np.nan)},
        {"q_cmd": np.empty((0, 6)), "q_phy": np.empty((0, 6)), "valid": np.empty(0, bool), "t_s": np.empty(0)},
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


def test_a_bag_says_how_it_becomes_a_recording(tmp_path):
    (tmp_path / "psm1.bag").write_bytes(b"#ROSBAG V2.0")
    (tmp_path / "psm1").mkdir()
    (tmp_path / "psm1" / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    for name in ("psm1.bag", "psm1"):
        with pytest.raises(TrocarError, match="is a bag of ROS; make a recording of it with trocar recording import"):
            load_recording(tmp_path / name)


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


def test_a_wrist_that_rests_says_nothing_of_its_cables(arrays):
    recording = Recording(**arrays)
    recording.require_motion()
    for joint, name in ((3, "q4"), (5, "q6")):
        q_cmd = arrays["q_cmd"].copy()
        q_cmd[arrays["valid"], joint] = 0.25  # what it does in bad rows says nothing either
        with pytest.raises(TrocarError, match=f"{name}, which rests at 0.2500 rad in all"):
            Recording(**(arrays | {"q_cmd": q_cmd, "q_phy": q_cmd})).require_motion()


def test_rows_that_do_not_count_are_counted_by_the_rule_that_says_so(arrays):
    arrays["valid"] = np.arange(N) >= 5
    arrays["q_phy"][10:20, 1] = np.nan
    arrays["q_phy"][20:27, 4] += 1.0
    recording = Recording(**arrays)
    assert recording.valid.sum() == N - 22
    assert recording.why_invalid() == (
        "10 have a measurement that is not a number, 7 are misdetected, a wrist angle 1 rad or more from its command, "
        "5 are marked as not valid"
    )
    assert Recording(arrays["q_cmd"], arrays["q_cmd"], np.ones(N, bool), arrays["t_s"]).why_invalid() == ""
    with pytest.raises(TrocarError, match=r"28 valid rows of 50 \(10 have .* 7 are .* 5 are .*\); a fit needs 30"):
        TrainingMotion.of(recording)


def test_the_first_rows_are_a_recording_of_two_rows_or_more(arrays):
    recording = Recording(**arrays, name="mine")
    for rows in (2, 20, N):
        part = recording.first(rows)
        for name in ("q_cmd", "q_phy", "valid", "t_s"):
            assert_array_equal(getattr(part, name), getattr(recording, name)[:rows])
        assert part.name == "mine"
    for rows in (1, N + 1):
        with pytest.raises(TrocarError, match=rf"row {rows} is outside 2\.\.{N}, the rows of mine"):
            recording.first(rows)


def test_rows_are_scored_from_one_on(arrays):
    arrays["valid"][:] = True
    recording = Recording(**arrays)
    for first in (0, 10, N - 1):
        part = recording.scored(first)
        assert_array_equal(np.flatnonzero(part.valid), range(first, N))
        assert_array_equal(part.q_cmd, recording.q_cmd)
    for first in (-1, N):
        with pytest.raises(TrocarError, match=f"row {first} is not within the {N} rows of recording"):
            recording.scored(first)
    arrays["valid"][30:] = False
    with pytest.raises(TrocarError, match="has no valid measurement from row 30 on"):
        Recording(**arrays).scored(30)
    assert Recording(**arrays).scored(29).valid.sum() == 1


def test_a_recording_shows_its_length_and_its_ranges(arrays):
    arrays["valid"] = np.arange(N) < 47
    arrays["t_s"] = 3.0 + 0.5 * np.arange(N)
    arrays["q_cmd"][:] = np.linspace(0.0, 0.1, N)[:, None] * np.arange(1, 7)
    arrays["q_phy"] = arrays["q_cmd"] + np.where(np.arange(N) % 2, 0.02, 0.04)[:, None] * np.arange(1, 7) / 6
    recording = Recording(**arrays, name="mine")
    assert repr(recording) == "<Recording 'mine': 50 rows over 24.5 s, 47 valid>"
    rows = [row for row in recording._repr_html_().split("<tr") if ">q" in row]
    error = np.where(np.arange(47) % 2, 0.02, 0.04)
    for row, word in ((5, f"{np.degrees(0.6):.1f}"), (5, f"{np.degrees(error.mean()):.2f}"), (2, "300.0"), (5, "0.0")):
        assert word in rows[row], (word, rows[row])
    assert f"{np.degrees(error.std()):.2f}" in rows[5]
    assert f"{1e3 * 0.5 * error.mean():.2f}" in rows[2]
    assert [" mm" in row for row in rows] == [False, False, True, False, False, False]
    none = Recording(**(arrays | {"valid": np.zeros(N, bool)}))
    assert len([row for row in none._repr_html_().split("<tr") if ">q" in row]) == 6


def test_a_file_keeps_a_recording(tmp_path, arrays):
    recording = Recording(**arrays)
    again = load_recording(recording.save(tmp_path / "mine.npz"))
    for name in ("q_cmd", "q_phy", "valid", "t_s"):
        assert_array_equal(getattr(again, name), getattr(recording, name))
    assert again.name == "mine"
    first = (tmp_path / "mine.npz").read_bytes()
    assert recording.save(tmp_path / "mine.npz").read_bytes() == first
    with pytest.raises(TrocarError, match=r"does not end in .npz"):
        recording.save(tmp_path / "mine.csv")


def test_times_and_good_rows_may_be_left_out(tmp_path, arrays):
    np.savez(tmp_path / "bare.npz", q_cmd=arrays["q_cmd"], q_phy=arrays["q_phy"])
    bare = load_recording(tmp_path / "bare.npz")
    assert bare.valid.all() and len(bare) == N
    assert_array_equal(bare.t_s, np.arange(N))
    folder = tmp_path / "folder"
    folder.mkdir()
    for key, value in arrays.items():
        np.save(folder / f"{key}.npy", value)
    whole = load_recording(folder)
    assert_array_equal(whole.valid, arrays["valid"])
    assert_array_equal(whole.t_s, arrays["t_s"])
    assert whole.name == "folder"


def test_what_looks_like_a_recording(tmp_path, arrays):
    np.savez(tmp_path / "one.npz", **arrays)
    np.savez(tmp_path / "half.npz", q_cmd=arrays["q_cmd"])
    (tmp_path / "text.npz").write_text("no zip")
    (tmp_path / "folder").mkdir()
    assert looks_like_recording(tmp_path / "one.npz") and looks_like_recording(str(tmp_path / "one.npz"))
    for name in ("half.npz", "text.npz", "none.npz", "folder"):
        assert not looks_like_recording(tmp_path / name)
    np.save(tmp_path / "folder" / "q_des.npy", arrays["q_cmd"])
    assert looks_like_recording(tmp_path / "folder")


def test_a_misdetection_is_told_from_a_cable_error(arrays):
    """The wrist's angles may be a radian off at most; outer joints have no such bound."""
    arrays["valid"][:] = True
    arrays["q_phy"] = arrays["q_cmd"].copy()
    for row, (joint, off) in enumerate([(3, 0.999), (3, 1.0), (5, -0.999), (5, -1.001), (2, 5.0), (0, -3.0)]):
        arrays["q_cmd"][row] = 0.0
        arrays["q_phy"][row] = 0.0
        arrays["q_phy"][row, joint] = off
    arrays["q_phy"][6, 0] = np.inf
    arrays["q_phy"][7, 5] = -np.inf
    assert_array_equal(np.flatnonzero(~Recording(**arrays).valid), [1, 3, 6, 7])


def test_a_joint_that_moves_a_little_moves(arrays):
    for span, rests in ((0.99e-6, True), (1.01e-6, False)):
        q_cmd = arrays["q_cmd"].copy()
        q_cmd[:, 4] = 0.2 + span * (np.arange(N) % 2)
        recording = Recording(**(arrays | {"q_cmd": q_cmd, "q_phy": q_cmd}))
        if rests:
            with pytest.raises(
                TrocarError, match=f"q5, which rests at 0.2000 rad in all {recording.valid.sum()} valid"
            ):
                recording.require_motion()
        else:
            recording.require_motion()
    Recording(**(arrays | {"valid": np.zeros(N, bool), "q_cmd": np.zeros((N, 6))})).require_motion()


@pytest.mark.parametrize(
    ("joint", "largest", "said"),
    [(0, 2 * np.pi, "q1 .* degrees"), (4, 2 * np.pi, "q5 .* degrees"), (2, 1.0, "q3 .* millimetres")],
)
def test_what_a_joint_can_do_is_in_rad_and_m(tmp_path, arrays, joint, largest, said):
    """Up to a whole turn, and a metre."""
    for sign in (1.0, -1.0):
        arrays["q_cmd"][5, joint] = sign * largest * 0.999
        np.savez(tmp_path / "good.npz", **arrays)
        assert len(load_recording(tmp_path / "good.npz")) == N
        arrays["q_cmd"][5, joint] = sign * largest * 1.01
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(TrocarError, match=said):
            load_recording(tmp_path / "bad.npz")


def test_the_sampling_interval_is_a_mean_over_what_moves():
    q = np.zeros((5, 6))
    q[:, 0], q[:, 1] = [0.0, 0.1, 0.1, 0.4, 0.4], [0.0, -0.2, -0.2, -0.2, -0.2]
    assert_allclose(sampling_interval(q), [0.2, 0.1, 0, 0, 0, 0])
    assert_allclose(sampling_interval(q + 0.9e-9 * np.arange(5)[:, None] * (np.arange(6) == 5))[:2], [0.2, 0.1])
    assert_array_equal(sampling_interval(np.ones((4, 6))), np.zeros(6))
    assert_array_equal(sampling_interval(np.ones((1, 6))), np.zeros(6))


def test_two_rows_are_a_recording_and_times_may_stand_still(arrays):
    two = {key: value[:2] for key, value in arrays.items()}
    assert len(Recording(**two)) == 2
    assert len(Recording(**(two | {"t_s": np.array([3.0, 3.0])}))) == 2
    with pytest.raises(TrocarError, match="has 1 rows; a recording needs 2 or more"):
        Recording(**{key: value[:1] for key, value in arrays.items()})
    for wrong in ([0.0, np.inf], [1.0, 0.999]):
        with pytest.raises(TrocarError, match="times t_s that are not finite or decrease"):
            Recording(**(two | {"t_s": np.array(wrong)}))
    q_cmd = arrays["q_cmd"].copy()
    q_cmd[[7, 9], [5, 0]] = np.nan
    with pytest.raises(TrocarError, match="has a q_cmd that is not finite at row 7; models"):
        Recording(**(arrays | {"q_cmd": q_cmd}))
    assert_array_equal(Recording(**(arrays | {"valid": arrays["valid"].astype(int)})).valid, arrays["valid"])


ROWS = 40
HEADER = ["time_s", *COMMANDED, *MEASURED, "valid"]


@pytest.fixture
def values():
    """Time, commands, measurements and valid of a good recording, as its columns (n, 14)."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.2, 0.2, (ROWS, 6))
    return np.column_stack([0.8 * np.arange(ROWS), q, q + 0.05, rng.random(ROWS) > 0.2])


def written(path, values, header=HEADER, cells=()):
    """Write a table, some cells (row, column) replaced by a text, and return its path."""
    rows = [[f"{value:.17g}" for value in row] for row in values]
    for row, column, text in cells:
        rows[row][header.index(column)] = text
    path.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    return path


def test_a_csv_and_an_npz_hold_the_same_whatever_the_order_of_the_columns(tmp_path, values):
    order = np.random.default_rng(1).permutation(len(HEADER))
    table = written(tmp_path / "mine.csv", values[:, order], [HEADER[k] for k in order])
    np.savez(tmp_path / "mine.npz", q_cmd=values[:, 1:7], q_phy=values[:, 7:13], valid=values[:, 13], t_s=values[:, 0])
    one, other = load_recording(table), load_recording(tmp_path / "mine.npz")
    for name in ("q_cmd", "q_phy", "valid", "t_s"):
        assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.name == other.name == "mine"


def test_times_and_valid_may_be_left_out_and_an_empty_cell_is_no_measurement(tmp_path, values):
    cells = [(3, "q5_measured_rad", ""), (4, "q1_measured_rad", "nan")]
    recording = load_recording(written(tmp_path / "mine.csv", values[:, 1:13], HEADER[1:13], cells))
    assert_array_equal(np.flatnonzero(~recording.valid), [3, 4])
    assert len(recording) == ROWS


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda h: [n for n in h if n != "q6_measured_rad"], "lacks column q6_measured_rad, it has time_s, q1_comm"),
        (lambda h: [n.replace("q4_commanded_rad", "q4_commanded_deg") for n in h], "in 'deg'; give it in rad and call"),
        (lambda h: [n.replace("q3_measured_m", "q3_measured_mm") for n in h], "in 'mm'; give it in m and call"),
        (
            lambda h: [n.replace("q2_measured_rad", "q2_measured") for n in h],
            "without a unit; .* call it 'q2_measured_rad'",
        ),
        (lambda h: [n.replace("valid", "is_valid") for n in h], "column 'is_valid' too many; .* 'valid'"),
        (lambda h: [n.replace("valid", "t_s") for n in h], "column 't_s' too many"),
        (lambda h: [*h[:-1], h[1]], "does not name its columns"),
    ],
    ids=["missing", "deg", "mm", "no unit", "strange", "two times", "twice"],
)
def test_columns_that_are_missing_or_strange_are_named(tmp_path, values, change, said):
    header = change(HEADER)
    with pytest.raises(TrocarError, match=said) as error:
        load_recording(written(tmp_path / "mine.csv", values[:, : len(header)], header))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ((5, "q4_commanded_rad", "abc"), "row 7 .* holds 'abc' under 'q4_commanded_rad'; give a number"),
        ((5, "q4_commanded_rad", ""), "has no number under 'q4_commanded_rad' in row 7; .* whole history"),
        ((5, "q4_measured_rad", "inf"), "row 7 .* holds 'inf'"),
        ((5, "q4_measured_rad", "1,2"), "row 7 .* has 15 cells, not 14"),
        ((5, "time_s", "-1"), "times t_s that are not finite or decrease"),
        ((5, "time_s", ""), "times t_s that are not finite or decrease"),
        ((5, "valid", "2"), "has other values of valid than true or false"),
        ((5, "q4_commanded_rad", "30"), "which looks like degrees; give rad"),
        ((5, "q3_commanded_m", "120"), "commands of q3 up to 120.0, which looks like millimetres"),
    ],
)
def test_cells_that_are_wrong_are_named_with_their_row(tmp_path, values, cell, said):
    with pytest.raises(TrocarError, match=said):
        load_recording(written(tmp_path / "mine.csv", values, cells=[cell]))


def test_tables_without_rows_are_refused(tmp_path, values):
    with pytest.raises(TrocarError, match="has 0 rows; a recording needs 2 or more"):
        load_recording(written(tmp_path / "none.csv", values[:0]))
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(
        TrocarError, match="is empty; its first line must name the columns, such as time_s,q1_commanded"
    ):
        load_recording(tmp_path / "empty.csv")


def test_the_study_takes_either_kind_and_says_where_recordings_are(tmp_path, values):
    written(tmp_path / "one.csv", values)
    assert len(study.load_study_recordings(tmp_path, ["one"])["one"]) == ROWS
    with pytest.raises(
        TrocarError, match=r"lacks the recordings two .*--data or TROCAR_DATA \(docs/calibration.md, 'Pub"
    ):
        study.load_study_recordings(tmp_path, ["one", "two"])
