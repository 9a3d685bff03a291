"""Trials as flat tables: all data of a trial can be read back from CSV or Parquet."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synthetic import config, synthetic_trial
from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.report.export import FORMATS, TABLES, Column, FlatTable, export_trials, kind_of

RUN = config()
TICKS = 50


def short_trial(index=0, session=0, **changes):
    """A trial of which only the first ticks were kept, its base registered a centimetre beside the true one."""
    trial = synthetic_trial(RUN, index, {3: "DROPPED"}, session=session)
    arrays = {name: array[:TICKS] if len(array) > TICKS else array for name, array in trial.arrays.items()}
    arrays["true_psm1"] = arrays["true_psm1"].copy()
    arrays["true_psm1"][:, 3] = np.linspace(
        -4.0, 4.0, TICKS
    )  # more than a turn, on which a quaternion changes its sign
    beside = {name: SE3.from_parts(translation_m=[0.01, 0, 0]) @ T for name, T in trial.scenery.T_world_base.items()}
    return replace(trial, arrays=arrays, scenery=replace(trial.scenery, T_world_base_registered=beside), **changes)


def read(path):
    """The rows of a CSV file as dicts."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two trials, one of which has two arms in turn, a sentence with a comma, and a note of any shape."""
    events = [
        {
            "name": "transfer",
            "time_s": 5.0,
            "goal": 0,
            "turns": {"psm1": [0.0, 3.0], "psm2": [2.0, 5.0]},
            "seen": [1, 2],
        },
        {"name": "transfer", "time_s": 10.0, "goal": 1, "arm": "psm2", "start_s": 5.0, "outcome": "DROPPED"},
        {"name": "look", "time_s": 11.0, "arm": 3, "reason": 'it said "no", twice'},
    ]
    folder = tmp_path_factory.mktemp("tables")
    export_trials([short_trial(), short_trial(2, session=1, events=events)], folder)
    return folder


def test_a_row_a_goal_says_what_became_of_it_when_and_by_which_arms(folder):
    rows = read(folder / "goals.csv")
    assert [(row["session"], row["trial"], row["goal"]) for row in rows] == [
        (s, t, str(goal)) for s, t in (("0", "0"), ("1", "2")) for goal in range(12)
    ]
    assert [row["arms"] for row in rows[:12]] == ["psm1"] * 12
    assert [row["arms"] for row in rows[12:15]] == ["psm1 psm2", "psm2", ""]
    assert [row["outcome"] for row in rows[:5]] == ["DONE", "DONE", "DONE", "DROPPED", "DONE"]
    assert (rows[3]["succeeded"], rows[3]["attempted"], rows[3]["reason"]) == ("false", "true", "made up: DROPPED")
    assert (rows[3]["start_s"], rows[3]["end_s"], rows[3]["duration_s"]) == ("15", "20", "5")
    source, target = short_trial().scores[3]["source"], short_trial().scores[3]["target"]
    assert (rows[3]["transfer_source"], rows[3]["transfer_target"]) == (str(source), str(target))


def test_trials_spans_events_and_collisions_come_with_all_that_was_noted(folder):
    first, second = read(folder / "trials.csv")
    assert (first["task"], first["fingerprint"], first["arms"]) == ("peg-transfer", RUN.fingerprint, "psm1")
    assert (first["attempted"], first["succeeded"], first["collisions"]) == ("12", "11", "1")
    assert (second["session"], second["trial"], second["collisions"]) == ("1", "2", "3")
    spans = read(folder / "spans.csv")
    assert len(spans) == 2 * len(short_trial().spans)
    assert {row["goal"] for row in spans[: len(spans) // 2]} == set(map(str, range(12)))
    one, two, look = read(folder / "events.csv")[-3:]
    assert (one["event"], one["goal"], two["arm"], two["outcome"]) == ("transfer", "0", "psm2", "DROPPED")
    assert json.loads(one["more"]) == {"turns": {"psm1": [0.0, 3.0], "psm2": [2.0, 5.0]}, "seen": [1, 2]}
    assert (look["arm"], look["reason"], json.loads(look["more"])) == ("", 'it said "no", twice', {"arm": 3})
    hit = read(folder / "collisions.csv")[0]
    assert (hit["arm"], hit["against"], hit["force_n"], hit["z_m"]) == ("psm1", "peg 4", "2", "0.02")


def test_samples_are_the_trials_arrays_and_tips_follow_from_them(folder):
    trial, rows = short_trial(), read(folder / "samples" / "session_00_trial_000.csv")
    table = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    np.testing.assert_allclose(table["time_s"], 0.01 * np.arange(TICKS))
    for arm, model in trial.scenery.arms.items():
        for kind in ("desired", "commanded", "measured", "true"):
            array = trial.arrays[f"{kind}_{arm}"].astype(float)
            names = [f"{arm}_q{k}_{kind}_{'m' if k == 3 else 'rad'}" for k in range(1, 7)] + [f"{arm}_jaw_{kind}_rad"]
            np.testing.assert_allclose(np.column_stack([table[name] for name in names]), array, rtol=1e-8)
            bases = trial.scenery.T_world_base if kind == "true" else trial.scenery.T_world_base_registered
            tip = bases[arm] @ fk(model, array[:, :6])
            place = np.column_stack([table[f"{arm}_tip_{kind}_{axis}_m"] for axis in "xyz"])
            np.testing.assert_allclose(place, tip.translation_m, atol=1e-8)
            turned = np.column_stack([table[f"{arm}_tip_{kind}_q{part}"] for part in "wxyz"])
            np.testing.assert_allclose(SO3.from_quaternion(turned).matrix, tip.rotation.matrix, atol=1e-7)
            assert ((turned[1:] * turned[:-1]).sum(axis=1) > 0).all(), "a quaternion jumps to its negative"
    block = np.column_stack([table[f"block0_{name}"] for name in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")])
    np.testing.assert_allclose(block, trial.arrays["body_block0"], rtol=1e-7)


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([True, None, np.bool_(False)], "truth"),
        ([1, None, 2], "integer"),
        ([1, 2.5, None], "number"),
        ([1, "a"], "text"),
        ([1, True], "text"),
        ([None], "text"),
        ([], "text"),
    ],
)
def test_a_column_has_the_type_that_fits_all_of_its_values(values, kind):
    assert kind_of(values) == kind


def test_every_column_of_every_table_is_explained(folder):
    said = {(row["table"], row["column"]): row for row in read(folder / "columns.csv")}
    found = {(path.stem, name) for path in folder.glob("*.csv") if path.stem != "columns" for name in read(path)[0]}
    found |= {("samples", name) for name in read(next((folder / "samples").iterdir()))[0]}
    assert set(said) == found
    assert all(row["about"] for row in said.values())
    assert said["samples", "psm1_q3_true_m"]["unit"] == "m"
    for (_, name), row in said.items():
        assert not row["unit"] or name.endswith(f"_{row['unit'].lower()}"), f"{name} has its unit in its name"


def test_the_docs_name_every_column_that_all_runs_have():
    page = (Path(__file__).parents[2] / "docs" / "replays.md").read_text()
    for column in (column for name, columns in TABLES.items() if name != "columns" for column in columns):
        assert f"`{column.name}`" in page


def test_parquet_has_the_same_rows_with_types(folder, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    for _ in range(2):  # its own files are replaced
        export_trials([short_trial(), short_trial(2, session=1)], tmp_path, "parquet")
    goals = pq.read_table(tmp_path / "goals.parquet")
    assert goals.num_rows == 24 and str(goals.schema.field("succeeded").type) == "bool"
    assert goals.column("transfer_source").to_pylist() == [
        int(r["transfer_source"]) for r in read(folder / "goals.csv")
    ]
    samples = pq.read_table(tmp_path / "samples" / "session_01_trial_002.parquet")
    np.testing.assert_array_equal(
        samples.column("psm1_q4_true_rad").to_numpy(), short_trial(2, session=1).arrays["true_psm1"][:, 3].astype(float)
    )
    assert {path.stem for path in tmp_path.iterdir()} == {path.stem for path in folder.iterdir()}


@pytest.mark.parametrize("columns", [1, 2000])
def test_a_parquet_file_of_somebody_else_is_not_replaced_and_its_own_is_however_wide(columns, tmp_path):
    pytest.importorskip("pyarrow")
    table = FlatTable("samples", tuple(Column(f"c{k}", "") for k in range(columns)), (["a"],) * columns)
    for _ in range(2):
        table.write_parquet(tmp_path / "mine.parquet")
    (tmp_path / "mine.parquet").write_bytes(b"PAR1 theirs")
    with pytest.raises(TrocarError, match="not a table of samples"):
        table.write_parquet(tmp_path / "mine.parquet")


def test_without_pyarrow_one_sentence_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(TrocarError, match=r"--format parquet needs pyarrow; .*\[parquet\].*, or use csv"):
        export_trials([short_trial()], tmp_path / "tables", "parquet")
    assert not (tmp_path / "tables").exists()
    assert set(FORMATS) == {"csv", "parquet"}
