"""A folder of good files, and files made of them that are cut, altered, swapped, or claim to be huge."""

from __future__ import annotations

import io
import json
import re
import shutil
import zipfile
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

import trocar.tasks.suture.demonstrations
from fuzzing.values import ARRAYS, literals
from trocar.arms import PSM_CLASSIC
from trocar.bags.trial import write_mcap
from trocar.calibration.fleet import load_prior
from trocar.calibration.models import MODELS, save_model
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from trocar.eval.trial import Trial, trial_file
from trocar.files.output import write_json
from trocar.lab import built_in_stations, station_text

LIFTED = (0.2, -0.3, 0.15, 0.1, 0.3, 0.2), (0.2, -0.3, 0.11, 0.1, 0.3, 0.2)
OVER = (-0.1, 0.1, 0.11, 0.2, -0.1, 0.1), (-0.1, 0.1, 0.14, 0.2, -0.1, 0.1)

ODD = (
    *("0", "-1", "1", "nan", "inf", "-inf", "1e308", "-1e300", "1e6", "1e-300", "9" * 400),
    *("[]", "{}", "true", "", '"x"', '""', "[[1]]"),
)
"""In the place of a value of TOML or CSV."""

HUGE = (1 << 20, 1 << 22)
"""A shape that takes 32 TiB."""


def make_good(folder: Path, trial: Trial) -> None:
    """Fill a folder with one good file, or folder, of each kind; the trial is that of its run."""
    rng = np.random.default_rng(0)
    q = np.clip(PSM_CLASSIC.middle + np.cumsum(rng.normal(0, 0.03, (60, 6)), axis=0), -1, 1)
    recording = Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(60, bool), np.arange(60.0))
    recording.save(folder / "recording.npz")
    points = rng.uniform(-0.1, 0.1, (20, 3))
    np.save(folder / "points.npy", points)
    np.savez(folder / "capture.npz", points_m=points + [0, 0, 0.5])
    np.save(folder / "waypoints.npy", [*LIFTED, *OVER])
    for name in ("offset", "ridge"):
        save_model(MODELS[name].fit(recording, rng), folder / f"{name}.npz")
    load_prior("fleet").save(folder / "prior.npz")
    for name in built_in_stations():
        (folder / f"{name}.toml").write_text(station_text(name))
    rows = [",".join(["t_s", *(f"q{k}" for k in range(1, 7))])]
    rows += [",".join(f"{value:.6f}" for value in (0.01 * k, *row)) for k, row in enumerate(q)]
    (folder / "joints.csv").write_text("\n".join(rows) + "\n")
    write_json(folder / "plan.json", _plan(), "plan of sutures")
    shutil.copytree(str(files(trocar.tasks.suture.demonstrations) / "synthetic_set"), folder / "demonstrations")
    (folder / "run" / "session_00").mkdir(parents=True)
    trial.save(trial_file(folder / "run", 0, 0))
    short = {name: rows[:50] if len(rows) == len(trial.times_s) else rows for name, rows in trial.arrays.items()}
    write_mcap(replace(trial, arrays=short), folder / "trial.mcap")
    about = {**trial.about, "sessions": 1, "trials": 1}
    write_json(folder / "run" / "run.json", about, "run")
    (folder / "folder").mkdir()
    (folder / "empty.npz").touch()
    (folder / "broken.py").write_text("import nothing_of_this_name\n")


def _plan() -> dict[str, Any]:
    from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
    from trocar.tasks.suture.planning.summary import plan_summary

    found = dexterity(PRESETS["default"].setup, PRESETS["default"].reward, 40)
    return plan_summary(found, plan_even(found, 4))


@cache
def good_files(folder: Path) -> list[str]:
    """Return the names of all files in a folder of good ones, of folders' files too."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@st.composite
def altered(draw: st.DrawFn, folder: Path, name: str) -> bytes:
    """Return the bytes of one of the good files as a bad disk, or somebody hostile, hands them back."""
    data = (folder / name).read_bytes()
    ways = [_cut, _flipped, _stuffed, _swapped]
    if name.endswith(".npz") and zipfile.is_zipfile(folder / name):
        ways = [*ways[:2], _swapped, *[_member] * 6]
    elif name.endswith(".json"):
        ways += [_json] * 6
    elif name.endswith((".toml", ".csv")):
        ways += [_text] * 6
    elif name.endswith(".npy"):
        ways += [_other_array] * 4
    return draw(st.sampled_from(ways))(draw, data, folder)


def _cut(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    return data[: draw(st.integers(0, max(0, len(data) - 1)))]


def _flipped(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 5))):
        if changed:
            changed[draw(st.integers(0, len(changed) - 1))] ^= draw(st.integers(1, 255))
    return bytes(changed)


def _stuffed(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    place = draw(st.integers(0, len(data)))
    return data[:place] + draw(st.sampled_from([b"\0", b"\xff\xfe", b"\n\n", b"nan", b"," * 40])) + data[place:]


def _swapped(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    return (folder / draw(st.sampled_from(good_files(folder)))).read_bytes()


def _member(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    """Return a zip with one member altered, renamed, doubled, missing, or claiming to be huge."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members = [(name, file.read(name)) for name in file.namelist()]
    place = draw(st.integers(0, len(members) - 1))
    name, content = members[place]
    way = draw(st.sampled_from(["content"] * 6 + ["rename", "double", "missing", "more"]))
    if way == "content":
        members[place] = name, _altered_member(draw, name, content, folder)
    elif way == "rename":
        names = ["x.npy", "header.json", "../x.npy", "q_cmd.npy", ".npy", "ä.npy"]
        members[place] = draw(st.sampled_from(names)), content
    elif way == "double":
        members.append((name, _altered_member(draw, name, content, folder)))
    elif way == "missing":
        del members[place]
    else:
        members.append(("more.npy", _claimed(HUGE)))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for one, held in members:
            file.writestr(one, held)
    return buffer.getvalue()


def _altered_member(draw: st.DrawFn, name: str, content: bytes, folder: Path) -> bytes:
    if name.endswith(".json"):
        return _json(draw, content, folder)
    return draw(st.sampled_from([_other_array, _other_array, _one_number, _flipped, _cut]))(draw, content, folder)


def _other_array(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    """Return an .npy of another shape or kind, one of objects, or one that claims to be huge."""
    way = draw(st.sampled_from(["array"] * 5 + ["objects", "huge", "negative"]))
    if way == "huge":
        return _claimed(HUGE)
    if way == "negative":
        return _claimed((-1, 6))
    array = np.array([{"a": 1}], dtype=object) if way == "objects" else draw(st.sampled_from(ARRAYS))
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _one_number(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    """Return the same array with one number altered, or all."""
    try:
        array = np.array(np.load(io.BytesIO(data), allow_pickle=False))
    except ValueError:
        return data[:-1]
    if array.dtype.kind == "f" and array.size:
        value = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e30, -1e308, 0.0, 1e3]))
        with np.errstate(over="ignore"):
            if draw(st.booleans()):
                array.flat[draw(st.integers(0, array.size - 1))] = value
            else:
                array[...] = value
    elif array.size:
        array = array[draw(st.integers(0, 3)) :] if array.ndim else array
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def _claimed(shape: tuple[int, ...]) -> bytes:
    """Return an .npy of a few bytes that claims a shape."""
    buffer = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)  # type: ignore[attr-defined]
    return buffer.getvalue() + bytes(64)


def _json(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    """Return JSON with one value replaced or missing, at any depth."""
    try:
        values = json.loads(data)
    except ValueError:
        return data[:-1]
    holder, key = None, None
    place: Any = values
    while isinstance(place, dict | list) and place and (holder is None or draw(st.integers(0, 4))):
        holder = place
        key = draw(st.sampled_from(sorted(place))) if isinstance(place, dict) else draw(st.integers(0, len(place) - 1))
        place = place[key]
    if holder is None or not draw(st.integers(0, 9)):
        return draw(st.sampled_from([b"[]", b"null", b"{}", b"[" * 100_000, b"1e999", b"\xff"]))
    if draw(st.integers(0, 4)):
        holder[key] = draw(literals)
    else:
        del holder[key]
    return json.dumps(values).encode()


def _text(draw: st.DrawFn, data: bytes, folder: Path) -> bytes:
    """Return TOML or CSV with one value replaced, or one line missing or doubled."""
    lines = data.decode().splitlines()
    place = draw(st.integers(0, len(lines) - 1))
    way = draw(st.sampled_from(["value"] * 6 + ["missing", "double"]))
    if way == "missing":
        del lines[place]
    elif way == "double":
        lines.insert(place, lines[place])
    else:
        numbers = list(re.finditer(r"-?\d+\.?\d*|\"[^\"]*\"|true|false", lines[place]))
        new = draw(st.sampled_from(ODD))
        if numbers:
            found = draw(st.sampled_from(numbers))
            lines[place] = lines[place][: found.start()] + new + lines[place][found.end() :]
        else:
            lines[place] = new
    return "\n".join(lines).encode()
