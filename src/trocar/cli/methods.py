"""``trocar methods TASK``: what each method is made of, and what it costs; ``trocar calibrate cache``."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from trocar.cli.group import Result
from trocar.cli.options import need
from trocar.eval import TASKS, Method, listed_settings, methods_of, pick_method
from trocar.registry import Lazy


def methods(task: Annotated[str, typer.Argument(metavar="TASK", help="Name of a task.")]) -> Result:
    """Print what each method of a task is made of, what it costs before the first trial, and its settings."""
    need("sim", "mujoco", "trio", "cv2")
    from trocar.lab import load_station

    kind = TASKS.pick(task)
    example = kind()
    arms = example.working_arms(example.at(load_station(kind.station)))
    found = {name: _described(pick_method(kind, name), len(arms)) for name in methods_of(kind)}
    lines: list[Any] = []
    first, usual = next((name, about["settings"]) for name, about in found.items())
    for name, about in found.items():
        lines.append(f"{name}: {about['about']}")
        lines += [
            f"    {key}: {about[key]}" for key in ("agent", "cables", "robot", "planner", "perception") if about[key]
        ]
        own = about["settings"] if name == first else dict(about["settings"].items() - usual.items())
        told = ", ".join(f"{key}={own[key]}" for key in about["settings"] if key in own)
        same = "" if name == first else f"those of {first}" + (", but " if told else "")
        lines += [f"    settings: {same}{told}", ""]
    return Result({"task": task, "methods": found}, [*lines, "change a setting with `trocar run --set NAME=VALUE`"])


def _described(method: Method, arms: int) -> dict[str, Any]:
    from trocar.eval.prepare import IMAGES_ROWS  # the simulator is heavy

    cables = "encoder readings are taken at face value"
    if method.learns:
        cables = "models that start from a prior are learned in each trial; nothing before the first"
    if method.calibrated:
        each = "the arm" if arms == 1 else f"each of {arms} arms"
        cables = (
            f"a model fitted in each session on {IMAGES_ROWS} images of {each} (about half a minute each; seconds with "
            "--calibration joints), then kept in the cache"
        )
    return {
        "about": method.about,
        "agent": _name(method.agent),
        "cables": cables,
        "robot": "" if method.wrap_robot is None else f"wrapped by {_name(method.wrap_robot)}",
        "planner": method.planner,
        "perception": method.perception,
        "settings": {name: _plain(value) for name, value in listed_settings(method.make_settings())},
    }


def _name(thing: Any) -> str:
    return thing.where if isinstance(thing, Lazy) else f"{thing.__module__}:{thing.__qualname__}"


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | tuple):
        return ",".join(f"{number:.4g}" for number in np.ravel(value))
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def cache(
    *, empty: Annotated[bool, typer.Option("--empty", help="Remove all of them; they are then fitted again.")] = False
) -> Result:
    """List the fitted cable models that runs share, or remove them."""
    need("sim", "mujoco", "trio", "cv2")
    from trocar.eval.prepare import cache_folder, cached_calibrations

    files = cached_calibrations()
    if empty:
        for file in files:
            file.unlink(missing_ok=True)
    summary = {"folder": str(cache_folder()), "files": [file.name for file in files], "removed": empty}
    what = "removed" if empty else "in the cache"
    return Result(summary, [*map(str, files), f"{len(files)} cable models {what}: {cache_folder()}"])
