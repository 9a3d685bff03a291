"""Recorded joints in CSV files, valid and invalid."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.motion.joint_table import read_joint_table


def written(tmp_path, text):
    path = tmp_path / "joints.csv"
    path.write_text(text)
    return path


def lines(times, values):
    return "t_s,q1\n" + "".join(f"{t:.6f},{v}\n" for t, v in zip(times, values, strict=True))


def test_columns_times_and_missing_cells_are_read(tmp_path):
    rows = "".join(f"{0.005 * k},{k if k != 3 else ''},{2 * k}\n" for k in range(20))
    table = read_joint_table(written(tmp_path, "t_s, q1 ,other\n" + rows))
    assert table.names == ("q1", "other")
    assert table.step_s == pytest.approx(0.005)
    assert np.isnan(table.values[3, 0]) and table.values[4, 0] == 4
    assert table.columns(["other"], "x")[5, 0] == 10


def test_dropped_rows_become_gaps_and_jitter_is_allowed(tmp_path):
    rng = np.random.default_rng(0)
    kept = [k for k in range(100) if k not in (10, 50, 51)]
    times = [0.01 * k + rng.uniform(-1e-3, 1e-3) for k in kept]
    table = read_joint_table(written(tmp_path, lines(times, kept)))
    assert table.values.shape == (100, 1)
    assert table.step_s == pytest.approx(0.01, rel=1e-3)
    assert np.flatnonzero(np.isnan(table.values[:, 0])).tolist() == [10, 50, 51]
    assert table.values[kept, 0].tolist() == kept


def test_without_times_a_rate_is_needed(tmp_path):
    path = written(tmp_path, "q1\n" + "1\n" * 20)
    with pytest.raises(TrocarError, match="--rate"):
        read_joint_table(path)
    assert read_joint_table(path, 200.0).step_s == 0.005


EVEN = [0.01 * k for k in range(20)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("1,2\n3,4\n", "does not name its columns"),
        ("q1,q1\n3,4\n", "does not name its columns"),
        (lines(EVEN, [*range(19), "fast"]), "'fast' under 'q1'"),
        (lines(EVEN, [*range(19), "inf"]), "'inf' under 'q1'"),
        (lines(EVEN, [*range(19), "1,2"]), "has 3 cells, not 2"),
        ("t_s\n" + "".join(f"{t}\n" for t in EVEN), "no column besides the times"),
    ],
)
def test_what_cannot_be_used_is_said_in_a_sentence(tmp_path, text, words):
    with pytest.raises(TrocarError, match=words):
        read_joint_table(written(tmp_path, text))


def test_files_that_are_none(tmp_path):
    with pytest.raises(TrocarError, match="does not exist"):
        read_joint_table(tmp_path / "nothing.csv")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(TrocarError, match="cannot be read as CSV"):
        read_joint_table(binary)
    with pytest.raises(TrocarError, match="no column 'q2'; it has q1"):
        read_joint_table(written(tmp_path, lines(EVEN, EVEN))).columns(["q2"], "joints.csv")


def moved(index, by_s):
    return [t + (by_s if k >= index else 0.0) for k, t in enumerate(EVEN)]


@pytest.mark.parametrize(("by", "even"), [(0.29, True), (-0.29, True), (0.31, False), (-0.31, False), (1.31, False)])
def test_a_step_may_differ_by_less_than_a_third(tmp_path, by, even):
    path = written(tmp_path, lines(moved(7, 0.01 * by), range(20)))
    if even:
        assert read_joint_table(path).values.shape == (20, 1)
        return
    with pytest.raises(
        TrocarError, match=rf"are not even: the step to row 9 is {10 * (1 + by):.2f} ms, most are 10.00 ms"
    ):
        read_joint_table(path)


def test_a_step_of_nearly_nothing_is_none(tmp_path):
    """It would round to no step, and so to one place for two samples."""
    with pytest.raises(TrocarError, match=r"step to row 9 is 2.00 ms"):
        read_joint_table(written(tmp_path, lines(moved(7, -0.008), range(20))))


@pytest.mark.parametrize("at", [0, 4, 18])
def test_the_row_whose_time_does_not_increase_is_named(tmp_path, at):
    times = EVEN.copy()
    times[at + 1] = times[at]
    with pytest.raises(TrocarError, match=f"do not increase at row {at + 3}; sort the rows"):
        read_joint_table(written(tmp_path, lines(times, range(20))))


def test_sixteen_rows_are_enough(tmp_path):
    assert len(read_joint_table(written(tmp_path, lines(EVEN[:16], range(16)))).values) == 16
    with pytest.raises(TrocarError, match="has 15 rows of numbers; 16 are needed"):
        read_joint_table(written(tmp_path, lines(EVEN[:15], range(15))))


@pytest.mark.parametrize(("missing", "used"), [(20, True), (21, False)])
def test_half_of_the_samples_may_be_missing_and_no_more(tmp_path, missing, used):
    path = written(tmp_path, lines(moved(7, 0.01 * missing), range(20)))
    if used:
        table = read_joint_table(path)
        assert np.isnan(table.values[:, 0]).sum() == 20 and table.step_s == pytest.approx(0.01)
        assert table.values[[0, 6, 27, 39], 0].tolist() == [0, 6, 7, 19]
        return
    with pytest.raises(TrocarError, match="more than half of the samples"):
        read_joint_table(path)


def test_times_may_stand_in_any_column(tmp_path):
    rows = "".join(f"{k},{0.01 * k},{-k}\n" for k in range(20))
    table = read_joint_table(written(tmp_path, "q1,time,q2\n" + rows), rate_hz=7.0)
    assert table.names == ("q1", "q2") and table.step_s == pytest.approx(0.01)
    np.testing.assert_array_equal(table.values, np.outer(np.arange(20), [1, -1]))
    np.testing.assert_array_equal(table.columns(["q2", "q1"], "x"), np.outer(np.arange(20), [-1, 1]))


def test_a_row_without_a_time_is_named(tmp_path):
    text = lines(EVEN, range(20)).replace("0.050000,", ",", 1)
    with pytest.raises(TrocarError, match="do not increase at row 7"):
        read_joint_table(written(tmp_path, text))
