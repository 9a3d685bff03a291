"""Rotations, rigid transforms and their fit to points; checked arrays and units."""

from trocar.geometry.arrays import TURN, direction, shown, shown_scale
from trocar.geometry.rigid_fit import RigidFit, fit_rigid
from trocar.geometry.se3 import SE3
from trocar.geometry.so3 import SO3, steady

__all__ = ["SE3", "SO3", "TURN", "RigidFit", "direction", "fit_rigid", "shown", "shown_scale", "steady"]
