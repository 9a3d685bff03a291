import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.models import OffsetModel
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import stepped, walk


def test_the_offset_is_the_mean_error_of_the_good_rows():
    rng, q = np.random.default_rng(0), walk(0, 60)
    error, valid = rng.normal(0.1, 0.2, (60, 6)), rng.random(60) > 0.3
    model = OffsetModel.fit(Recording(q, q + error, valid, np.arange(60.0)), rng)
    assert_allclose(model.offset, error[valid].mean(axis=0), atol=1e-12)
    assert_allclose(model.predict(q), q + error[valid].mean(axis=0), atol=1e-12)
    assert_allclose(stepped(model, q), model.predict(q))
    assert_allclose(model.shifted(np.arange(6.0)).offset, model.offset + np.arange(6.0))
    assert model.rate_independent


def test_it_shows_the_wrists_offsets_in_degrees():
    q = walk(0, 40)
    error = np.tile([0.5, 0.6, 0.7, *np.radians([3.0, -1.5, 0.25])], (40, 1))
    model = OffsetModel.fit(Recording(q, q + error, np.ones(40, bool), np.arange(40.0)), np.random.default_rng(0))
    assert repr(model) == "<cable model 'offset', fitted on 40 rows: offsets of q4 q5 q6 3.00, -1.50, 0.25 deg>"


def test_an_offset_is_six_numbers():
    assert OffsetModel.from_arrays({"offset": np.arange(6.0)}, None).offset.tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.raises(TrocarError, match="has shape"):
        OffsetModel.from_arrays({"offset": np.zeros(1)}, None)
