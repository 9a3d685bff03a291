"""Directions are unit vectors, whatever the length of the argument."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SO3, direction


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1.0, 1e308])
def test_a_vector_of_any_length_has_a_direction(size):
    np.testing.assert_allclose(direction([size, size, 0.0], "up"), [np.sqrt(0.5), np.sqrt(0.5), 0.0], rtol=1e-15)
    turned = SO3.between([0.0, 0.0, size], [size, 0.0, 0.0]).matrix @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(turned, [1.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("vector", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, 1], ["a", 0, 0]])
def test_what_has_no_direction_is_refused_by_name(vector):
    with pytest.raises(TrocarError, match=r"the way up is .*; give three finite numbers that are not all 0"):
        direction(vector, "the way up")
