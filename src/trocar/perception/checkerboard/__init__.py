"""A checkerboard seen by a stereo pair: its corners, the lenses, the board's pose (Kehoe et al. 2014, IV-B)."""
