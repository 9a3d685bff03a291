"""``trocar doctor``: what is installed, what is missing, what to type next."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from trocar import __version__
from trocar.cli.group import Result
from trocar.extras import EXTRAS, how_to_install

PACKAGES = {"cv2": "opencv-python-headless"}
PURPOSE = {
    "sim": "simulator, cameras, perception",
    "learn": "training the network of `--model lstm`",
    "view": "3D in the browser",
    "parquet": "trials exported as Parquet",
    "dask": "studies on a cluster",
}


def doctor() -> Result:
    """List what is installed, which optional parts are missing, and what to type next."""
    lines = [
        f"trocar {__version__}, Python {platform.python_version()} on {platform.platform(terse=True)}",
        "core: kinematics, calibration, motion - ready",
    ]
    extras = {extra: {name: _version(name) for name in modules} for extra, modules in EXTRAS.items()}
    for extra, found in extras.items():
        missing = [module for module, number in found.items() if number is None]
        ready = ", ".join(f"{module} {number}" for module, number in found.items() if number is not None)
        state = "ready" if not missing else f"missing {', '.join(missing)}: {how_to_install(extra)}"
        lines.append(f"{extra}: {PURPOSE[extra]} - {state}" + (f" ({ready})" if ready else ""))
    example = "calibrate --help" if None in extras["sim"].values() else "run peg-transfer --trials 1 --out out/first"
    about = {"trocar": __version__, "python": platform.python_version(), "platform": platform.platform()}
    return Result({**about, "extras": extras}, [*lines, f"next: trocar {example}"])


def _version(module: str) -> str | None:
    """Return the version of a module; None if it is not there."""
    if find_spec(module) is None:
        return None
    try:
        return version(PACKAGES.get(module, module))
    except PackageNotFoundError:
        return "(no version)"
