"""Cable models by name, and their files, whose content is checked before it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trocar.calibration.models.base import CableModel, TrainingMotion, shaped
from trocar.calibration.models.linear import OffsetModel, RidgeModel
from trocar.calibration.models.lstm import LstmModel
from trocar.calibration.models.play import PlayModel
from trocar.calibration.recording import MISDETECTION_RAD, looks_like_recording
from trocar.errors import BadFile, InvalidInput
from trocar.files.archive import Archive, read_archive
from trocar.registry import Registry

__all__ = [
    "MODELS",
    "CableModel",
    "LstmModel",
    "OffsetModel",
    "PlayModel",
    "RidgeModel",
    "TrainingMotion",
    "load_model",
    "save_model",
]

CALLED = ("fit", "predict", "start", "step", "shifted", "arrays", "from_arrays")
"""Methods of a cable model."""


def _require_model(name: str, model: Any) -> None:
    if not isinstance(model, type):
        raise InvalidInput(f"cable model {name!r}", f"is {model!r}", "register a class with what a CableModel has")
    missing = [one for one in CALLED if not callable(getattr(model, one, None))]
    missing += [one for one in ("name", "rate_independent") if not hasattr(model, one)]
    if missing:
        problem = f"has no {', '.join(missing)}"
        raise InvalidInput(f"cable model {name!r}", problem, "give its class what a CableModel has")
    if model.name != name:  # files hold the class's own name
        raise InvalidInput(f"cable model {name!r}", f"has the name {model.name!r}", f"register it as {model.name!r}")


MODELS: Registry[type[CableModel]] = Registry(
    "cable model",
    "trocar.cable_models",
    {model.name: model for model in (OffsetModel, RidgeModel, LstmModel, PlayModel)},
    check=_require_model,
)
"""Every cable model by its name on the command line."""

FORMAT = "trocar cable model"
VERSION = 2


def save_model(model: CableModel, path: str | Path, fingerprint: str = "") -> Path:
    """Write a model to an ``.npz`` file; an interrupted write leaves an older file intact.

    Args:
        model: the model to save.
        path: the file, ending in ``.npz``.
        fingerprint: the model's run, if any.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise BadFile(path, "does not end in .npz", "choose another name", kind="model file")
    training = model.training
    header = {"format": FORMAT, "version": VERSION, "name": model.name, "rows": training.rows, "run": fingerprint}
    motion = {f"training_{key}": getattr(training, key) for key in ("interval", "lower", "upper")}
    return Archive(header, {**motion, **model.arrays()}).save(path)


def load_model(path: str | Path, fingerprint: str | None = None) -> CableModel:
    """Return the model in a file that :func:`save_model` wrote.

    Args:
        path: the file.
        fingerprint: the run that the model must belong to; None: any or none.

    Raises:
        BadFile: the file does not exist, is not a cable model, is damaged, or belongs to another run.
    """
    if looks_like_recording(path):
        raise BadFile(path, "is a recording, not a cable model", "give a file that `calibrate fit` wrote")
    archive = read_archive(path, FORMAT, VERSION)
    name, run, rows = (archive.header.get(key) for key in ("name", "run", "rows"))
    if not isinstance(name, str) or name not in MODELS:
        raise BadFile(path, f"is of kind {str(name)[:40]!r}", f"this Trocar knows {', '.join(MODELS)}", kind="model")
    if fingerprint is not None and run != fingerprint:
        raise BadFile(path, "belongs to another run", "move it away, or choose another folder", kind="model")
    try:
        motion = shaped(archive.arrays, training_interval=(6,), training_lower=(6,), training_upper=(6,))
        if not isinstance(rows, int) or rows < 1 or (motion["training_lower"] > motion["training_upper"]).any():
            raise InvalidInput("its training motion", "is none")
        training = TrainingMotion(*(np.asarray(value, dtype=np.float64) for value in motion.values()), rows=rows)
        model = MODELS[name].from_arrays(archive.arrays, training)
        _require_sense(model)
    except InvalidInput as error:
        raise BadFile(path, f"is damaged: {error}", "fit it again", kind="model") from None
    return model


def _require_sense(model: CableModel) -> None:
    """Raise InvalidInput if a model predicts absurd errors in the middle of its training motion."""
    middle = (model.training.lower + model.training.upper) / 2
    off = model.step(model.start(middle), middle)[0] - middle
    if off.shape != (6,) or not np.isfinite(off).all() or np.abs(off).max() > MISDETECTION_RAD:
        raise InvalidInput("the model", "expects errors that no cable has")
