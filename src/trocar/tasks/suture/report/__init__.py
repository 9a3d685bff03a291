"""What a report of driven sutures shows besides the usual."""

from trocar.tasks.suture.report.suture_report import SutureReport

__all__ = ["SutureReport"]
