"""Painted spheres on an instrument, from an image to the joints of the arm."""
