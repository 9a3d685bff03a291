"""What a report of the peg transfer shows besides the usual."""

from trocar.tasks.peg_transfer.report.peg_report import PegReport

__all__ = ["PegReport"]
