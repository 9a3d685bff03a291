"""Optional dependencies."""

from trocar.cli.options import need

__all__ = ["need"]
