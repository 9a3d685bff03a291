"""A session in a laboratory: drawn, registered, with the truth separate from the registration."""

from dataclasses import replace

import numpy as np
import pytest

from simulated import mild
from trocar.lab import built_in_stations, load_station
from trocar.lab.flaws import Difficulty
from trocar.lab.session import draw_session


@pytest.mark.parametrize("name", built_in_stations())
def test_every_station_has_days_that_depend_on_the_seed_alone(name):
    station = load_station(name)
    first, again, other = (draw_session(station, np.random.default_rng(seed)) for seed in (1, 1, 2))
    for arm in list(station.arms)[-1:]:
        bases = [day.T_world_base_registered[arm].matrix for day in (first, again, other)]
        assert np.array_equal(bases[0], bases[1]) and not np.array_equal(bases[0], bases[2])


@pytest.mark.parametrize("name", ["peg-transfer", "suture"])
def test_registration_by_points_is_near_the_truth_and_not_the_truth(name):
    station = mild(name)
    middle = np.mean(station.registration.volume_m, axis=0)
    off_m = []
    for seed in range(30):
        day = draw_session(station, np.random.default_rng(seed))
        for arm in station.arms:
            T_base_found = day.T_world_base_registered[arm].inverse() @ day.T_world_base[arm]
            p_base = day.T_world_base[arm].inverse().apply(middle)
            off_m.append(np.linalg.norm(T_base_found.apply(p_base) - p_base))
    expected_m = station.registration.sd_m * np.sqrt(3 / station.registration.points)
    assert 0.5 * expected_m < np.mean(off_m) < 2.0 * expected_m


def test_a_checkerboard_refers_the_world_to_the_first_base_and_errs_in_camera_and_other_bases():
    station = load_station("raven-pair")
    how = station.registration
    place = how.T_world_board.translation_m
    off = {"left": [], "right": []}
    turned = []
    for seed in range(200):
        day = draw_session(station, np.random.default_rng(seed))
        found, seen = day.T_world_base_registered, day.T_world_camera_registered["stereo"]
        np.testing.assert_allclose(found["left"].matrix, day.T_world_base["left"].matrix, atol=1e-12)
        p_seen = (seen @ day.T_world_camera["stereo"].inverse()).apply(place)
        for arm, rows in off.items():
            p_base = day.T_world_base[arm].inverse().apply(place)
            rows.append(found[arm].inverse().apply(p_seen) - p_base)
        turned.append((day.T_world_base["right"].inverse() @ found["right"]).rotation.log())
    for rows in off.values():  # each board errs by itself
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(rows), axis=0)), how.sd_m, rtol=0.2)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(turned), axis=0)), np.sqrt(2) * how.sd_rad, rtol=0.2)


def test_the_first_camera_is_the_reference_and_the_others_err_against_it():
    station = replace(load_station("suture"), difficulty=Difficulty.of("mild", ["cameras=0.3mm"]))
    off_m = []
    for seed in range(60):
        day = draw_session(station, np.random.default_rng(seed))
        assert day.T_world_camera_registered["overhead"] is day.T_world_camera["overhead"]
        for name in list(station.cameras)[1:]:
            off = day.T_world_camera_registered[name] @ day.T_world_camera[name].inverse()
            assert np.allclose(off.rotation.matrix, np.eye(3))
            off_m.append(off.translation_m)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(off_m), axis=0)), 0.3e-3, rtol=0.2)
    assert abs(np.corrcoef(np.array(off_m).reshape(-1, 6).T)[0, 3]) < 0.4, "each camera errs by itself"


def test_mounting_the_instruments_again_changes_the_cables_and_nothing_else():
    day = draw_session(mild("peg-transfer"), np.random.default_rng(0))
    other = day.remounted(np.random.default_rng(1))
    assert other.T_world_base_registered is day.T_world_base_registered
    offsets = [d.transmissions["psm1"].plant.offset for d in (day, other)]
    assert np.abs(offsets[0] - offsets[1]).max() > 1e-3
    assert np.array_equal(*(d.transmissions["psm1"].plant.K for d in (day, other)))
