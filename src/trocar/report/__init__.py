"""Statistics, tables and figures, from saved trials alone."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.report.paths import draw_paths
    from trocar.report.run_files import load_trials, write_report
    from trocar.report.statistics import Spread, wilson_interval
    from trocar.report.storyboard import draw_storyboard
    from trocar.report.summary import summarise
    from trocar.report.tables import driven_table, parts_table, run_table
    from trocar.report.timechart import draw_timechart

__all__ = [
    "Spread",
    "draw_paths",
    "draw_storyboard",
    "draw_timechart",
    "driven_table",
    "load_trials",
    "parts_table",
    "run_table",
    "summarise",
    "wilson_interval",
    "write_report",
]

_MODULES = {
    "Spread": "statistics",
    "draw_paths": "paths",
    "draw_storyboard": "storyboard",
    "draw_timechart": "timechart",
    "driven_table": "tables",
    "load_trials": "run_files",
    "parts_table": "tables",
    "run_table": "tables",
    "summarise": "summary",
    "wilson_interval": "statistics",
    "write_report": "run_files",
}


def __getattr__(name: str) -> Any:
    """Import a name when it is first asked for: suture figures need no extra, those of trials do."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
