import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from trocar.arms import PSM_CLASSIC
from trocar.calibration import study
from trocar.calibration.excitation import PSM2_BOX, wide_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import COMMANDED, MEASURED
from trocar.cli.study_calibration import errors_table, models_table


@pytest.fixture
def recording(tmp_path):
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (200, 6)), axis=0), -1, 1)
    q_phy = PSM1_GREY.measure(PSM1_GREY.run(q), rng)
    np.savez(tmp_path / "r.npz", q_cmd=q, q_phy=q_phy, valid=rng.random(200) > 0.1, t_s=np.arange(200.0))
    return tmp_path / "r.npz"


OWN = Path(__file__).parents[2] / "examples" / "own_cable_model.py"


def test_a_model_from_a_plugin_is_fitted_kept_and_evaluated_like_any_other(
    trocar, recording, tmp_path, monkeypatch, registries
):
    model = tmp_path / "plane.npz"
    for words in (["fit", recording, "--model", "plane", "--out", model], ["evaluate", model, recording]):
        code, _, err = trocar("calibrate", *words, "--json")
        assert code == 2 and "plane" in err
        with monkeypatch.context() as process:  # as in a process of its own
            process.setattr("trocar.registry._LOADED", {})
            process.setattr(MODELS, "_known", dict(MODELS._known))
            code, out, err = trocar("calibrate", *words, "--json", "--plugin", OWN)
        assert code == 0, err
        assert json.loads(out)["model"] == "plane"


def test_fit_and_evaluate(trocar, recording, tmp_path):
    model, picture = tmp_path / "m.npz", tmp_path / "loops.png"
    code, out, _ = trocar(
        "calibrate", "fit", recording, "--model", "ridge", "--out", model, "--fraction", 0.8, "--json"
    )
    assert code == 0
    assert json.loads(out)["model"] == "ridge"
    code, out, _ = trocar("calibrate", "evaluate", model, recording, "--from-row", 160, "--json", "--plot", picture)
    result = json.loads(out)
    with np.load(recording) as data:
        error = (data["q_phy"] - data["q_cmd"])[160:][data["valid"][160:]]
    assert code == 0
    assert result["joints"] == ["q1", "q2", "q3", "q4", "q5", "q6"]
    assert result["rows"] == len(error)
    np.testing.assert_allclose(result["rmse_before"], np.sqrt(np.mean(error**2, axis=0)))
    assert len(result["rmse_after"]) == 6
    assert result["rmse_after"][3] < 0.5 * result["rmse_before"][3]
    assert result["model"] == "ridge"
    assert 0 < result["compensation_ms"] < 10
    assert picture.stat().st_size > 10_000


def test_the_studys_tables_fit_into_a_terminal_of_80_columns():
    error = np.full(6, 0.2522)
    result: Any = SimpleNamespace(rmse_before=error, rmse_after=error, compensation_ms=0.54)
    models: dict[str, Any] = dict.fromkeys(("offset", "ridge", "lstm", "play"), result)
    everything = dict.fromkeys(study.RECORDINGS, models)
    tables = {name: {key: error for key in rows} for name, rows in study.TABLE_1.items()}
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(errors_table(tables, study.TABLE_1))
    console.print(models_table(everything, study.LIMITS_RAD, study.REFERENCES_RAD))
    assert "\u2026" not in console.export_text()


@pytest.mark.slow
def test_the_study_prints_table_1(trocar, recordings, tmp_path):
    words = ("study", "calibration", "--data", recordings, "--no-lstm", "--json", "--out", tmp_path / "study")
    code, out, _ = trocar(*words)
    assert code == 0
    result = json.loads(out)
    table = result["table_1"]["psm1_grey_random"]
    np.testing.assert_allclose(table["RMSE"], [0.0030, 0.0036, 0.00051, 0.26, 0.15, 0.17], rtol=0.04)
    assert (tmp_path / "study" / "summary.json").is_file()
    change = result["session_change"]
    assert change["rmse_after_refit"][0] < change["rmse_before_refit"][0]


def test_a_minutes_commands_are_written_for_a_robot(trocar, tmp_path):
    code, out, _ = trocar("calibrate", "excite", "peg-transfer", "--arm", "psm2", "--out", tmp_path / "minute.csv")
    assert code == 0 and "77 commands for psm2" in out
    rows = np.loadtxt(tmp_path / "minute.csv", delimiter=",", skiprows=1)
    assert rows.shape == (77, 6)
    np.testing.assert_allclose(rows[2:], wide_path(PSM_CLASSIC, 75, PSM2_BOX), atol=1e-6)
    _, out, _ = trocar("calibrate", "excite", "peg-transfer", "--arm", "psm2", "--out", tmp_path / "m.csv", "--json")
    np.testing.assert_allclose(json.loads(out)["q_cmd"], rows, atol=1e-6)


def test_a_recording_may_be_a_csv_file(trocar, recording, tmp_path):
    with np.load(recording) as arrays:
        values = np.column_stack([arrays["t_s"], arrays["q_cmd"], arrays["q_phy"], arrays["valid"]])
    header = ",".join(["time_s", *COMMANDED, *MEASURED, "valid"])
    np.savetxt(tmp_path / "r.csv", values, delimiter=",", header=header, comments="", fmt="%.17g")
    said = {}
    for kind in ("npz", "csv"):
        path, model = tmp_path / f"r.{kind}", tmp_path / f"m_{kind}.npz"
        assert trocar("calibrate", "fit", path, "--model", "ridge", "--out", model)[0] == 0
        code, stdout, _ = trocar("calibrate", "evaluate", model, path, "--json")
        assert code == 0
        said[kind] = json.loads(stdout)
    assert said["csv"]["rmse_after"] == said["npz"]["rmse_after"]
