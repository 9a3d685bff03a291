"""A person supervises a cell: watches it, confirms motions, stops it, takes over an arm, or does the whole task."""

from trocar.console.console import Console
from trocar.console.watch import Watch

__all__ = ["Console", "Watch"]
