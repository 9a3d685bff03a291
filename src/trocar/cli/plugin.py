"""``--plugin FILE``."""

from trocar.cli.options import Plugins, load_given

__all__ = ["Plugins", "load_given"]
