"""A checkerboard in view of a stereo pair: its corners, the pair's lenses, the board's pose (Kehoe et al. 2014,
IV-B)."""
