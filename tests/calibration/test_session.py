import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.evaluation import refit_ends, refit_offset
from trocar.calibration.models import OffsetModel, TrainingMotion
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk

MODEL = OffsetModel(np.full(6, 0.2), TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 100))


def recorded(bad, rows=60):
    """Return a recording whose error grows from row to row, some rows of which are bad."""
    q, valid = walk(0, rows), np.ones(rows, bool)
    valid[list(bad)] = False
    return Recording(q, q + 0.01 * np.arange(rows)[:, None] * np.linspace(0.5, 1.0, 6), valid, np.arange(float(rows)))


def test_offsets_are_refitted_on_the_first_good_rows():
    recording = recorded(bad=(0, 3, 4))
    rows = [1, 2, 5, 6, 7]
    expected = 0.01 * np.mean(rows) * np.linspace(0.5, 1.0, 6)
    assert_allclose(refit_offset(MODEL, recording, 5).offset, expected, atol=1e-12)
    assert refit_ends(recording, 5) == 8
    assert_allclose(refit_offset(MODEL, recording, 1).offset, 0.01 * np.linspace(0.5, 1.0, 6), atol=1e-12)


def test_half_a_minute_is_thirty_rows_if_nothing_else_is_asked_for():
    assert refit_ends(recorded(bad=(2,))) == 31
    assert_allclose(refit_offset(MODEL, recorded(bad=())).offset[-1], 0.01 * 14.5, atol=1e-12)
    assert_allclose(refit_offset(MODEL, recorded(bad=(), rows=30)).offset[-1], 0.01 * 14.5, atol=1e-12)


def test_too_few_rows_are_refused():
    with pytest.raises(TrocarError, match="29 valid rows, but a refit of the offsets needs 30"):
        refit_offset(MODEL, recorded(bad=(7,), rows=30))
    with pytest.raises(TrocarError, match="needs 0"):
        refit_offset(MODEL, recorded(bad=()), 0)
