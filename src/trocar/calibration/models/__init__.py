"""Cable models with a common interface; ``MODELS`` lists them by name."""

from trocar.calibration.models.base import CableModel, TrainingMotion
from trocar.calibration.models.lstm import LstmModel
from trocar.calibration.models.model_file import load_model, save_model
from trocar.calibration.models.offset import OffsetModel
from trocar.calibration.models.play import PlayModel
from trocar.calibration.models.ridge import RidgeModel
from trocar.registry import Registry

MODELS: Registry[type[CableModel]] = Registry(
    "cable model",
    "trocar.cable_models",
    {model.name: model for model in (OffsetModel, RidgeModel, LstmModel, PlayModel)},
)
"""Every cable model by its name on the command line."""

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
