import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.archive import Archive, read_archive
from trocar.calibration import lstm_training
from trocar.calibration.models import MODELS, load_model, save_model
from trocar.calibration.models.lstm import dense, remember
from trocar.calibration.models.model_file import FORMAT, VERSION
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording, load_recording
from trocar.calibration.session import refit_ends, refit_offset
from trocar.errors import TrocarError

LIMITS_RAD = {
    "psm1_grey": (0.015, 0.027, 0.022),
    "psm2_grey": (0.013, 0.024, 0.020),
    "psm1_new": (0.013, 0.012, 0.012),
}


def walk(seed, n):
    rng = np.random.default_rng(seed)
    steps = rng.normal(0, [0.003, 0.005, 0.0007, 0.03, 0.02, 0.025], (n, 6))
    return np.clip(np.cumsum(np.cumsum(steps, axis=0) * 0.3, axis=0), -1, 1)


def real(recordings, name):
    return load_recording(recordings / f"dvrk/trajectories/{name}.npz")


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(0)
    q = walk(0, 200)
    recording = Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(200, bool), np.arange(200.0))
    epochs, lstm_training.EPOCHS = lstm_training.EPOCHS, 3
    models = {name: kind.fit(recording, np.random.default_rng(1)) for name, kind in MODELS.items()}
    lstm_training.EPOCHS = epochs
    return models


@pytest.mark.parametrize("name", MODELS)
def test_steps_equal_the_whole_history(name, fitted):
    model, q = fitted[name], walk(3, 60)
    state, joints = model.start(q[0]), []
    for row in q:
        again, _ = model.step(state, row)
        joint, state = model.step(state, row)
        assert_allclose(joint, again)
        joints.append(joint)
    single_precision = name == "lstm"
    assert_allclose(joints, model.predict(q), atol=1e-6 if single_precision else 1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_a_file_keeps_the_model(name, fitted, tmp_path):
    path = save_model(fitted[name], tmp_path / "model.npz")
    loaded, q = load_model(path), walk(4, 60)
    assert loaded.name == name
    assert_allclose(loaded.predict(q), fitted[name].predict(q), atol=1e-12)
    assert_allclose(loaded.training.interval, fitted[name].training.interval)
    assert [file.name for file in tmp_path.iterdir()] == ["model.npz"]


@pytest.mark.parametrize("name", MODELS)
def test_every_model_beats_no_model_and_shifts(name, fitted):
    q = walk(0, 200)
    error = PSM1_GREY.run(q) - fitted[name].predict(q)
    assert np.all(error[:, 3:].std(axis=0) < 0.2)
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean((PSM1_GREY.run(q) - q) ** 2))
    shift = np.linspace(-0.1, 0.1, 6)
    moved = fitted[name].shifted(shift).predict(q) - fitted[name].predict(q)
    assert_allclose(moved, np.broadcast_to(shift, q.shape), atol=1e-12)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_play_models_jacobian_is_the_finite_difference(fitted, seed):
    model, q, h = fitted["play"], walk(seed, 30), 1e-6
    state = model.start(q[0])
    for row in q[:-1]:
        _, state = model.step(state, row)
    joints, jacobian = model.linearize(state, q[-1])
    assert_allclose(joints, model.step(state, q[-1])[0], atol=1e-9)
    slack = np.abs(model._bank(state, q[-1])[0] - model._bank(state, q[-1])[1])
    if np.any((np.abs(slack - model.radii) < 1e-5) & (np.abs(slack - model.radii) > 1e-9)):
        return  # at a kink the two sides differ
    columns = []
    for i in (3, 4, 5):
        d = h * np.eye(6)[i]
        sides = [(model.step(state, q[-1] + s * d)[0] - joints)[3:] / (s * h) for s in (1, -1)]
        columns.append(sides)
    numeric = np.array(columns)
    ahead, behind = numeric[:, 0].T, numeric[:, 1].T
    low, high = np.minimum(ahead, behind) - 1e-4, np.maximum(ahead, behind) + 1e-4
    same = np.abs(ahead - behind) < 1e-4
    assert np.all(((jacobian >= low) & (jacobian <= high))[same])


def test_play_extrapolates_by_its_linear_part(fitted):
    model, q = fitted["play"], walk(5, 60)
    far = q + np.array([0, 0, 0, 4.0, 4.0, 4.0])
    assert np.all(np.abs(model.predict(far) - far)[:, 3:] < 2.0)


@pytest.mark.parametrize("name", LIMITS_RAD)
def test_play_meets_its_limits_on_the_last_fifth(name, recordings):
    recording = real(recordings, f"{name}_random")
    rows = int(0.8 * len(recording))
    model = MODELS["play"].fit(recording.first(rows), np.random.default_rng(0))
    error = (model.predict(recording.q_cmd) - recording.q_phy)[recording.scored(rows).valid]
    assert np.all(np.sqrt(np.mean(error**2, axis=0))[3:] <= LIMITS_RAD[name])


def test_refitting_the_offsets_repairs_a_change_of_session(recordings):
    model = MODELS["play"].fit(real(recordings, "psm1_grey_random"), np.random.default_rng(0))
    other = real(recordings, "psm1_grey_pick_place")
    rows = other.scored(refit_ends(other)).valid
    rmse = [
        np.sqrt(np.mean((m.predict(other.q_cmd) - other.q_phy)[rows] ** 2, axis=0))[3:]
        for m in (model, refit_offset(model, other))
    ]
    assert rmse[1][0] < 0.3 * rmse[0][0]
    assert np.all(rmse[1] < (0.03, 0.055, 0.045))


def test_the_network_in_numpy_is_the_one_that_was_trained():
    network = lstm_training.Network(6, 16, 6, jax.random.key(0))
    z = np.random.default_rng(0).normal(size=(20, 6, 6))
    weights = lstm_training._arrays(network)
    ours = dense(weights, remember(weights, z.astype(np.float32))[0])
    assert_allclose(ours, np.asarray(eqx.filter_vmap(network)(z)), atol=1e-6)


# Files.


def rewritten(path, header=None, **arrays):
    """Rewrite a model's file with other values in its header, or other arrays; None takes one out."""
    was = read_archive(path, FORMAT, VERSION)
    kept = {key: value for key, value in {**was.arrays, **arrays}.items() if value is not None}
    path.unlink()  # what is no model is not replaced by one, nor the other way round
    return Archive(was.header | (header or {}), kept).save(path)


def refused(path, words, fingerprint=None):
    with pytest.raises(TrocarError, match=words) as caught:
        load_model(path, fingerprint)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def arrays_in(path):
    return dict(read_archive(path, FORMAT, VERSION).arrays)


@pytest.mark.parametrize("name", MODELS)
def test_no_array_of_a_file_may_be_missing_or_of_another_shape(name, fitted, tmp_path):
    path = save_model(fitted[name], tmp_path / "model.npz")
    good = path.read_bytes()
    assert len(arrays_in(path)) >= 4
    for key, array in arrays_in(path).items():
        wrong = [None, array[None], np.concatenate([array, array], axis=-1) if array.ndim else np.zeros((2, 2))]
        if array.ndim:
            wrong += [array[..., :-1], array[..., :0], array.ravel()[0]]
        for value in wrong:
            rewritten(path, **{key: value})
            refused(path, "is damaged: .*; fit it again")
            path.write_bytes(good)
    load_model(path)


@pytest.mark.parametrize("name", MODELS)
def test_no_array_of_a_file_may_hold_what_is_no_number_of_a_model(name, fitted, tmp_path):
    path = save_model(fitted[name], tmp_path / "model.npz")
    good = path.read_bytes()
    for key, array in arrays_in(path).items():
        if array.dtype.kind != "f":
            continue
        for value in (np.nan, -np.inf, 1e9):
            spoiled = np.array(array)
            spoiled.flat[array.size // 2] = value
            rewritten(path, **{key: spoiled})
            refused(path, "is damaged: .*; fit it again")
            path.write_bytes(good)


@pytest.mark.parametrize("name", MODELS)
def test_what_a_fit_cannot_have_seen_is_refused(name, fitted, tmp_path):
    path = save_model(fitted[name], tmp_path / "model.npz")
    good = path.read_bytes()
    lower, upper = (arrays_in(path)[f"training_{key}"] for key in ("lower", "upper"))
    rewritten(path, training_lower=upper + 1.0, training_upper=lower)
    refused(path, "is damaged: its training motion is none")
    for rows in (0, -5, 3.5, "many", None):
        path.write_bytes(good)
        rewritten(path, {"rows": rows})
        refused(path, "is damaged: its training motion is none")


def test_errors_that_no_cable_has_are_refused(fitted, tmp_path):
    path = save_model(fitted["offset"].shifted(np.full(6, 50.0)), tmp_path / "model.npz")
    refused(path, "is damaged: it expects errors that no cable has")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"name": "gru"}, "is of kind 'gru'; this Trocar knows offset, ridge, lstm, play"),
        ({"name": None}, "is of kind 'None'"),
        ({"name": ["play"]}, "is of kind"),
        ({"name": "ridge"}, "is damaged: it lacks '"),
        ({"format": "trocar trial"}, "is a 'trocar trial' of version 2, not a 'trocar cable model' of version 2"),
        ({"version": 1}, "of version 1, not"),
        ({"version": 3}, "of version 3, not"),
    ],
)
def test_a_file_of_another_kind_says_so(fitted, tmp_path, header, words):
    path = save_model(fitted["lstm"], tmp_path / "model.npz")
    refused(rewritten(path, header), words)


def test_a_model_belongs_to_the_run_that_it_was_fitted_in(fitted, tmp_path):
    path = save_model(fitted["offset"], tmp_path / "model.npz", "this run")
    assert load_model(path, "this run").name == load_model(path).name == "offset"
    refused(path, "belongs to another run; move it away", "another run")
    save_model(fitted["offset"], path)
    refused(path, "belongs to another run", "this run")


def test_the_same_model_is_the_same_bytes(fitted, tmp_path):
    for name, model in fitted.items():
        first, again = (save_model(model, tmp_path / f"{name}{k}.npz").read_bytes() for k in (1, 2))
        assert first == again


def test_unknown_models_and_broken_files_are_one_sentence(tmp_path, fitted):
    with pytest.raises(TrocarError, match="choose one of offset, ridge, lstm, play"):
        MODELS.pick("gru")
    np.savez(tmp_path / "other.npz", a=1)
    good = save_model(fitted["play"], tmp_path / "good.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(good[:500])
    (tmp_path / "text.npz").write_text("no model at all")
    spoiled = bytearray(good)
    spoiled[-len(good) // 2] ^= 0xFF
    (tmp_path / "spoiled.npz").write_bytes(spoiled)
    for name in ("none", "other", "cut", "text", "spoiled"):
        refused(tmp_path / f"{name}.npz", "does not exist|is not a (readable )?trocar cable model|is damaged")
    with pytest.raises(TrocarError, match="npz"):
        save_model(fitted["play"], tmp_path / "model.txt")
    with pytest.raises(TrocarError, match="cannot write"):
        save_model(fitted["play"], tmp_path / "nowhere" / "model.npz")


def test_too_short_recordings_are_refused():
    q = walk(0, 20)
    short = Recording(q, q, np.ones(20, bool), np.arange(20.0))
    for kind in MODELS.values():
        with pytest.raises(TrocarError, match="30"):
            kind.fit(short, np.random.default_rng(0))
    with pytest.raises(TrocarError, match="more"):
        refit_offset(MODELS["offset"](np.zeros(6), None), short)
