"""What instruments have in common: a prior over their cables, and fits that start from it."""

from trocar.calibration.fleet.fit import Learned, expected, fit_from_prior, learn_from
from trocar.calibration.fleet.prior import FleetPrior, learn_prior, load_prior

__all__ = ["FleetPrior", "Learned", "expected", "fit_from_prior", "learn_from", "learn_prior", "load_prior"]
