"""Cable models behind one small interface; ``MODELS`` lists them by name."""

from trocar.calibration.models.base import CableModel, TrainingMotion, load_model, save_model
from trocar.calibration.models.lstm import LstmModel
from trocar.calibration.models.offset import OffsetModel
from trocar.calibration.models.play import PlayModel
from trocar.calibration.models.ridge import RidgeModel
from trocar.errors import TrocarError

MODELS: dict[str, type[CableModel]] = {model.name: model for model in (OffsetModel, RidgeModel, LstmModel, PlayModel)}


def model_class(name: str) -> type[CableModel]:
    """Return the class of this name."""
    if name not in MODELS:
        raise TrocarError(f"cable model {name!r} is unknown; choose one of {', '.join(MODELS)}")
    return MODELS[name]


__all__ = [
    "MODELS",
    "CableModel",
    "LstmModel",
    "OffsetModel",
    "PlayModel",
    "RidgeModel",
    "TrainingMotion",
    "load_model",
    "model_class",
    "save_model",
]
