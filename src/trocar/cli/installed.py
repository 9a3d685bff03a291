"""What is installed: ``trocar doctor``, the methods of a task, and the cable models that runs share."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Annotated, Any

from typer import Argument, Option

from trocar import __version__
from trocar.cli.group import Result
from trocar.cli.options import need
from trocar.extras import EXTRAS, how_to_install

PACKAGES = {"cv2": "opencv-python-headless"}
PURPOSE = {
    "sim": "simulator, cameras, perception",
    "learn": "training the network of `--model lstm`",
    "view": "3D in the browser",
    "parquet": "trials exported as Parquet",
    "lerobot": "trials exported as LeRobot data sets, and such data sets replayed",
    "gym": "environments of Gymnasium",
    "dask": "studies on a cluster",
    "crtk": "robots that speak CRTK over ROS 2, as a client and as a server",
    "bags": "bags of ROS read, trials written as MCAP",
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


def methods(task: Annotated[str, Argument(metavar="TASK", help="Name of a task.")]) -> Result:
    """Print what each method of a task is made of, what it costs before the first trial, and its settings."""
    need("sim")
    from trocar.eval import TASKS, listed_settings, methods_of, pick_method  # NumPy only when needed
    from trocar.eval.prepare import IMAGES_ROWS
    from trocar.eval.staged import plain
    from trocar.lab import load_station
    from trocar.registry import Lazy

    kind = TASKS.pick(task)
    example = kind()
    arms = example.working_arms(example.at(load_station(kind.station)))

    def name_of(thing: Any) -> str:
        if isinstance(thing, Lazy):
            return thing.where
        name = getattr(thing, "__qualname__", None)  # a partial function has none
        return repr(thing) if name is None else f"{thing.__module__}:{name}"

    def shown(value: Any) -> Any:
        found = plain(value)
        if isinstance(found, list | tuple) and all(isinstance(item, int | float) for item in found):
            return ",".join(f"{number:.4g}" for number in found)
        return found if isinstance(found, str | int | float | None) else str(found)

    each = "the arm" if len(arms) == 1 else f"each of {len(arms)} arms"
    fitted = (
        f"a model fitted in each session on {IMAGES_ROWS} images of {each} (about half a minute each; seconds with "
        "--calibration joints), then kept in the cache"
    )
    found: dict[str, dict[str, Any]] = {}
    for name in methods_of(kind):
        method = pick_method(kind, name)
        cables = "encoder readings are taken at face value"
        if method.learns:
            cables = "models that start from a prior are learned in each trial; nothing before the first"
        found[name] = {
            "about": method.about,
            "agent": name_of(method.agent),
            "cables": fitted if method.calibrated else cables,
            "robot": "" if method.wrap_robot is None else f"wrapped by {name_of(method.wrap_robot)}",
            "planner": method.planner,
            "perception": method.perception,
            "settings": {name: shown(value) for name, value in listed_settings(method.make_settings())},
        }
    lines: list[Any] = []
    first, usual = next((name, about["settings"]) for name, about in found.items())
    for name, about in found.items():
        lines.append(f"{name}: {about['about']}")
        parts = ("agent", "cables", "robot", "planner", "perception")
        lines += [f"    {key}: {about[key]}" for key in parts if about[key]]
        own = about["settings"] if name == first else dict(about["settings"].items() - usual.items())
        told = ", ".join(f"{key}={own[key]}" for key in about["settings"] if key in own)
        same = "" if name == first else f"those of {first}" + (", but " if told else "")
        lines += [f"    settings: {same}{told}", ""]
    return Result({"task": task, "methods": found}, [*lines, "change a setting with `trocar run --set NAME=VALUE`"])


def cache(
    *, empty: Annotated[bool, Option("--empty", help="Remove all of them; they are then fitted again.")] = False
) -> Result:
    """List the fitted cable models that runs share, or remove them."""
    need("sim")
    from trocar.eval.prepare import cache_folder, cached_calibrations

    files = cached_calibrations()
    if empty:
        for file in files:
            file.unlink(missing_ok=True)
    summary = {"folder": str(cache_folder()), "files": [file.name for file in files], "removed": empty}
    what = "removed" if empty else "in the cache"
    return Result(summary, [*map(str, files), f"{len(files)} cable models {what}: {cache_folder()}"])
