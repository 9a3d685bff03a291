"""The simulator as a backend of ``build_cell``."""

from __future__ import annotations

import numpy as np

from trocar.lab import Station
from trocar.lab.session import draw_session
from trocar.sim.laboratory import SimLaboratory


def simulated(station: Station, rng: np.random.Generator) -> SimLaboratory:
    """Return a simulated laboratory in a session drawn from the generator, with nothing on its table."""
    return SimLaboratory(draw_session(station, rng), rng=rng)
