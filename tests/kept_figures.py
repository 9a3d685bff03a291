"""Figures that tests look at, and that nobody writes."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from trocar.report import style


def kept_figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Return the list to which each figure of a report is added once it is drawn; its file is made, and empty."""
    kept: list[Figure] = []
    monkeypatch.setattr(style, "write_figure", lambda path, drawn, **_: kept.append(drawn) or path.touch())
    return kept
