"""``trocar doctor``: what is installed, what is missing, what to type next."""

from __future__ import annotations

import json
import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Annotated

import typer

from trocar import __version__
from trocar.extras import EXTRAS, how_to_install

PACKAGES = {"cv2": "opencv-python-headless"}
PURPOSE = {
    "sim": "simulator, cameras, perception",
    "learn": "training the network of `--model lstm`",
    "view": "3D in the browser",
    "parquet": "trials exported as Parquet",
    "dask": "studies on a cluster",
}


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List what is installed, which optional parts are missing, and what to type next."""
    if as_json:
        extras = {extra: {name: _installed(name) for name in modules} for extra, modules in EXTRAS.items()}
        said = {"trocar": __version__, "python": platform.python_version(), "platform": platform.platform()}
        typer.echo(json.dumps({**said, "extras": extras}))
        return
    typer.echo(f"trocar {__version__}, Python {platform.python_version()} on {platform.platform(terse=True)}")
    typer.echo("core: kinematics, calibration, motion - ready")
    ready = {}
    for extra, modules in EXTRAS.items():
        missing = [module for module in modules if find_spec(module) is None]
        ready[extra] = not missing
        found = ", ".join(f"{module} {_version(module)}" for module in modules if module not in missing)
        state = "ready" if not missing else f"missing {', '.join(missing)}: {how_to_install(extra)}"
        typer.echo(f"{extra}: {PURPOSE[extra]} - {state}" + (f" ({found})" if found else ""))
    example = "trocar run peg-transfer --trials 1 --out out/first" if ready["sim"] else "trocar calibrate --help"
    typer.echo(f"next: {example}")


def _installed(module: str) -> str | None:
    """Return the version of a module; None if it is not there."""
    return None if find_spec(module) is None else _version(module)


def _version(module: str) -> str:
    try:
        return version(PACKAGES.get(module, module))
    except PackageNotFoundError:
        return "(no version)"
