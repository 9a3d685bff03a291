import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.calibration.plant import PLANTS, PSM1_GREY, CablePlant, fit_plant
from trocar.calibration.recording import Recording, load_recording
from trocar.errors import TrocarError

RESIDUALS_RAD = {
    "psm1_grey": (0.0170, 0.0302, 0.0220),
    "psm2_grey": (0.0127, 0.0224, 0.0184),
    "psm1_new": (0.0135, 0.0090, 0.0115),
}
"""What the identified plants leave on the recordings (facts: .012-.016, .009-.029, .011-.020), and 3 %."""


def walk(seed, n=80):
    rng = np.random.default_rng(seed)
    return np.clip(np.cumsum(rng.normal(0, 0.08, (n, 6)), axis=0), -1, 1)


def residual(plant, recording):
    error = (plant.run(recording.q_cmd) - recording.q_phy)[recording.valid]
    return np.sqrt(np.mean(error**2, axis=0))[3:]


@pytest.mark.parametrize("name", PLANTS)
def test_presets_reproduce_the_recordings(name, recordings):
    recording = load_recording(recordings / f"dvrk/trajectories/{name}_random.npz")
    assert np.all(residual(PLANTS[name], recording) <= RESIDUALS_RAD[name])


@pytest.mark.parametrize("name", PLANTS)
def test_a_fit_reproduces_the_recordings_as_well_as_the_presets(name, recordings):
    recording = load_recording(recordings / f"dvrk/trajectories/{name}_random.npz")
    fitted = fit_plant(recording)
    assert np.all(residual(fitted, recording) <= RESIDUALS_RAD[name])
    total = np.prod(residual(fitted, recording)) / np.prod(residual(PLANTS[name], recording))
    assert total < 1.005


def test_a_fit_finds_the_plant_that_made_the_recording():
    q = np.clip(np.cumsum(np.random.default_rng(0).normal(0, 0.08, (600, 6)), axis=0), -1.2, 1.2)
    rng = np.random.default_rng(1)
    measured = PSM1_GREY.run(q) + 1e-3 * rng.standard_normal(q.shape)
    fitted = fit_plant(Recording(q, measured, np.ones(600, bool), np.arange(600.0)))
    assert_allclose(fitted.radii, PSM1_GREY.radii, atol=0.004)
    assert_allclose(fitted.offset, PSM1_GREY.offset, atol=0.002)
    assert_allclose(fitted.C, PSM1_GREY.C, atol=0.03)
    assert_allclose(fitted.run(q), PSM1_GREY.run(q), atol=0.005)


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(sorted(PLANTS)))
def test_steps_equal_the_run(seed, name):
    plant, q = PLANTS[name], walk(seed)
    state, joints = plant.start(q[0]), []
    for row in q:
        joint, state = plant.step(state, row)
        joints.append(joint)
    assert_allclose(joints, plant.run(q), atol=1e-14)


@given(seed=st.integers(0, 2**32 - 1))
def test_outer_joints_are_exact_and_offsets_shift(seed):
    q = walk(seed)
    assert_allclose(PSM1_GREY.run(q)[:, :3], q[:, :3])
    shift = np.array([0.01, -0.02, 0.03])
    moved = PSM1_GREY.with_offset(PSM1_GREY.offset + shift).run(q)
    assert_allclose((moved - PSM1_GREY.run(q))[:, 3:], np.broadcast_to(shift, (len(q), 3)), atol=1e-14)


def test_slack_of_pitch_leaks_into_yaw():
    q = np.zeros((200, 6))
    q[:, 4] = 0.5 * np.sin(np.linspace(0, 4 * np.pi, 200))
    yaw = PSM1_GREY.run(q)[50:, 5]
    assert np.ptp(yaw) > 0.05


def test_noise_has_the_recorded_sd():
    q = np.zeros((20000, 6))
    noise = PSM1_GREY.measure(q, np.random.default_rng(0)) - q
    assert_allclose(noise.std(axis=0), PSM1_GREY.noise_sd, rtol=0.03)


@pytest.mark.parametrize(
    "change",
    [{"radii": [0.1, 0.1]}, {"K": np.zeros((2, 3))}, {"offset": [0, np.nan, 0]}, {"radii": [-1, 0, 0]}],
)
def test_bad_plants_are_refused(change):
    good = {key: getattr(PSM1_GREY, key) for key in PSM1_GREY.__dataclass_fields__}
    with pytest.raises(TrocarError):
        CablePlant(**(good | change))
