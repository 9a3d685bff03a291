"""What a report of driven sutures adds."""

from trocar.tasks.suture.report.suture_report import SutureReport

__all__ = ["SutureReport"]
