"""What a report of debridement shows besides the usual."""

from trocar.tasks.debridement.report.debridement_report import DebridementReport

__all__ = ["DebridementReport"]
