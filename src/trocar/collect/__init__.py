"""Calibration from images: an arm wears spheres that a camera sees, and moves through random configurations."""
