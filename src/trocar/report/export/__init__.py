"""Trials as flat tables, for any program that reads CSV or Parquet."""

from trocar.report.export.export import FORMATS, Written, export_trials

__all__ = ["FORMATS", "Written", "export_trials"]
