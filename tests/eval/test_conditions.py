"""Conditions of a study."""

import pytest

from trocar.errors import TrocarError
from trocar.eval.conditions import chosen


def test_all_that_there_is_is_chosen_by_default():
    assert chosen("", ["a", "b"], "methods") == ["a", "b"]
    assert chosen("b, a", ["a", "b"], "methods") == ["b", "a"]


def test_what_there_is_not_is_refused():
    with pytest.raises(TrocarError, match="--methods names 'c'; choose from a, b"):
        chosen("a,c", ["a", "b"], "methods")
