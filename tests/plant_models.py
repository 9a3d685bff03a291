"""Play models that are plants: one operator a joint, and no bumps."""

import numpy as np

from trocar.calibration.models import PlayModel, TrainingMotion
from trocar.calibration.models.play_map import PlayMap

TRAINING = TrainingMotion(np.full(6, 0.05), np.full(6, -1.0), np.ones(6), 100)


def plant_model(plant):
    """Return the play model whose joints are those of a plant."""
    linear = np.column_stack([plant.K, plant.C])
    flat = PlayMap(linear, np.arange(3), np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))
    offset = np.concatenate([np.zeros(3), plant.offset])
    return PlayModel(plant.a, plant.b, plant.radii[:, None], offset, np.zeros((3, 6)), flat, TRAINING)
