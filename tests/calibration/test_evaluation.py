import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration import evaluation as module
from trocar.calibration.evaluation import Evaluation, compensation_time_ms, evaluate
from trocar.calibration.models import OffsetModel, TrainingMotion
from trocar.calibration.recording import Recording
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
