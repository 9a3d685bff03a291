"""A prior learned from recordings: how instruments differ, and how one differs from session to session."""

from __future__ import annotations

from collections.abc import Sequence

from trocar.calibration.fleet.loop_fit import fit_loops
from trocar.calibration.fleet.prior import FleetPrior
from trocar.calibration.recording import Recording


def learn_prior(recordings: Sequence[Recording]) -> FleetPrior:
    """Return the prior over instruments and sessions, learned from recordings of some of them.

    Raises:
        TrocarError: they are fewer than two.
    """
    return FleetPrior.of([fit_loops(recording) for recording in recordings])
