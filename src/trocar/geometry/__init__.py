"""Rotations, rigid transforms and their fit to points; angles and units."""

from trocar.geometry.angles import TURN
from trocar.geometry.direction import direction
from trocar.geometry.rigid_fit import RigidFit, fit_rigid
from trocar.geometry.se3 import SE3
from trocar.geometry.so3 import SO3
from trocar.geometry.units import shown, shown_scale

__all__ = ["SE3", "SO3", "TURN", "RigidFit", "direction", "fit_rigid", "shown", "shown_scale"]
