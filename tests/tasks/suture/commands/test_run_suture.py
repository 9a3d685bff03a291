"""``trocar run suture``: what it prints, saves and refuses."""

import json

import pytest

from synthetic import unmarked


@pytest.mark.slow
def test_one_suture_is_run_reported_and_reported_again(trocar, tmp_path, request):
    """The second report, of which only what it prints is looked at, draws no pictures."""
    line = "run suture --count 1 --model offset --calibration joints --flawless-camera --seed 2 --out"
    words = (*line.split(), tmp_path)
    code, out, _ = trocar(*words, "--json")
    assert out.count("\n") == 1
    summary = json.loads(out)
    assert code == 0
    assert summary == unmarked(tmp_path / "summary.json")
    assert (summary["task"], summary["attempted"]) == ("suture", 1)
    assert set(summary["joint_error_deg"]) == {"yaw", "pitch", "roll", "wrist_pitch", "wrist_yaw"}
    for picture in ("storyboard", "joints", "needle", "timechart"):
        assert (tmp_path / f"{picture}.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "run.json").read_text())["options"]["preset"] == "default"
    request.getfixturevalue("unpictured")
    code, out, _ = trocar("report", tmp_path)
    shown = " ".join(out.split())
    for sentence in ("no tissue mechanics", "needle's tip off its path", "wrist pitch, deg", "loading"):
        assert sentence in shown


@pytest.fixture
def planned(trocar, tmp_path):
    """Return where `trocar plan suture` with these words has saved its plan."""

    def plan(name, *words):
        code, _, err = trocar("plan", "suture", *words, "--out", tmp_path / name, "--json")
        assert code == 0, err
        return tmp_path / name / "plan.json"

    return plan


@pytest.mark.slow
def test_any_plan_is_driven_and_kept_with_its_run(trocar, unpictured, planned, tmp_path):
    path, run = planned("plan", "--set", "circle_radius_mm=28", "--count", 1), tmp_path / "run"
    words = ("--method", "uncalibrated", "--out", run)
    code, printed, _ = trocar("run", "suture", "--plan", path, *words, "--json")
    summary, saved = json.loads(printed), json.loads(path.read_text())
    assert (code, summary["succeeded"]) == (0, 0), "an uncalibrated arm misses it"
    assert summary["attempted"] == 1
    (driven,) = summary["sutures"]
    assert [driven["theta_deg"]] == pytest.approx(saved["positions_deg"])
    assert [driven["direction"]] == saved["directions"]
    kept = json.loads((run / "run.json").read_text())
    assert kept["options"]["plan_file"]["setup"] == saved["setup"]
    assert str(tmp_path) not in json.dumps(kept)

    path.rename(tmp_path / "moved.json")
    code, _, err = trocar("run", "suture", "--plan", tmp_path / "moved.json", *words)
    assert code == 0 and "nothing to run" in " ".join(err.split())
    other = planned("other", "--set", "circle_radius_mm=29", "--count", 1)
    code, _, err = trocar("run", "suture", "--plan", other, *words)
    assert code == 2 and "holds another run (radius_m 0.028" in err and err.count("\n") == 1
    code, out, _ = trocar("report", run, "--json")
    assert code == 0 and json.loads(out)["tip_error_mm"] == summary["tip_error_mm"]


@pytest.mark.parametrize(
    ("setup", "words", "sentence"),
    [
        ({}, ("--preset", "default"), "preset 'default' cannot be combined with a plan"),
        ({"arm": "psm-si"}, (), "is for 'psm-si', but arm 'psm1' of station 'suture' is 'psm-classic'; plan"),
    ],
)
def test_a_plan_that_cannot_be_driven_as_asked_is_refused_before_anything_is_written(
    trocar, planned, tmp_path, setup, words, sentence
):
    path = planned("plan", "--count", 1)
    saved = json.loads(path.read_text())
    path.write_text(json.dumps(saved | {"setup": saved["setup"] | setup}))
    code, out, err = trocar("run", "suture", "--plan", path, *words, "--out", tmp_path / "run", "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and sentence in err
    assert not (tmp_path / "run").exists()
