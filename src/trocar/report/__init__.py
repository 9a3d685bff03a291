"""Statistics, tables and figures, from saved trials alone.

``trocar.report.files.write_report`` makes all those of a run.
"""
