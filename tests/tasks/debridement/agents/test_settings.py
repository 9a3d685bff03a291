"""The settings that are not ours to choose: those of the paper, of its program and of the methods' names."""

from dataclasses import replace

import pytest

from trocar.lab import load_station
from trocar.tasks.debridement.agents.settings import best, paper, slow

PAPER = {
    "tip_speed_m_s": 0.010,
    "step_m": 0.025,  # V-B
    "lift_m": 0.050,
    "open_rad": 1.2,
    "close_s": 2.5,
    "vision_lag_s": 2.0,
    "watch_s": 0.25,
    "reached_m": 0.008,
    "reached_high_m": 0.008,
    "reached_low_m": 0.008,
    "close_m": 0.015,
    "max_visits": 7,
    "arrived_m": 0.006,
    "apart_m": 0.030,
}
"""As published, or in the authors' program."""


def test_the_paper_s_method_has_the_numbers_of_the_paper_and_its_program():
    settings = paper()
    assert {name: getattr(settings, name) for name in PAPER} == PAPER
    assert 2.1 <= settings.plan_budget_s <= 2.7, "as long as its plans took"
    assert settings.centralised and settings.token and not settings.ahead and not settings.flows


def test_plans_of_the_paper_s_method_keep_half_a_millimetre_more_than_the_guard():
    guarded_m = load_station("raven-pair").min_distance_m
    assert guarded_m == pytest.approx(0.001), "the paper's margin (V-B)"
    assert paper().margin_m == pytest.approx(guarded_m + 0.0005) and best().margin_m > paper().margin_m


def test_best_goes_five_centimetres_a_second_and_its_slow_twin_differs_in_nothing_but_speed():
    assert best().tip_speed_m_s == 0.05 and best().descent_speed_m_s < best().tip_speed_m_s
    assert slow() == replace(best(), tip_speed_m_s=0.01, descent_speed_m_s=0.01)
