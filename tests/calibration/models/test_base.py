import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.models.base import MIN_ROWS, TrainingMotion, commands, shaped
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk


def recorded(rows, valid):
    q = walk(0, rows)
    return Recording(q, q + 0.1, valid, np.arange(float(rows)), "mine")


def test_a_training_motion_ends_with_its_last_good_row():
    valid = np.ones(80, bool)
    valid[[3, 4, 70, 71, 72, 73, 74, 75, 76, 77, 78, 79]] = False
    recording = recorded(80, valid)
    motion, q = TrainingMotion.of(recording), recording.q_cmd[:70]
    assert motion.rows == 68
    assert_allclose(motion.lower, q.min(axis=0))
    assert_allclose(motion.upper, q.max(axis=0))
    assert_allclose(motion.interval, np.abs(np.diff(q, axis=0)).mean(axis=0))


def test_so_few_rows_suffice_and_fewer_do_not():
    assert TrainingMotion.of(recorded(40, np.arange(40) >= 40 - MIN_ROWS)).rows == MIN_ROWS
    with pytest.raises(TrocarError, match=r"mine has 29 valid rows of 40 \(11 are marked .*\); a fit needs 30 or more"):
        TrainingMotion.of(recorded(40, np.arange(40) >= 11))


def test_a_training_motion_shows_the_wrists_ranges_in_degrees():
    lower, upper = np.radians([-1.0, -2.0, -3.0, -40.0, -50.0, -60.0]), np.radians([1.0, 2.0, 3.0, 10.0, 20.0, 30.0])
    motion = TrainingMotion(np.full(6, 0.01), lower, upper, 123)
    assert repr(motion) == "<TrainingMotion of 123 rows: q4 q5 q6 from -40 to 10, -50 to 20, -60 to 30 deg>"


@pytest.mark.parametrize("shape", [(6,), (3, 5), (3, 7), (2, 3, 6)])
def test_commands_are_rows_of_six(shape):
    assert commands(np.ones((3, 6), int)).dtype == np.float64
    with pytest.raises(TrocarError, match=r"must have shape \(n, 6\)"):
        commands(np.ones(shape))
    with pytest.raises(TrocarError, match="must be finite"):
        commands([[0.0, 0.0, np.inf, 0.0, 0.0, 0.0]])


def good():
    return {"offset": np.zeros(6), "radii": np.ones((3, 4)), "linear": np.ones((5, 4)), "scale": np.ones(2)}


SHAPES = {"offset": (6,), "radii": (3, "k"), "linear": ("d", "k"), "scale": ("p",)}


def test_arrays_of_any_length_agree_where_their_letters_do():
    assert shaped(good(), **SHAPES).keys() == good().keys()
    assert shaped(good() | {"linear": np.zeros((0, 4))}, **SHAPES)["linear"].shape == (0, 4)
    for name, value in (
        ("offset", np.zeros(5)),
        ("radii", np.ones((4, 4))),
        ("linear", np.ones((5, 3))),
        ("linear", np.ones(4)),
        ("linear", np.array(1.0)),
        ("scale", np.ones((2, 1))),
    ):
        with pytest.raises(TrocarError, match=rf"'{name}' has shape .*, not \("):
            shaped(good() | {name: value}, **SHAPES)
    with pytest.raises(TrocarError, match="array 'radii' is missing"):
        shaped({key: value for key, value in good().items() if key != "radii"}, **SHAPES)


@pytest.mark.parametrize("name", ["offset", "scale"])
def test_numbers_of_a_model_are_finite_and_not_absurd(name):
    def with_number(number):
        value = good()[name].copy()
        value[-1] = number
        return shaped(good() | {name: value}, **SHAPES)

    for number in (0.0, -1e6, 1e6):
        assert with_number(number)[name][-1] == number
    for number in (np.nan, -np.inf, 1.001e6, -1.001e6):
        with pytest.raises(TrocarError, match=f"'{name}' holds numbers that no model can have"):
            with_number(number)
    if name == "scale":  # of what never moved
        assert with_number(np.inf)[name][-1] == np.inf
    else:
        with pytest.raises(TrocarError, match="no model can have"):
            with_number(np.inf)


def test_texts_are_no_numbers():
    with pytest.raises(TrocarError, match="'scale' holds numbers that no model can have"):
        shaped(good() | {"scale": np.array(["1", "2"])}, **SHAPES)
    for kind in (bool, np.uint8, int, np.float32):
        assert shaped(good() | {"scale": np.ones(2, kind)}, **SHAPES)["scale"].dtype == kind
