"""What a report of debridement adds."""

from trocar.tasks.debridement.report.debridement_report import DebridementReport

__all__ = ["DebridementReport"]
