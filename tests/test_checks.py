"""Values made by hand hold no NaN."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trocar.calibration.models import TrainingMotion
from trocar.errors import TrocarError
from trocar.station import CheckerboardRegistration, Registration, SensorFlaws

VALUES = (Registration(), CheckerboardRegistration(), SensorFlaws())


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_nan_in_a_value_made_by_hand_is_refused_by_its_name(value):
    name = next(name for name, held in vars(value).items() if isinstance(held, float))
    with pytest.raises(TrocarError, match=f"{name} of {type(value).__name__} holds NaN"):
        replace(value, **{name: math.nan})


def test_nan_in_an_array_is_refused_too():
    with pytest.raises(TrocarError, match="interval of TrainingMotion holds NaN"):
        TrainingMotion(np.full(6, np.nan), np.zeros(6), np.ones(6), 30)
