"""Values constructed by users contain no NaN."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trocar.arms.instrument import FingerMarks
from trocar.calibration.excitation import PSM1_BOX
from trocar.calibration.models import TrainingMotion
from trocar.calibration.plant import PSM1_GREY
from trocar.checks import outside, takes
from trocar.errors import TrocarError
from trocar.lab import CheckerboardRegistration, Registration, SensorFlaws, load_station
from trocar.lab.transmission import Cables, PoseErrorField
from trocar.perception.image import Intrinsics
from trocar.tasks.suture.planning import PRESETS, suture_joints

STATION = load_station("peg-transfer")
ARM = STATION.arms["psm1"]
VALUES = (Registration(), CheckerboardRegistration(), SensorFlaws(), FingerMarks(((1, 0, 0), (0, 1, 0))))


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_nan_in_a_value_made_by_hand_is_refused_by_its_name(value):
    name = next(name for name, held in vars(value).items() if isinstance(held, float))
    with pytest.raises(TrocarError, match=f"{name} of {type(value).__name__} holds NaN"):
        replace(value, **{name: math.nan})


def test_nan_in_an_array_is_refused_too():
    with pytest.raises(TrocarError, match="interval of TrainingMotion holds NaN"):
        TrainingMotion(np.full(6, np.nan), np.zeros(6), np.ones(6), 30)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PoseErrorField(scale=(math.nan, *PoseErrorField().scale[1:])), "scale of PoseErrorField holds NaN"),
        (lambda: Cables(PSM1_GREY, wander_sd=np.array([math.nan, 0, 0])), "wander_sd of Cables holds NaN"),
        (lambda: Intrinsics(4, 3, 1, 1, 2, 1, (0, 0, math.nan, 0, 0)), "distortion of Intrinsics holds NaN"),
        (lambda: replace(ARM, park_jaw_rad=math.nan), "park_jaw_rad of StationArm holds NaN"),
        (lambda: replace(STATION, min_distance_m=math.nan), "min_distance_m of Station holds NaN"),
        (lambda: replace(PSM1_BOX, step=PSM1_BOX.step * math.nan), "step of a motion's box must be finite"),
        (lambda: replace(PSM1_BOX, lower=PSM1_BOX.lower[:5]), r"lower of a motion's box must have shape \(6,\)"),
        (lambda: suture_joints(PRESETS["default"].setup, [0.0, math.inf]), "positions of sutures must be finite"),
    ],
)
def test_what_is_not_finite_is_named_wherever_it_stands(make, words):
    with pytest.raises(TrocarError, match=words):
        make()


def test_a_function_takes_as_many_values_as_it_has_places_for():
    def one(a, b=2, *, c=3): ...

    assert [takes(one, count) for count in range(4)] == [False, True, True, False]
    assert not takes(lambda *, a: a, 1) and takes(dict, 7)  # of what is written in C, Python knows no signature


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (2.0, ("2.0000", "[-1.0000, 1.5708]")),
        (math.pi / 2 + 1e-6, ("1.570797", "[-1.000000, 1.570796]")),
        (-1.00000001, ("-1.00000001", "[-1.00000000, 1.57079633]")),
        (-1.00004, ("-1.00004", "[-1.00000, 1.57080]")),
        (math.inf, ("inf", "[-1.0000, 1.5708]")),
    ],
)
def test_a_value_just_outside_of_a_range_reads_as_outside(value, shown):
    assert outside(value, -1.0, math.pi / 2) == shown


def test_what_is_a_little_below_zero_is_not_shown_as_zero():
    assert outside(-1e-6, 0.0, 1.0) == ("-0.000001", "[0.000000, 1.000000]")


def test_values_that_differ_in_the_last_bit_end_the_search_too():
    assert outside(np.nextafter(1e-3, 1.0), 0.0, 1e-3)[0] == "0.00100000000000000"
