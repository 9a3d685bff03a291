"""Setups as text: settings ``name=value`` as on the command line, and setup files (TOML), which hold the same."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from trocar.arms import ARMS
from trocar.errors import BadFile, InvalidInput, InvalidValue, UnknownName
from trocar.tasks.suture.needle import NEEDLES
from trocar.tasks.suture.planning.parameters import PARAMETERS, SAID, parameters_of, shown_parameter, with_parameters
from trocar.tasks.suture.planning.rewards import PRESETS, Preset, Reward
from trocar.tasks.suture.planning.setup import SutureSetup

SETTINGS = (*SAID, "needle", "pushes", "theta_is")
"""Names of settings: parameters in mm or deg, a needle of the catalogue, and two fields of ``Insertion``."""
KEYS = ("preset", "arm", "set", "reward")
"""Keys of a setup file."""
LEFT_OUT = ("center_x_m", "center_y_m", "center_z_m")


def preset_of(name: str) -> Preset:
    """Return the preset of this name, or that of a setup file.

    Raises:
        UnknownName: there is neither.
        BadFile: the file cannot be read, or does not describe a setup.
    """
    if name in PRESETS:
        return PRESETS[name]
    if Path(name).suffix != ".toml":
        remedy = f"choose one of {', '.join(PRESETS)}, or give a setup file (.toml)"
        raise UnknownName("the preset", name, PRESETS, remedy=remedy)
    try:
        values = tomllib.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadFile(name, f"cannot be read ({error.strerror})", "give another", kind="setup file") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(name, f"is not TOML: {error}", "correct that line", kind="setup file") from None
    try:
        return _from_tables(values)
    except InvalidInput as error:
        raise BadFile(name, f"holds no setup: {error}", kind="setup file") from None


def _from_tables(values: Mapping[str, Any]) -> Preset:
    for key in values:
        if key not in KEYS:
            raise UnknownName("the key", key, KEYS)
    base, arm = values.get("preset", "default"), values.get("arm")
    settings, reward = values.get("set", {}), values.get("reward", {})
    if base not in tuple(PRESETS):
        raise UnknownName("the preset", base, PRESETS)
    for key, table in (("set", settings), ("reward", reward)):
        if not isinstance(table, Mapping):
            raise InvalidValue(key, repr(table), "give a table")
    preset = with_settings(PRESETS[base], settings, arm)
    return replace(preset, reward=with_reward(preset.reward, reward))


def with_settings(preset: Preset, settings: Mapping[str, object], arm: str | None = None) -> Preset:
    """Return a preset with settings by name (one of ``SETTINGS``), and with another arm if one is named.

    A value may be a text, as on the command line. A parameter that is set no longer counts as fitted.

    Raises:
        InvalidInput: a name is unknown, a value is not of its kind, or no setup has these values.
    """
    for name in settings:
        if name not in SETTINGS:
            raise UnknownName("the setting", name, SETTINGS)
    setup = preset.setup
    changes: dict[str, Any] = {}
    if arm is not None:
        changes["arm"] = _named(ARMS, arm, "the arm")
    if "needle" in settings:
        changes["needle"] = _named(NEEDLES, settings["needle"], "the needle")
    words: dict[str, Any] = {}
    if "pushes" in settings:
        words["pushes"] = _whole(settings["pushes"])
    if "theta_is" in settings:
        words["theta_is"] = settings["theta_is"]
    changes["insertion"] = replace(setup.insertion, **words)
    given = {SAID[name]: _number(name, value) for name, value in settings.items() if name in SAID}
    numbers = {name: value / shown_parameter(name)[0] for name, value in given.items()}
    fitted = tuple(name for name in preset.fitted if name not in settings)
    return replace(preset, setup=with_parameters(setup, numbers, **changes), fitted=fitted)


def with_reward(reward: Reward, values: Mapping[str, Any]) -> Reward:
    """Return a reward with some of its fields replaced.

    Raises:
        InvalidInput: a name is unknown, a value is not of its kind, or no reward has it.
    """
    known = {field.name: getattr(reward, field.name) for field in fields(reward)}
    for name, value in values.items():
        if name not in known:
            raise UnknownName("the reward's", name, known)
        usual = known[name]
        numbers = value if isinstance(value, list | tuple) else [value]
        real = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
        fits = {
            float: real and numbers[0] is value,
            tuple: real and numbers is value,
        }.get(type(usual), isinstance(value, type(usual)))
        if not fits:
            kinds = {float: "a number", tuple: "three numbers", bool: "true or false", str: "a word"}
            raise InvalidValue(f"the reward's {name}", repr(value), f"give {kinds[type(usual)]}")
        known[name] = tuple(value) if isinstance(usual, tuple) else value
    return Reward(**known)


def setting_of(text: str) -> tuple[str, str]:
    """Return name and value of a setting ``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise InvalidValue("the setting", repr(text), "give NAME=VALUE, such as base_tilt_deg=30")
    return name, value


def settings_between(old: SutureSetup, new: SutureSetup) -> dict[str, float | int | str]:
    """Return the settings that turn a setup into another one, apart from the arm."""
    was, now = parameters_of(old), parameters_of(new)
    found: dict[str, float | int | str] = {}
    for name in PARAMETERS:
        scale, said = shown_parameter(name)
        if name not in LEFT_OUT and scale * abs(now[name] - was[name]) > 1e-9:
            found[said] = float(f"{scale * now[name]:.9g}")
    shift_m = (old.circle.T_world_circle.inverse() @ new.circle.T_world_circle).translation_m
    for axis, value in zip("xyz", shift_m.tolist(), strict=True):
        if abs(value) > 1e-12:
            found[f"center_{axis}_mm"] = float(f"{1e3 * value:.9g}")
    for word in ("pushes", "theta_is"):
        if getattr(old.insertion, word) != (value := getattr(new.insertion, word)):
            found[word] = value
    return found


def setup_file(preset: Preset) -> str:
    """Return the text of the setup file (TOML) that describes a preset."""
    usual = PRESETS["default"]
    lines = ['preset = "default"', f'arm = "{preset.setup.arm.name}"', "", "[set]"]
    lines += [f"{name} = {_toml(value)}" for name, value in settings_between(usual.setup, preset.setup).items()]
    lines += ["", "[reward]"]
    lines += [f"{field.name} = {_toml(getattr(preset.reward, field.name))}" for field in fields(preset.reward)]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _named(table: Mapping[str, Any], name: object, what: str) -> Any:
    if not isinstance(name, str) or name not in table:
        raise UnknownName(what, str(name), table)
    return table[name]


def _number(name: str, value: object) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        unit = "mm" if name.endswith("_mm") else "deg"
        raise InvalidValue(f"the setting {name}", repr(value), f"give a number in {unit}")
    return number


def _whole(value: object) -> int:
    text = str(value)
    if not text.lstrip("-").isdigit():
        raise InvalidValue("the setting pushes", repr(value), "give a whole number")
    return int(text)
