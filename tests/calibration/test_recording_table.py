"""Recordings as CSV files."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from trocar.calibration import study
from trocar.calibration.recording import COMMANDED, MEASURED, load_recording
from trocar.errors import TrocarError

N = 40
HEADER = ["time_s", *COMMANDED, *MEASURED, "valid"]


@pytest.fixture
def values():
    """Time, commands, measurements and valid of a good recording, as its columns (n, 14)."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.2, 0.2, (N, 6))
    return np.column_stack([0.8 * np.arange(N), q, q + 0.05, rng.random(N) > 0.2])


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
    assert len(recording) == N


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
    assert len(study.load_study_recordings(tmp_path, ["one"])["one"]) == N
    with pytest.raises(
        TrocarError, match=r"lacks the recordings two .*--data or TROCAR_DATA \(docs/calibration.md, 'Pub"
    ):
        study.load_study_recordings(tmp_path, ["one", "two"])
