from dataclasses import replace

import numpy as np
import pytest

from trocar.calibration.models import MODELS, LstmModel, TrainingMotion, lstm
from trocar.calibration.models.lstm import SHAPES
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from walks import walk


@pytest.fixture(scope="session")
def recording():
    q, rng = walk(0, 200), np.random.default_rng(0)
    return Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(200, bool), np.arange(200.0))


@pytest.fixture(scope="session")
def fitted(recording):
    """A model of each kind; the network's weights are drawn, not trained."""
    models = {name: MODELS[name].fit(recording, np.random.default_rng(1)) for name in MODELS if name != "lstm"}
    rng = np.random.default_rng(2)
    weights = {key: rng.normal(0, 0.06, shape).astype(np.float32) for key, shape in SHAPES.items()}
    q, error = recording.q_cmd, recording.q_phy - recording.q_cmd
    scales = q.mean(axis=0), q.std(axis=0), error.std(axis=0), error.mean(axis=0)
    models["lstm"] = LstmModel(weights, *scales, TrainingMotion.of(recording))
    return {name: models[name] for name in MODELS}


@pytest.fixture
def light(fitted, monkeypatch):
    """The same with a network of four units, the only one whose files are read then: it is packed in no time."""
    monkeypatch.setattr(lstm, "SHAPES", {key: tuple(n // 64 if n > 6 else n for n in SHAPES[key]) for key in SHAPES})
    few = {key: fitted["lstm"].weights[key][tuple(slice(n) for n in shape)] for key, shape in lstm.SHAPES.items()}
    return fitted | {"lstm": replace(fitted["lstm"], weights=few)}
