"""Optional dependencies, named when they are missing."""

from __future__ import annotations

from importlib.util import find_spec

from trocar.errors import TrocarError

EXTRAS = {
    "sim": ("mujoco", "trio", "cv2"),
    "learn": ("jax", "equinox", "optax"),
    "view": ("viser",),
    "parquet": ("pyarrow",),
    "dask": ("distributed",),
}
"""What each extra of the package installs, by module."""


def need(extra: str, *modules: str) -> None:
    """Raise if a module of an extra is not installed."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise TrocarError(
            f"this command needs {', '.join(missing)}; install the extra with: pip install 'trocar[{extra}]'"
        )
