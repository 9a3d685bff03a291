"""A film's frames lie on a clock, and a body is updated before its displacement becomes visible."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay, still_replay
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.replay import Replay, Solid
from trocar.view.film import STILL_M, STILL_RAD, shoot


def one_body(times_s, T):
    solid = Solid("ball", "sphere", (0.01,), SE3.identity(), (1.0, 1.0, 1.0, 1.0))
    return Replay("one body", np.asarray(times_s), (solid,), {"ball": T})


def wandering(seed, n=400):
    """A body that rests, creeps, jitters and leaps."""
    rng = np.random.default_rng(seed)
    speed = rng.choice([0.0, 1e-8, 1e-6, 1e-5, 1e-3, 0.05], size=(n, 2))  # of its way and its turning
    steps = np.cumsum(np.repeat(speed, 3, axis=1) * rng.normal(size=(n, 6)), axis=0)
    return one_body(0.01 * np.arange(n), SE3.from_parts(SO3.exp(steps[:, 3:]), steps[:, :3]))


@pytest.mark.parametrize("rate_hz", [30.0, 12.0, 7.5, 1.0])
def test_frames_are_the_ticks_nearest_to_a_clock_and_the_last(rate_hz):
    replay = made_up_replay(4.0)
    film = shoot(replay, [rate_hz])
    assert film.rate_hz == rate_hz
    assert_allclose(film.times_s, replay.times_s[film.ticks])
    assert film.ticks[0] == 0
    assert film.ticks[-1] == len(replay.times_s) - 1
    clock = np.arange(0.0, 4.0, 1 / rate_hz)
    assert_allclose(film.times_s[: len(clock)], clock, atol=0.5 * 0.01 + 1e-9)


def test_a_clock_finer_than_the_ticks_takes_each_tick_once_be_it_a_single_one():
    assert shoot(wandering(0), [1000.0]).ticks.tolist() == list(range(400))
    film = shoot(one_body([0.0], SE3.identity((1,))))
    assert film.ticks.tolist() == [0] and film.moved.tolist() == [[True]]


def test_only_bodies_that_can_move_and_are_seen_are_in_the_film():
    replay = made_up_replay(1.0)
    film = shoot(replay)
    assert "world" not in film.bodies
    assert "psm1_link2" not in film.bodies
    assert {"block0", "block5", "psm1_link4", "psm2_finger_left"} <= set(film.bodies)
    lying = film.moved[film.bodies.index("block5")]
    assert lying.tolist() == [True] + [False] * (len(film.ticks) - 1)
    assert shoot(still_replay()).bodies == ()


@given(seed=st.integers(0, 2**32 - 1))
def test_a_body_that_is_not_moved_is_nearly_where_it_was_put(seed):
    film = shoot(wandering(seed))
    put = np.maximum.accumulate(np.where(film.moved[0], np.arange(len(film.ticks)), 0))
    away = np.linalg.norm(film.position_m[0] - film.position_m[0, put], axis=1)
    now, then = SO3.from_quaternion(film.wxyz[0]), SO3.from_quaternion(film.wxyz[0, put])
    turned = np.linalg.norm((then.inverse() @ now).log(), axis=1)
    assert (STILL_M, STILL_RAD) == (20e-6, 100e-6)
    assert away.max() <= STILL_M * (1 + 1e-9)
    assert turned.max() <= STILL_RAD * (1 + 1e-6)


@given(seed=st.integers(0, 2**32 - 1))
def test_quaternions_do_not_change_sign_on_the_way(seed):
    spin = np.random.default_rng(seed).normal(size=3)
    turns = np.linspace(0.0, 20.0, 500)[:, None] * spin / np.linalg.norm(spin)
    film = shoot(one_body(0.01 * np.arange(500), SE3.from_parts(SO3.exp(turns), np.zeros((500, 3)))))
    assert (np.einsum("ij,ij->i", film.wxyz[0, 1:], film.wxyz[0, :-1]) > 0).all()
    assert_allclose(SO3.from_quaternion(film.wxyz[0]).matrix, SO3.exp(turns).matrix[film.ticks], atol=1e-9)


@settings(max_examples=20)
@given(share=st.floats(0.05, 1.2))
def test_the_finest_rate_is_taken_that_keeps_to_the_number_of_poses(share):
    replay, rates = wandering(3), (30.0, 20.0, 10.0, 5.0, 1.0)
    counts = [shoot(replay, [rate]).moved.sum() for rate in rates]
    most = int(share * counts[0])
    fits = [rate for rate, count in zip(rates, counts, strict=True) if count <= most]
    assert shoot(replay, rates, most).rate_hz == (fits[0] if fits else 1.0)


def test_the_frame_at_a_time_is_the_last_before_it():
    film = shoot(made_up_replay(1.0))
    for frame, time_s in enumerate(film.times_s):
        assert film.frame_at(time_s) == frame
        assert film.frame_at(time_s + 1e-3) == frame
    assert film.frame_at(-5.0) == 0
    assert film.frame_at(99.0) == len(film.ticks) - 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"times_s": np.zeros(0)}, "a replay without times cannot be shown"),
        ({"T_world_body": {"ball": SE3.identity((7,))}}, r"body 'ball' has poses \(7, 4, 4\); give one, or one for"),
        ({"T_world_body": {"bat": SE3.identity()}}, "no pose of body 'ball'; the replay has bat"),
    ],
)
def test_what_does_not_fit_together_is_told(change, sentence):
    with pytest.raises(TrocarError, match=sentence):
        shoot(replace(wandering(0), **change))
