"""Rotations, rigid transforms, and their fit to points."""

from trocar.geometry.rigid_fit import RigidFit, fit_rigid
from trocar.geometry.se3 import SE3
from trocar.geometry.so3 import SO3, skew

__all__ = ["SE3", "SO3", "RigidFit", "fit_rigid", "skew"]
