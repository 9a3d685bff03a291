"""Whole turns, written once."""

import math

TURN = 2 * math.pi
"""One whole turn, in rad."""
