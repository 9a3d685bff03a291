"""Statistics, tables and figures, from saved trials alone."""

from trocar.report.paths import draw_paths
from trocar.report.run_files import load_trials, write_report
from trocar.report.statistics import Spread, wilson_interval
from trocar.report.storyboard import draw_storyboard
from trocar.report.summary import summarise
from trocar.report.tables import parts_table, run_table
from trocar.report.timechart import draw_timechart

__all__ = [
    "Spread",
    "draw_paths",
    "draw_storyboard",
    "draw_timechart",
    "load_trials",
    "parts_table",
    "run_table",
    "summarise",
    "wilson_interval",
    "write_report",
]
