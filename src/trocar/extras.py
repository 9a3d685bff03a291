"""What is optional, and how it is installed."""

from __future__ import annotations

EXTRAS = {
    "sim": ("mujoco", "trio", "cv2"),
    "learn": ("jax", "equinox", "optax"),
    "view": ("viser",),
    "parquet": ("pyarrow",),
    "dask": ("distributed",),
}
"""What each extra of the package installs, by module."""


def how_to_install(extra: str) -> str:
    """Return what to type to have an extra: no index has the package yet."""
    return f"install the extra, in a clone of the project: pip install '.[{extra}]'"
