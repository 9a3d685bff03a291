"""Calibration of cable-driven wrists: models of cable errors, and commands that compensate them."""
