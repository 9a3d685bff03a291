"""Plants as play models, recordings of plants, and joints between which they move."""

import numpy as np

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import PlayModel, TrainingMotion
from trocar.calibration.models.play_map import PlayMap
from trocar.calibration.recording import Recording

TRAINING = TrainingMotion(np.full(6, 0.05), np.full(6, -1.0), np.ones(6), 100)
HOME = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2])
FAR = np.array([0.80, 0.10, 0.19, 0.40, 0.30, 0.30])
RESTING = np.zeros(6)


def recorded(plant, rng, rows=1355, name="recording"):
    """Return a recording of a plant along a random smooth path."""
    q = random_smooth_path(PSM_CLASSIC, rng, rows)
    return Recording(q, plant.measure(plant.run(q), rng), np.ones(rows, bool), 0.8 * np.arange(rows), name)


def plant_model(plant):
    """Return the play model that equals a plant: one play operator per joint, and no bumps."""
    linear = np.column_stack([plant.K, plant.C])
    flat = PlayMap(linear, np.arange(3), np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))
    offset = np.concatenate([np.zeros(3), plant.offset])
    return PlayModel(plant.a, plant.b, plant.radii[:, None], offset, np.zeros((3, 6)), flat, TRAINING)
