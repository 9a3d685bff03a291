"""Statistics, tables and figures, from saved trials alone.

``trocar.report.files.write_report`` makes all of a run's; suture figures (``trocar.report.sutures``) need no trial.
"""
