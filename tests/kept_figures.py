"""Figures of reports, kept for tests to inspect instead of being written."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from trocar.report import style


def kept_figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Return a list that receives each figure of a report once it is drawn; the figure's file is created empty."""
    kept: list[Figure] = []
    monkeypatch.setattr(style, "write_figure", lambda path, drawn, **_: kept.append(drawn) or path.touch())
    return kept
