"""A path may be a string or a ``Path`` everywhere; and no message advises deleting a file."""

import ast
import re
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from synthetic import config, synthetic_trial
from trocar.calibration.fleet.prior import load_prior
from trocar.calibration.models import MODELS, load_model, save_model
from trocar.calibration.recording import Recording, load_recording
from trocar.calibration.study import load_study_recordings
from trocar.errors import TrocarError
from trocar.eval.folder import load_trials, open_folder
from trocar.eval.prepare import cable_file
from trocar.eval.trial import Trial, session_folder, timing_file, trial_about, trial_file, trial_files
from trocar.files.archive import Archive, read_archive, read_header
from trocar.files.output import bears, make_folder, require_picture, write_figure, write_json, write_table, write_text
from trocar.lab import load_station
from trocar.lab.station_file import station_text
from trocar.motion.joint_table import read_joint_table
from trocar.perception.capture import load_capture
from trocar.report.stills import draw_storyboard
from trocar.tasks.suture.demonstrations import load_demonstrations
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
from trocar.tasks.suture.planning.plan import load_plan
from trocar.tasks.suture.planning.summary import plan_summary
from trocar.tasks.suture.report.circle import draw_plan

SOURCE = Path(__file__).parents[1] / "src" / "trocar"


@cache
def recording():
    q = 0.3 * np.sin(np.outer(np.arange(60.0), np.linspace(0.1, 0.6, 6)))
    return Recording(q, q + 0.1, np.ones(60, bool), np.arange(60.0), "made up")


@cache
def sutures():
    found = dexterity(PRESETS["default"].setup, positions=36)
    return found, plan_even(found, 4)


def kept_recording(at):
    saved = recording().save(at("mine.npz"))
    return saved, load_recording(at("mine.npz")).q_cmd, [*load_study_recordings(at(""), ["mine"])]


def kept_model(at):
    model = MODELS["offset"].fit(recording(), np.random.default_rng(0))
    return save_model(model, at("cables.npz")), load_model(at("cables.npz")).offset


def kept_prior(at):
    return load_prior("fleet").save(at("prior.npz")), load_prior(at("prior.npz")).shape_mean


def kept_trial(at):
    saved = synthetic_trial().save(at("trial.npz"))
    return saved, Trial.load(at("trial.npz")).scores, trial_about(at("trial.npz"))["seed"], timing_file(at("trial.npz"))


def kept_run(at):
    run = config(seed=3)
    todo = open_folder(run, at("run"))
    session_folder(at("run"), 0).mkdir()
    synthetic_trial(run).save(trial_file(at("run"), 0, 0))
    trials, strange = load_trials(at("run"))
    return todo, len(trials), strange, trial_files(at("run")), cable_file(at("run"), 0, "psm1")


def kept_archive(at):
    archive = Archive({"format": "test", "version": 1}, {"x": np.arange(3)})
    saved = archive.save(at("kept.npz"))
    return saved, read_header(at("kept.npz"), "test", 1), read_archive(at("kept.npz"), "test", 1).arrays["x"]


def kept_station(at):
    Path(at("lab.toml")).write_text(station_text("peg-transfer"))
    return load_station(at("lab.toml")).models


def kept_points(at):
    np.savez(at("points.npz"), points_mm=np.eye(3))
    return load_capture(at("points.npz"))


def kept_joints(at):
    write_table(at("joints.csv"), ["t", "q1"], [[f"{k / 10}", f"{k * k}"] for k in range(20)])
    return read_joint_table(at("joints.csv")).columns(["q1"], at("joints.csv"))


def kept_plan(at):
    write_json(at("plan.json"), plan_summary(*sutures()), "plan of sutures")
    return load_plan(at("plan.json")).positions_rad


def kept_demonstrations(at):
    shutil.copytree(SOURCE / "tasks" / "suture" / "demonstrations" / "synthetic_set", at("set"))
    return load_demonstrations(at("set")).source


def texts(at):
    page = write_text(at("page.html"), "<p>", "page")
    return make_folder(at("new/folder")), page, bears(at("page.html"), "made by Trocar: page")


def pictures(at):
    figure = Figure()
    return write_figure(at("mine.png"), figure), require_picture(at("mine.png"))


def circle(at):
    return draw_plan(*sutures(), at("plan.png"))


def storyboard(at):
    return draw_storyboard([("a", np.zeros((20, 20, 3), np.uint8))], at("story.png"), "a story")


CASES = (kept_recording, kept_model, kept_prior, kept_trial, kept_run, kept_archive, kept_station, kept_points)
CASES += (kept_joints, kept_plan, kept_demonstrations, texts, pictures, circle, storyboard)


def told(value, folder):
    """Return what a case returned as text without its folder; every path in it is a ``Path``."""
    return repr(value).replace(str(folder), "FOLDER")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_a_text_and_a_path_do_the_same(case, tmp_path):
    said = []
    for kind in (str, Path):
        folder = make_folder(tmp_path / kind.__name__)
        said.append(told(case(lambda name, folder=folder, kind=kind: kind(folder / name)), folder))
    assert said[0] == said[1]


def test_a_trial_that_is_not_there_is_said_to_be_missing_whatever_its_path_is(tmp_path):
    for path in (tmp_path / "none.npz", str(tmp_path / "none.npz")):
        with pytest.raises(TrocarError, match="does not exist"):
            Trial.load(path)


def public_functions():
    """Yield (file, function) of all that is public outside of the command line and the tasks' own folders."""
    for file in sorted(SOURCE.rglob("*.py")):
        inside = file.relative_to(SOURCE).parts
        text = file.read_text()
        # Typer gives the command line what it needs, and we call the reports and studies of tasks
        if (
            inside[0] in ("cli", "tasks")
            or inside in (("eval", "task_report.py"), ("eval", "study.py"))
            or "Path" not in text
        ):
            continue
        pending = list(ast.parse(text).body)
        while pending:
            node = pending.pop()
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                pending += node.body
            if isinstance(node, ast.FunctionDef) and (node.name == "__init__" or not node.name.startswith("_")):
                yield file, node


def test_every_public_function_takes_paths_as_texts_too():
    found = []
    for file, function in public_functions():
        for argument in (*function.args.args, *function.args.kwonlyargs):
            kind = "" if argument.annotation is None else ast.unparse(argument.annotation)
            if re.search(r"\bPath\b", kind) and not re.search(r"\bstr\b", kind):
                found.append(f"{file.relative_to(SOURCE)}: {function.name}({argument.arg}: {kind})")
    assert not found


def test_no_sentence_advises_to_delete_a_file():
    advice = re.compile(
        r"\bdelet|\berase|\brm -|\bthrow (it|them) away|\bremove (it|the (file|folder))\b", re.IGNORECASE
    )
    found = []
    for file in sorted(SOURCE.rglob("*.py")):
        if not advice.search(text := file.read_text()):
            continue
        tree = ast.parse(text)
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            spoken = isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
            if spoken and advice.search(node.value):
                found.append(f"{file.relative_to(SOURCE)}:{node.lineno} {node.value!r:.80}")
    assert not found
