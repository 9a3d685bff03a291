"""What a set-up of the cell fixes, and what it leaves."""

from dataclasses import fields

import numpy as np

from trocar.geometry import SE3
from trocar.sim.session import DRIFT_SD_RAD, T_WORLD_BASE, draw_session

OVER_THE_BOARD_M = np.array([(x, y, z) for x in (-0.05, 0.05) for y in (-0.03, 0.03) for z in (0.0, 0.05)])


def test_the_registration_is_nearly_right_and_never_exact():
    for seed in range(20):
        session = draw_session(np.random.default_rng(seed))
        for arm, T_true in session.T_world_base.items():
            T_error = session.T_world_base_found[arm] @ T_true.inverse()
            miss_m = np.linalg.norm(T_error.apply(OVER_THE_BOARD_M) - OVER_THE_BOARD_M, axis=1)
            assert 1e-6 < miss_m.max() < 0.2e-3
            assert 0.0 < np.degrees(np.linalg.norm(T_error.rotation.log())) < 0.2


def test_the_next_session_changes_the_offsets_of_the_cables_alone():
    first = draw_session(np.random.default_rng(0))
    second = first.redrawn(np.random.default_rng(1))
    assert second.arms is first.arms
    assert second.T_world_base is first.T_world_base
    assert second.T_world_base_found is first.T_world_base_found
    for arm, plant in first.plants.items():
        other = second.plants[arm]
        for field in fields(plant):
            same = np.array_equal(getattr(plant, field.name), getattr(other, field.name))
            assert same == (field.name != "offset"), field.name


def test_offsets_drift_by_what_was_seen_between_sessions():
    session = draw_session(np.random.default_rng(0))
    rng = np.random.default_rng(5)
    offsets = np.array([session.redrawn(rng).plants["psm2"].offset for _ in range(400)])
    assert np.allclose(offsets.std(axis=0), DRIFT_SD_RAD, rtol=0.15)


def test_the_arms_reach_over_the_board_from_both_sides():
    for sign, name in ((1.0, "psm1"), (-1.0, "psm2")):
        T = T_WORLD_BASE[name]
        assert isinstance(T, SE3)
        assert np.sign(T.translation_m[0]) == sign
        assert T.translation_m[2] > 0.1
