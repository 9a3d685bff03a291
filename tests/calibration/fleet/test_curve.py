import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.fleet import curve as module
from trocar.calibration.fleet.curve import WITH, WITHOUT, Curve, curve, draw_curve
from trocar.calibration.models import OffsetModel
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError

SHARES = np.arange(1.0, 7.0)


@pytest.fixture
def recording():
    """A still arm, measured where it is: what a model adds is its error. Of the tail, one row is bad."""
    valid = np.ones(200, bool)
    valid[190] = False
    return Recording(np.zeros((200, 6)), np.zeros((200, 6)), valid, 0.5 * np.arange(200.0) + 3.0, "mine")


@pytest.fixture(autouse=True)
def seen(monkeypatch):
    """Replace both ways of fitting by models whose errors tell how many rows they saw; return these numbers."""
    seen = []

    def fit_from_prior(part, prior):
        seen.append((WITH, len(part)))
        return OffsetModel(SHARES / len(part), None)

    def fit(part, rng):
        seen.append((WITHOUT, len(part)))
        return OffsetModel(-3.0 * SHARES / len(part), None)

    monkeypatch.setattr(module, "fit_from_prior", fit_from_prior)
    monkeypatch.setattr(module.PlayModel, "fit", fit)
    return seen


def test_a_curve_has_the_errors_of_both_ways_on_the_last_fifth(recording, seen):
    found = curve(recording, None, [50, 100])
    assert seen == [(WITH, 50), (WITHOUT, 50), (WITH, 100), (WITHOUT, 100)]
    assert found.recording == "mine" and found.rows == (50, 100)
    assert found.tail == 39
    assert_allclose(found.seconds, [24.5, 49.5])
    assert_allclose(found.rmse[WITH], [SHARES / 50, SHARES / 100])
    assert_allclose(found.rmse[WITHOUT], [3.0 * SHARES / 50, 3.0 * SHARES / 100])


def test_only_the_last_fifth_counts(recording):
    early = np.arange(200) < 160
    off = Recording(recording.q_cmd, early[:, None] * np.full(6, 0.1), recording.valid, recording.t_s)
    assert_allclose(curve(off, None, [160]).rmse[WITH], [SHARES / 160])
    late = Recording(recording.q_cmd, ~early[:, None] * np.full(6, 0.1), recording.valid, recording.t_s)
    assert_allclose(curve(late, None, [160]).rmse[WITH], [np.abs(SHARES / 160 - 0.1)])


def test_errors_are_root_mean_squares(recording):
    swing = np.where(np.arange(200) % 3 == 0, 0.3, 0.0)
    off = Recording(recording.q_cmd, np.tile(swing[:, None], 6), recording.valid, recording.t_s)
    error = (SHARES / 50 - swing[160:, None])[np.arange(40) != 30]
    assert_allclose(curve(off, None, [50]).rmse[WITH][0], np.linalg.norm(error, axis=0) / np.sqrt(39))


def test_the_usual_numbers_of_rows_end_with_all_that_are_not_scored(recording):
    found = curve(recording, None)
    assert found.rows == (50, 75, 100, 150, 160)
    longer = Recording(np.zeros((1375, 6)), np.zeros((1375, 6)), np.ones(1375, bool), np.arange(1375.0))
    assert curve(longer, None).rows == (50, 75, 100, 150, 200, 300, 500, 800, 1100)
    assert curve(longer.first(1000), None).rows == (50, 75, 100, 150, 200, 300, 500, 800)


def test_rows_must_leave_something_to_fit_and_to_score(recording):
    assert curve(recording, None, [30, 160]).rows == (30, 160)
    for rows in (29, 161):
        with pytest.raises(TrocarError, match=rf"{rows} rows are outside 30\.\.160: mine is scored from row 160"):
            curve(recording, None, [rows])


def test_a_picture_shows_the_wrist_joint_by_joint(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(module, "write_figure", lambda path, figure: figures.append(figure) or path)
    rmse = {WITH: np.arange(12.0).reshape(2, 6), WITHOUT: np.arange(12.0, 24.0).reshape(2, 6)}
    draw_curve(Curve("mine", (50, 100), (40.0, 80.0), rmse, 30), tmp_path / "curve.png")
    axes = figures[0].axes
    assert len(axes) == 3
    assert len({axis.get_position().x0 for axis in axes}) == 3 and len({axis.get_position().y0 for axis in axes}) == 1
    for axis, joint, title in zip(axes, (3, 4, 5), ("q4 roll", "q5 wrist pitch", "q6 wrist yaw"), strict=True):
        assert axis.get_title() == title
        assert axis.get_xscale() == "log" and axis.get_ylim()[0] == 0.0
        assert [line.get_label() for line in axis.lines] == [WITH, WITHOUT]
        for line, values in zip(axis.lines, rmse.values(), strict=True):
            assert_allclose(line.get_xdata(), [40.0, 80.0])
            assert_allclose(line.get_ydata(), values[:, joint])
    assert axes[0].get_legend() is not None and axes[0].get_ylabel().startswith("RMSE")
