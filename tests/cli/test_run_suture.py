"""``trocar run suture``: what it prints, keeps and refuses."""

import json
import sys

import pytest

from trocar.cli import main


@pytest.fixture
def trocar(monkeypatch, capsys):
    """Run a command in this process; return exit code, stdout and stderr."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["trocar", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        out = capsys.readouterr()
        return stop.value.code or 0, out.out, out.err

    return command


def test_one_suture_is_run_reported_and_reported_again(trocar, tmp_path):
    words = ("run", "suture", "--sutures", 1, "--model", "offset", "--seed", 2, "--out", tmp_path)
    code, out, _ = trocar(*words, "--json")
    assert code == 0 and out.count("\n") == 1
    summary = json.loads(out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert (summary["task"], summary["attempted"]) == ("suture", 1)
    assert set(summary["joint_error_deg"]) == {"yaw", "pitch", "roll", "wrist_pitch", "wrist_yaw"}
    for picture in ("storyboard", "joints", "needle", "timechart"):
        assert (tmp_path / f"{picture}.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "run.json").read_text())["preset"] == "default"
    code, out, _ = trocar("report", tmp_path)
    shown = " ".join(out.split())
    for sentence in ("no tissue mechanics", "needle's tip off its path", "wrist pitch, deg", "loading"):
        assert sentence in shown
    assert "collisions" not in shown


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("suture", "--preset", "paper-demo"), "out of the plane in which flat jaws meet; choose one of default"),
        (("suture", "--preset", "none"), "preset 'none' of suture is unknown"),
        (("suture", "--sutures", 0), "number of sutures is 0"),
        (("suture", "--direction", "left"), "direction 'left' of suture is unknown"),
        (("peg-transfer", "--sutures", 3), "task 'peg-transfer' has no option 'sutures'"),
    ],
)
def test_bad_input_is_one_sentence(trocar, tmp_path, words, sentence):
    code, out, err = trocar("run", *words, "--out", tmp_path / "run", "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and sentence in err
    assert not (tmp_path / "run").exists()
