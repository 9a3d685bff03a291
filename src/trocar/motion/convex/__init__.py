"""Collision-free motions of one arm or several by sequential convex programs (Schulman et al. 2013)."""

from trocar.motion.convex.planner import convex

__all__ = ["convex"]
