"""Files of cable models: what is in them is checked before it is used."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.calibration.models import FORMAT, MODELS, VERSION, load_model, save_model
from trocar.errors import TrocarError
from trocar.files.archive import Archive, read_archive


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
def test_no_array_of_a_file_may_be_missing_or_of_another_shape(name, light, tmp_path):
    path = save_model(light[name], tmp_path / "model.npz")
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
def test_no_array_of_a_file_may_hold_what_is_no_number_of_a_model(name, light, tmp_path):
    path = save_model(light[name], tmp_path / "model.npz")
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
def test_what_a_fit_cannot_have_seen_is_refused(name, light, tmp_path):
    path = save_model(light[name], tmp_path / "model.npz")
    good = path.read_bytes()
    lower, upper = (arrays_in(path)[f"training_{key}"] for key in ("lower", "upper"))
    rewritten(path, training_lower=upper + 1.0, training_upper=lower)
    refused(path, "is damaged: its training motion is none")
    for rows in (0, -5, 3.5, "many", None):
        path.write_bytes(good)
        rewritten(path, {"rows": rows})
        refused(path, "is damaged: its training motion is none")


@pytest.mark.parametrize("joint", [0, 2, 5])
def test_errors_that_no_cable_has_are_refused(light, tmp_path, joint):
    """Not even of one joint, in the middle of the motion that a model was fitted on: a radian at most."""
    model = light["offset"]
    for sign in (1.0, -1.0):
        to = np.where(np.arange(6) == joint, sign, 0.0)
        load_model(save_model(model.shifted(0.99 * to - model.offset), tmp_path / "good.npz"))
        path = save_model(model.shifted(1.01 * to - model.offset), tmp_path / "bad.npz")
        refused(path, "is damaged: the model expects errors that no cable has")


def test_sense_is_asked_of_a_model_where_it_was_fitted(light, tmp_path):
    """A linear map of errors is small there, however large it is elsewhere."""
    model = light["ridge"]
    middle = (model.training.lower + model.training.upper) / 2
    weights = np.zeros((36, 6))
    weights[30:] = 50.0 * np.eye(6)
    path = tmp_path / "model.npz"
    load_model(save_model(replace(model, weights=weights, offset=-50.0 * middle + 0.9), path))
    refused(save_model(replace(model, weights=weights, offset=-50.0 * middle + 1.1), path), "no cable has")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"name": "gru"}, "is of kind 'gru'; this Trocar knows offset, ridge, lstm, play"),
        ({"name": None}, "is of kind 'None'"),
        ({"name": ["play"]}, "is of kind"),
        ({"name": "ridge"}, "is damaged: array '"),
        ({"format": "trocar trial"}, "is a 'trocar trial' of version 2, not a 'trocar cable model' of version 2"),
        ({"version": 1}, "of version 1, not"),
        ({"version": 3}, "of version 3, not"),
    ],
)
def test_a_file_of_another_kind_says_so(light, tmp_path, header, words):
    path = save_model(light["lstm"], tmp_path / "model.npz")
    refused(rewritten(path, header), words)


def test_a_model_belongs_to_the_run_that_it_was_fitted_in(light, tmp_path):
    path = save_model(light["offset"], tmp_path / "model.npz", "this run")
    assert load_model(path, "this run").name == load_model(path).name == "offset"
    refused(path, "belongs to another run; move it away", "another run")
    save_model(light["offset"], path)
    refused(path, "belongs to another run", "this run")


def test_the_same_model_is_the_same_bytes(light, tmp_path):
    for name, model in light.items():
        first, again = (save_model(model, tmp_path / f"{name}{k}.npz").read_bytes() for k in (1, 2))
        assert first == again


def test_unknown_models_and_broken_files_are_one_sentence(tmp_path, light):
    with pytest.raises(TrocarError, match="choose one of offset, ridge, lstm, play"):
        MODELS.pick("gru")
    np.savez(tmp_path / "other.npz", a=1)
    good = save_model(light["play"], tmp_path / "good.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(good[:500])
    (tmp_path / "text.npz").write_text("no model at all")
    spoiled = bytearray(good)
    spoiled[-len(good) // 2] ^= 0xFF
    (tmp_path / "spoiled.npz").write_bytes(spoiled)
    for name in ("none", "other", "cut", "text", "spoiled"):
        refused(tmp_path / f"{name}.npz", "does not exist|is not a (readable )?trocar cable model|is damaged")
    with pytest.raises(TrocarError, match="npz"):
        save_model(light["play"], tmp_path / "model.txt")
    with pytest.raises(TrocarError, match="cannot write"):
        save_model(light["play"], tmp_path / "nowhere" / "model.npz")
