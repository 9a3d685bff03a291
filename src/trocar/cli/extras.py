"""Optional dependencies, named when they are missing."""

from __future__ import annotations

from importlib.util import find_spec

from trocar.errors import TrocarError
from trocar.extras import how_to_install


def need(extra: str, *modules: str) -> None:
    """Raise if a module of an extra is not installed."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise TrocarError(f"this command needs {', '.join(missing)}; {how_to_install(extra)}")
