"""What a report of the peg transfer adds."""

from trocar.tasks.peg_transfer.report.peg_report import PegReport

__all__ = ["PegReport"]
