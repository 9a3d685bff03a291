"""Optional dependencies, and how to install them."""

from __future__ import annotations

EXTRAS = {
    "sim": ("mujoco", "trio", "cv2"),
    "learn": ("jax", "equinox", "optax"),
    "view": ("viser",),
    "parquet": ("pyarrow",),
    "lerobot": ("pyarrow", "av"),
    "gym": ("gymnasium",),
    "dask": ("distributed",),
    "crtk": ("cyclonedds",),
    "bags": ("rosbags", "mcap"),
}
"""The modules that each extra of the package installs."""


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra; the package is not on an index yet."""
    return f"install the extra, in a clone of the project: pip install -e '.[{extra}]'"
