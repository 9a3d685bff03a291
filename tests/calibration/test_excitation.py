"""Motions for calibration recordings."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import (
    BAND,
    MOST_SAMPLES,
    PSM1_BOX,
    PSM2_BOX,
    WIDE_ROWS,
    MotionBox,
    random_smooth_path,
    slack_taken_up,
    wide_path,
)
from trocar.calibration.models.base import sampling_interval
from trocar.calibration.recording import load_recording
from trocar.errors import TrocarError

WIDEST_PLAY_RAD = 2 * 0.128


def test_the_box_is_that_of_a_recording(recordings):
    q = load_recording(recordings / "dvrk/trajectories/psm1_grey_random.npz").q_cmd
    assert_allclose(PSM1_BOX.lower, q.min(axis=0), atol=0.006)
    assert_allclose(PSM1_BOX.upper, q.max(axis=0), atol=0.006)
    assert_allclose(PSM1_BOX.step, sampling_interval(q), rtol=0.05)


def test_the_other_arms_motion_is_the_mirror_image():
    signs = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    assert_allclose(PSM2_BOX.lower, np.minimum(signs * PSM1_BOX.lower, signs * PSM1_BOX.upper))
    assert_allclose(PSM2_BOX.upper, np.maximum(signs * PSM1_BOX.lower, signs * PSM1_BOX.upper))
    assert_allclose(PSM2_BOX.step, PSM1_BOX.step)
    assert_allclose(PSM2_BOX.mirrored().lower, PSM1_BOX.lower)


def test_a_random_path_fills_its_box_at_the_pace_that_is_asked_for():
    for seed in range(3):
        path = random_smooth_path(PSM_CLASSIC, np.random.default_rng(seed), 1000)
        assert_allclose(path.min(axis=0), PSM1_BOX.lower, atol=1e-12)
        assert_allclose(path.max(axis=0), PSM1_BOX.upper, atol=1e-12)
        assert_allclose(np.abs(np.diff(path, axis=0)).mean(axis=0), PSM1_BOX.step, rtol=0.02)


def test_a_random_path_is_smooth_wanders_and_dwells_in_the_middle(recordings):
    """As the recording that it stands for does, beside which it is measured: reversals, dwelling, slowness."""
    recorded = load_recording(recordings / "dvrk/trajectories/psm1_grey_random.npz").q_cmd
    paths = [random_smooth_path(PSM_CLASSIC, np.random.default_rng(seed), len(recorded)) for seed in range(4)]

    def reversals(q):
        steps = np.diff(q, axis=0)
        return np.mean(steps[1:] * steps[:-1] < 0)

    def dwelling(q):
        return np.mean(q.std(axis=0) / np.ptp(q, axis=0))

    def slowness(q):
        """Share of the motion's power below a reversal in fifty samples."""
        power = np.abs(np.fft.rfft(q - q.mean(axis=0), axis=0)) ** 2
        return np.mean(power[: len(q) // 100].sum(axis=0) / power.sum(axis=0))

    assert np.mean([reversals(q) for q in paths]) == pytest.approx(reversals(recorded), rel=0.25)
    assert np.mean([dwelling(q) for q in paths]) == pytest.approx(dwelling(recorded), rel=0.15)
    assert np.mean([slowness(q) for q in paths]) == pytest.approx(slowness(recorded), abs=0.2)


@pytest.mark.parametrize("rows", [2, 3, 20])
def test_a_short_random_path_goes_through_its_range_once(rows):
    """It cannot fill its box at the pace of a recording; its steps were not numbers."""
    path = random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), rows)
    assert np.isfinite(path).all() and path.shape == (rows, 6)
    assert_allclose(np.ptp(path, axis=0), PSM1_BOX.upper - PSM1_BOX.lower)
    steps = np.diff(path, axis=0)[:, :3]
    assert ((steps > 0).all(axis=0) | (steps < 0).all(axis=0)).all()


def test_a_random_path_is_another_for_each_seed_and_joint():
    one, other = (random_smooth_path(PSM_CLASSIC, np.random.default_rng(seed), 300) for seed in (0, 1))
    assert np.array_equal(one, random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 300))
    share = np.hstack([(q - PSM1_BOX.lower) / (PSM1_BOX.upper - PSM1_BOX.lower) for q in (one, other)])
    assert np.abs(np.corrcoef(share.T) - np.eye(12)).max() < 0.9
    assert BAND[0] < 1.0 < BAND[1]


@pytest.mark.parametrize("box", [PSM1_BOX, PSM2_BOX])
@pytest.mark.parametrize("rows", [2, 35, WIDE_ROWS, 128])
def test_a_wide_path_stays_in_its_box_and_is_the_same_each_time(box, rows):
    path = wide_path(PSM_CLASSIC, rows, box)
    assert path.shape == (rows, 6)
    assert (box.lower <= path).all() and (path <= box.upper).all()
    assert np.array_equal(path, wide_path(PSM_CLASSIC, rows, box))


def test_a_wide_path_swings_the_wrist_through_its_play_and_moves_the_outer_joints_slowly():
    path, smooth = wide_path(PSM_CLASSIC), random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), WIDE_ROWS)
    steps = np.abs(np.diff(path, axis=0))
    assert (np.mean(steps[:, 3:] > WIDEST_PLAY_RAD, axis=0) > 0.75).all()
    assert np.mean(np.abs(np.diff(smooth, axis=0))[:, 3:] > WIDEST_PLAY_RAD) < 0.1
    assert (steps[:, :3].max(axis=0) < 0.15 * (PSM1_BOX.upper - PSM1_BOX.lower)[:3]).all()
    assert (np.ptp(path, axis=0) > 0.9 * (PSM1_BOX.upper - PSM1_BOX.lower)).all()


def test_the_outer_joints_go_to_and_fro_once_twice_and_three_times():
    """From the middle, through both ends of their ranges, and back to where the next cycle would begin."""
    share = (wide_path(PSM_CLASSIC, 240) - PSM1_BOX.lower) / (PSM1_BOX.upper - PSM1_BOX.lower)
    for joint, cycles in enumerate((1, 2, 3)):
        assert_allclose(share[:, joint], 0.5 + 0.5 * np.sin(2 * np.pi * cycles * np.arange(240) / 240), atol=1e-12)


def test_the_wrists_places_fill_its_box_evenly():
    """Of 64, each eighth of the box gets eight."""
    share = (wide_path(PSM_CLASSIC, 64) - PSM1_BOX.lower) / (PSM1_BOX.upper - PSM1_BOX.lower)
    corner = (share[:, 3:] >= 0.5) @ [1, 2, 4]
    assert np.bincount(corner, minlength=8).tolist() == [8] * 8


def test_slack_is_taken_up_by_a_swing_back_and_forth():
    path = wide_path(PSM_CLASSIC, 20)
    commands = slack_taken_up(PSM_CLASSIC, path)
    assert np.array_equal(commands[2:], path) and len(commands) == 22
    there, back = commands[:2] - path[0]
    assert not there[:3].any() and not back[:3].any()
    assert_allclose(there, -back)
    assert (there[3:] > WIDEST_PLAY_RAD).all() and (there[3:] < 2 * WIDEST_PLAY_RAD).all()
    edge = path.copy()
    edge[0] = PSM_CLASSIC.upper
    there, back = slack_taken_up(PSM_CLASSIC, edge)[:2]
    assert_allclose(there, PSM_CLASSIC.upper)
    assert (back[3:] < PSM_CLASSIC.upper[3:] - WIDEST_PLAY_RAD).all()
    assert_allclose(slack_taken_up(PSM_CLASSIC, np.array([PSM_CLASSIC.lower]))[1], PSM_CLASSIC.lower)


def test_a_path_that_is_none_is_refused():
    assert len(random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 2)) == 2
    assert len(wide_path(PSM_CLASSIC, MOST_SAMPLES)) == MOST_SAMPLES
    for path in (wide_path, lambda arm, n: random_smooth_path(arm, np.random.default_rng(0), n)):
        for n in (1, 100_001):
            with pytest.raises(TrocarError, match=f"cannot have {n} samples; ask for 2 to 100000"):
                path(PSM_CLASSIC, n)


def test_a_box_beyond_the_limits_or_without_width_is_refused():
    whole = MotionBox(PSM_CLASSIC.lower, PSM_CLASSIC.upper, PSM1_BOX.step)
    assert_allclose(random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 20, whole).max(axis=0), PSM_CLASSIC.upper)
    for joint in range(6):
        off = 1e-6 * np.eye(6)[joint]
        for box in (
            replace(whole, lower=whole.lower - off),
            replace(whole, upper=whole.upper + off),
            replace(whole, lower=np.where(off > 0, whole.upper, whole.lower)),
        ):
            name = PSM_CLASSIC.joints[joint].name
            with pytest.raises(TrocarError, match=f"joint '{name}' is not inside .*limits of {PSM_CLASSIC.name}"):
                wide_path(PSM_CLASSIC, 10, box)
            with pytest.raises(TrocarError, match="is not inside"):
                random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 10, box)
    with pytest.raises(TrocarError, match="step of a motion's box"):
        MotionBox(PSM1_BOX.lower, PSM1_BOX.upper, np.ones(5))
