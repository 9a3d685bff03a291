"""What instruments have in common: a prior over their cables, and fits that start from it."""

from trocar.calibration.fleet.fit import Learned, expected, fit_from_prior, learn_from
from trocar.calibration.fleet.learn import learn_prior
from trocar.calibration.fleet.prior import FleetPrior, load_prior

__all__ = ["FleetPrior", "Learned", "expected", "fit_from_prior", "learn_from", "learn_prior", "load_prior"]
