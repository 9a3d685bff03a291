"""The emergency stop at any time of a real task in which two arms move."""

import numpy as np
import pytest
from bench_emergency import VARIANTS, WHOLE_S, stopped


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("seed", range(3))
def test_two_arms_rest_as_soon_as_their_limits_allow_whenever_the_emergency_stop_is_pressed(variant, seed, tmp_path):
    trial, rest_s, brake_s = stopped(variant, np.random.default_rng(seed).uniform(0.0, WHOLE_S), tmp_path)
    assert (trial.ended, trial.reason) == ("FAULT", "a person pressed the emergency stop")
    assert rest_s <= brake_s + 0.1
    assert max(max(use) for use in trial.command_limit_use.values()) <= 1.001
