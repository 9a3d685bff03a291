"""The simulated laboratory."""
