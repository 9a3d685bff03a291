"""The imperfections of a laboratory in one sentence; ``summary.json`` and the page list all of them."""

from __future__ import annotations

from collections.abc import Mapping

from trocar.eval.config import FITTED_ON


def brief_flaws(flaws: Mapping[str, str]) -> str:
    """Return the difficulty of a run's laboratory and only what differs from it.

    Args:
        flaws: as in ``summary.json``, with the difficulty's level and the flaws that were given sizes.
    """
    level, *named = flaws["difficulty"].split(", ")
    said = [f"difficulty {level}" + (f" except for {', '.join(named)}" if named else "")]
    said += [f"{what} {how}" for what, how in flaws.items() if how == "switched off"]
    if FITTED_ON in flaws:
        said.append(f"{FITTED_ON} {flaws[FITTED_ON]}")
    return f"laboratory: {'; '.join(said)}; summary.json has the size of every flaw"
