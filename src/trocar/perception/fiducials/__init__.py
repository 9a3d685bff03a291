"""Painted spheres on an instrument: from images to the joints of the arm."""
