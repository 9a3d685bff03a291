"""Perception shared by all tasks: images and lenses, depth, colour, fiducials, instruments, needles."""
