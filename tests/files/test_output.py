"""Files are written completely or not at all, and replace only files of their own kind."""

import ast
import errno
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import trocar
from synthetic import synthetic_trial
from trocar.calibration.recording import Recording
from trocar.errors import MachineError, TrocarError
from trocar.files.archive import Archive
from trocar.files.output import mark_of, require_place, write_figure, write_json, write_table, write_text, writing

KIND = "plan of sutures"
THEIRS = b'{"mine": "six months of work"}'


def archive(format_="trocar trial"):
    return Archive({"format": format_, "version": 1}, {"a": np.arange(5.0)})


def recording():
    q = np.zeros((3, 6))
    return Recording(q, q, np.ones(3, bool), np.arange(3.0))


WRITERS = {
    "plan.json": lambda path: write_json(path, {"a": 1}, KIND),
    "page.html": lambda path: write_text(path, "<p>hello</p>", "report"),
    "cell.xml": lambda path: write_text(path, "<mujoco/>\n", "MJCF of a station"),
    "arm.urdf": lambda path: write_text(path, "<robot/>\n", "URDF of an arm"),
    "station.toml": lambda path: write_text(path, "[arms]\n", "station"),
    "table.csv": lambda path: write_table(path, ["a", "b"], [["1", "2"]]),
    "figure.png": lambda path: write_figure(path, Figure((2, 2))),
    "figure.svg": lambda path: write_figure(path, Figure((2, 2))),
    "figure.pdf": lambda path: write_figure(path, Figure((2, 2))),
    "trial.npz": lambda path: archive().save(path),
    "recording.npz": lambda path: recording().save(path),
    "trial_000.npz": lambda path: synthetic_trial().save(path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_its_own_kind_is_replaced_and_one_of_somebody_else_s_is_not(name, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    first = path.read_bytes()
    assert len(first) > 0
    WRITERS[name](path)
    path.write_bytes(THEIRS)
    with pytest.raises(TrocarError, match="not replaced"):
        WRITERS[name](path)
    assert path.read_bytes() == THEIRS
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("name", WRITERS)
def test_a_place_that_cannot_be_written_is_the_machines_trouble_and_leaves_no_draft(name, tmp_path, monkeypatch):
    real = Path.replace

    def full(self, target):
        if self.name.startswith("."):
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(MachineError, match="No space left on device"):
        WRITERS[name](tmp_path / name)
    assert not [path for path in tmp_path.iterdir() if "timing" not in path.name]


def test_other_kinds_of_trocar_s_own_are_not_replaced_either(tmp_path):
    write_json(tmp_path / "summary.json", {}, "summary of a run")
    with pytest.raises(TrocarError, match="not a study of calibration"):
        write_json(tmp_path / "summary.json", {}, "study of calibration")
    archive("trocar cable model").save(tmp_path / "model.npz")
    with pytest.raises(TrocarError, match="not a recording"):
        recording().save(tmp_path / "model.npz")
    write_table(tmp_path / "table.csv", ["a", "b"], [])
    with pytest.raises(TrocarError, match="not replaced"):
        write_table(tmp_path / "table.csv", ["a", "b", "c"], [])


def test_a_file_that_is_read_is_not_written_whatever_it_is_called(tmp_path):
    path = write_json(tmp_path / "plan.json", {}, KIND)
    (tmp_path / "link.json").symlink_to(path)
    for name in (path, tmp_path / "link.json", tmp_path / "." / "plan.json"):
        with pytest.raises(TrocarError, match="is read"):
            require_place(name, KIND, [path])
    assert require_place(tmp_path / "other.json", KIND, [path]) == tmp_path / "other.json"


def test_a_folder_in_the_place_of_a_file_is_one_sentence(tmp_path):
    (tmp_path / "plan.json").mkdir()
    with pytest.raises(TrocarError, match="is a folder where a file is to be"):
        write_json(tmp_path / "plan.json", {}, KIND)


def test_what_a_full_disk_left_empty_is_written_again(tmp_path):
    path = tmp_path / "plan.json"
    path.touch()
    write_json(path, {"a": 1}, KIND)
    assert json.loads(path.read_text()) == {"made_by": mark_of(KIND), "a": 1}


def test_an_error_in_the_middle_leaves_the_older_file(tmp_path):
    path = write_json(tmp_path / "plan.json", {"a": 1}, KIND)
    with pytest.raises(RuntimeError, match="in the middle"), writing(path, KIND) as draft:
        draft.write_text("half a")
        raise RuntimeError("in the middle")
    assert json.loads(path.read_text())["a"] == 1 and [path] == list(tmp_path.iterdir())


def test_marks_do_not_spoil_what_is_marked(tmp_path):
    with zipfile.ZipFile(recording().save(tmp_path / "recording.npz")) as file:
        assert file.testzip() is None
    assert np.load(tmp_path / "recording.npz")["q_cmd"].shape == (3, 6)
    assert Archive({"format": "f", "version": 1}).save(tmp_path / "a.npz").read_bytes()[:2] == b"PK"


WRITES = {"write_bytes", "savefig", "savez", "savez_compressed", "savetxt", "mkstemp"}
DOORS = {"files/output.py", "files/archive.py", "calibration/recording.py", "report/style.py"}
DOORS |= {"tasks/suture/report/circle.py"}  # a picture in memory, for a texture
DOORS |= {"bags/trial.py", "bags/images.py"}  # into the path of a draft; into a folder of their own
DOORS |= {"learn/meta.py", "files/video.py"}  # into the path of a draft
"""Modules that write drafts; all others go through them."""


def writes_by_hand(call):
    """Return whether a call, as Python reads it, writes a file by itself."""
    method = isinstance(call.func, ast.Attribute)
    name = call.func.attr if method else getattr(call.func, "id", "")
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    if name == "open":
        modes = [a.value for a in given if isinstance(a, ast.Constant) and isinstance(a.value, str)]
        return any(set(mode) <= set("wxabt+") and set(mode) & set("wxa") for mode in modes)
    return method and (name in WRITES or (name == "write_text" and getattr(call.func.value, "id", "") != "output"))


def test_no_module_writes_a_file_past_the_door():
    """A rule for what comes later: whoever writes, writes a draft, which replaces its own kind alone."""
    root = Path(trocar.__file__).parent
    modules = {path.relative_to(root).as_posix(): ast.parse(path.read_text()) for path in root.rglob("*.py")}
    calls = {name: [n for n in ast.walk(tree) if isinstance(n, ast.Call)] for name, tree in modules.items()}
    writing = {name for name, found in calls.items() if any(map(writes_by_hand, found))}
    assert writing <= DOORS
    assert {"files/output.py", "calibration/recording.py"} <= writing, "the rule sees those that it should"
