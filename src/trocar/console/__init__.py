"""A person beside a cell: watches it, says yes, stops it, takes an arm over, or does the whole task."""

from trocar.console.console import Console
from trocar.console.watch import Watch

__all__ = ["Console", "Watch"]
