"""Cable models with a common interface; ``MODELS`` lists them by name."""

from trocar.calibration.models.base import CableModel, TrainingMotion
from trocar.calibration.models.files import MODELS, load_model, save_model
from trocar.calibration.models.linear import OffsetModel, RidgeModel
from trocar.calibration.models.lstm import LstmModel
from trocar.calibration.models.play import PlayModel

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
