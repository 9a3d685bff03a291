"""What an evaluation says of a model, also after a refit, and how it is drawn."""

import time

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from trocar.calibration import evaluation as module
from trocar.calibration.evaluation import (
    Evaluation,
    compensation_time_ms,
    draw_evaluation,
    evaluate,
    refit_ends,
    refit_offset,
    wrist,
)
from trocar.calibration.models import OffsetModel, TrainingMotion
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk

OFF = np.array([0.01, 0.02, 0.003, 0.1, -0.2, 0.2])
MODEL = OffsetModel(0.5 * OFF, TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 100))


def recorded(rows=40):
    """Return a recording that errs by ``OFF``, up and down alternately about it by the same again; a bad row."""
    q, valid = walk(0, rows), np.ones(rows, bool)
    valid[30] = False
    swing = np.where(np.arange(rows) % 2, 2.0, 0.0)[:, None]
    return Recording(q, q + swing * OFF, valid, np.arange(float(rows)), "mine")


def test_errors_are_root_mean_squares_of_the_good_rows_from_a_row_on():
    found = evaluate(MODEL, recorded(), 20)
    odd, even = 10, 9
    assert found.rows == odd + even
    assert_allclose(found.rmse_before, np.sqrt(4 * odd / 19) * np.abs(OFF))
    assert_allclose(found.rmse_after, np.sqrt((1.5**2 * odd + 0.5**2 * even) / 19) * np.abs(OFF))
    assert evaluate(MODEL, recorded()).rows == 39


def test_a_model_is_shown_in_a_line_a_table_and_as_json():
    found = Evaluation("offset", recorded().scored(20), recorded().q_cmd, 1.25)
    before = np.degrees(np.sqrt(4 * 10 / 19) * 0.3)
    assert f"RMSE of the wrist {before:.2f} deg without it, {before:.2f} deg with it" in repr(found)
    assert "on 19 rows of 'mine'" in repr(found)
    summary = found.summary()
    assert summary["joints"] == ["q1", "q2", "q3", "q4", "q5", "q6"]
    assert_allclose(summary["rmse_before"], found.rmse_before)
    assert_allclose(summary["rmse_after"], found.rmse_after)
    assert (summary["rows"], summary["compensation_ms"], summary["recording"]) == (19, 1.25, "mine")
    rows = found._repr_html_().split("<tr")
    assert [("mm" in row or " m" in row) for row in rows if ">q" in row] == [False, False, True, False, False, False]


@pytest.mark.parametrize(("rows", "timed"), [(60, 60), (300, 100)])
def test_the_time_is_the_median_of_the_first_hundred_compensations(monkeypatch, rows, timed):
    """A clock that stands still but for what each point takes: 1, 2, 3, ... ms."""
    took, clock = [], [0.0]

    class Slow:
        def __init__(self, model):
            assert model is MODEL

        def start(self, q):
            assert_allclose(q, recorded(rows).q_cmd[0])

        def path(self, q):
            assert q.shape == (1, 6)
            took.append(len(took) + 1)
            clock[0] += 1e-3 * took[-1] ** 2

    monkeypatch.setattr(module, "Compensator", Slow)
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    found = compensation_time_ms(MODEL, recorded(rows))
    assert len(took) == timed
    assert found == pytest.approx(np.median(np.arange(1, timed + 1) ** 2))


SHIFTED = OffsetModel(np.full(6, 0.2), TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 100))


def drifting(bad, rows=60):
    """Return a recording whose error grows from row to row, some rows of which are bad."""
    q, valid = walk(0, rows), np.ones(rows, bool)
    valid[list(bad)] = False
    return Recording(q, q + 0.01 * np.arange(rows)[:, None] * np.linspace(0.5, 1.0, 6), valid, np.arange(float(rows)))


def test_offsets_are_refitted_on_the_first_good_rows():
    recording = drifting(bad=(0, 3, 4))
    rows = [1, 2, 5, 6, 7]
    expected = 0.01 * np.mean(rows) * np.linspace(0.5, 1.0, 6)
    assert_allclose(refit_offset(SHIFTED, recording, 5).offset, expected, atol=1e-12)
    assert refit_ends(recording, 5) == 8
    assert_allclose(refit_offset(SHIFTED, recording, 1).offset, 0.01 * np.linspace(0.5, 1.0, 6), atol=1e-12)


def test_half_a_minute_is_thirty_rows_if_nothing_else_is_asked_for():
    assert refit_ends(drifting(bad=(2,))) == 31
    assert_allclose(refit_offset(SHIFTED, drifting(bad=())).offset[-1], 0.01 * 14.5, atol=1e-12)
    assert_allclose(refit_offset(SHIFTED, drifting(bad=(), rows=30)).offset[-1], 0.01 * 14.5, atol=1e-12)


def test_too_few_rows_are_refused():
    with pytest.raises(TrocarError, match="29 valid rows, but a refit of the offsets needs 30"):
        refit_offset(SHIFTED, drifting(bad=(7,), rows=30))
    with pytest.raises(TrocarError, match="needs 0"):
        refit_offset(SHIFTED, drifting(bad=()), 0)


COMMANDED, MEASURED, PREDICTED = "#8a8f98", "#1f6fb4", "#d9541e"


@pytest.fixture(scope="module")
def recording():
    q, valid = walk(0, 200), np.ones(200, bool)
    valid[[0, 1, 50]] = False
    return Recording(q, q + np.linspace(0.01, 0.06, 6), valid, 0.5 * np.arange(200.0) + 7.0, "mine")


@pytest.fixture(scope="module")
def axes(recording):
    figure = Figure()
    wrist(figure, recording, Evaluation("offset", recording, recording.q_cmd + 0.02, 1.0))
    return figure.axes


def lines_of(axis):
    return {line.get_label(): line for line in axis.lines}


def test_each_joint_of_the_wrist_has_its_way_over_time(recording, axes):
    rows = np.flatnonzero(recording.valid)
    for row, joint in enumerate((3, 4, 5)):
        lines = lines_of(axes[2 * row])
        assert lines.keys() == {"commanded", "measured", "predicted"}
        for label, values in (
            *(("commanded", recording.q_cmd), ("measured", recording.q_phy)),
            ("predicted", recording.q_cmd + 0.02),
        ):
            assert_allclose(lines[label].get_xdata(), 0.5 * (rows - rows[0]))
            assert_allclose(lines[label].get_ydata(), values[rows, joint])
        assert [lines[label].get_linestyle() for label in ("commanded", "measured", "predicted")] == ["-", "-", "--"]
        assert [lines[label].get_color() for label in lines] == [COMMANDED, MEASURED, PREDICTED]


def test_beside_it_are_its_loops_of_the_first_rows(recording, axes):
    first = np.flatnonzero(recording.valid)[:160]
    for row, joint in enumerate((3, 4, 5)):
        lines = lines_of(axes[2 * row + 1])
        assert lines.keys() == {"measured", "predicted"}
        for label, error in (("measured", 0.01 * (joint + 1)), ("predicted", 0.02)):
            assert_allclose(lines[label].get_xdata(), recording.q_cmd[first, joint])
            assert_allclose(lines[label].get_ydata(), error, atol=1e-12)
        assert "first 160 rows" in axes[2 * row + 1].get_title()


def test_axes_are_named_and_errors_told(axes):
    for row, (joint, words) in enumerate((("q4", "roll"), ("q5", "wrist pitch"), ("q6", "wrist yaw"))):
        over_time, loops = axes[2 * row], axes[2 * row + 1]
        error = 0.01 * (row + 4)
        assert over_time.get_title().startswith(f"{joint} {words}: RMSE {error:.4f} rad uncorrected, ")
        assert over_time.get_title().endswith(f"{abs(error - 0.02):.4f} rad predicted")
        assert over_time.get_ylabel() == f"{joint} [rad]" and loops.get_ylabel() == f"{joint} - command [rad]"
        for axis in (over_time, loops):
            assert not axis.spines["top"].get_visible() and not axis.spines["right"].get_visible()
        assert over_time.get_position().x0 < loops.get_position().x0
        assert over_time.get_position().width > 2 * loops.get_position().width
    assert [axis.get_legend() is not None for axis in axes] == [True, True, False, False, False, False]
    assert [axis.get_xlabel() for axis in axes] == ["", "", "", "", "time [s]", "commanded joint [rad]"]
    assert axes[0].figure.get_suptitle() == "mine: cable model 'offset' on 197 rows"


def test_without_a_model_the_measurements_are_beside_the_commands(recording):
    figure = Figure()
    wrist(figure, recording)
    assert lines_of(figure.axes[0]).keys() == {"commanded", "measured"}
    assert figure.axes[2].get_title() == "q5 wrist pitch: RMSE 0.0500 rad, measured against commanded"
    assert figure.get_suptitle() == "mine: 197 rows"


def test_nothing_good_is_nothing_to_draw(recording):
    empty = Recording(recording.q_cmd, recording.q_phy, np.zeros(200, bool), recording.t_s, "mine")
    with pytest.raises(TrocarError, match=r"mine has no valid row to be drawn \(200 are marked as not valid\)"):
        wrist(Figure(), empty)


def test_a_picture_is_written_where_it_is_asked_for(recording, monkeypatch, tmp_path):
    written = []
    monkeypatch.setattr(module, "write_figure", lambda path, figure: written.append(figure) or path)
    evaluation = Evaluation("offset", recording, recording.q_cmd, 1.0)
    assert draw_evaluation(evaluation, tmp_path / "one.png") == tmp_path / "one.png"
    width, height = written[0].get_size_inches() * written[0].dpi
    assert len(written[0].axes) == 6 and 1200 < width < 2000 and 800 < height < 1200
