"""Calibration of cable-driven wrists: models of cable errors, and commands that compensate for them."""
