"""Calibration from images: an arm moves through random places, wearing spheres that a camera sees."""
