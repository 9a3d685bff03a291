"""The engine of studies: conditions, the order of the work, rows, what is missing."""

import json

import pytest

from made_up_study import saved
from trocar.errors import InvalidInput, UnknownName
from trocar.eval.jobs import opened
from trocar.eval.study import RowKind, chosen, conditions_of, read_study, row_file
from trocar.eval.trial import trial_file
from trocar.report.sweep import KIND
from trocar.tasks.debridement.task import Debridement
from trocar.tasks.peg_transfer.task import PegTransfer


def test_all_that_there_is_is_chosen_by_default_and_what_there_is_not_is_refused():
    assert chosen("", ["a", "b"], "methods") == ["a", "b"]
    assert chosen("b, a", ["a", "b"], "methods") == ["b", "a"]
    with pytest.raises(UnknownName, match="--methods 'c' is unknown; choose one of a, b"):
        chosen("a,c", ["a", "b"], "methods")


def test_conditions_are_values_times_methods(tmp_path):
    found = conditions_of(Debridement, tmp_path, sessions=2, trials=3, options={"fragments": 2})
    assert [one.folder.name for one in found] == [
        f"{arms}-{method}" for arms in ("one-arm", "two-arms") for method in ("best", "best-1cm", "paper")
    ]
    assert all(len(one.places) == 6 and one.config.task.fragments == 2 for one in found)
    assert len({one.config.fingerprint for one in found}) == 6


def test_only_methods_that_compensate_get_a_model(tmp_path):
    found = conditions_of(PegTransfer, tmp_path, values="unilateral", methods="best,uncalibrated", model="ridge")
    assert [one.config.model for one in found] == ["ridge", ""]
    with pytest.raises(InvalidInput, match="--model ridge has no effect with uncalibrated"):
        conditions_of(PegTransfer, tmp_path, methods="uncalibrated", model="ridge")


def test_trials_come_session_by_session_and_only_those_that_lack(tmp_path):
    for one in saved(tmp_path, sessions=2):
        (one.folder / "session_01" / "trial_000.npz").unlink()
    more = conditions_of(
        PegTransfer, tmp_path, values="unilateral", methods="calibrated,uncalibrated", sessions=3, seed=2
    )
    sessions, trials = opened(more)
    assert [(order.session, order.folder.name) for order in trials] == [
        (session, f"unilateral-{method}") for session in (1, 2) for method in ("calibrated", "uncalibrated")
    ]
    assert [order.session for order in sessions] == [1, 2]
    assert [len(order.runs) for order in sessions] == [2, 2]


def test_a_row_is_kept_and_made_again_where_it_does_not_fit(tmp_path):
    one = saved(tmp_path, sessions=1)[0]
    path = trial_file(one.folder, 0, 0)
    first = KIND.read(path, one.config.fingerprint)
    kept = RowKind(KIND.row, lambda trial: pytest.fail("it was made again"), KIND.version)
    assert kept.read(path, one.config.fingerprint) == first
    for text in ("", "[]", json.dumps({"version": 0}), row_file(path).read_text().replace('"goals"', '"other"')):
        row_file(path).write_text(text)
        assert KIND.read(path, one.config.fingerprint) == first
    made = []
    for other in (RowKind(KIND.row, made.append, KIND.version + 1), RowKind(KIND.row, made.append)):
        with pytest.raises(TypeError):
            other.read(path, one.config.fingerprint if other.version > 1 else "another run's")
    assert len(made) == 2


def test_what_is_missing_is_said(tmp_path):
    conditions = saved(tmp_path, sessions=2)
    trial_file(conditions[0].folder, 1, 0).unlink()
    results, missing = read_study(conditions, KIND)
    assert [len(result.rows) for result in results] == [1, 2]
    assert len(missing) == 1 and "session_01" in missing[0]
    assert results[1].by_session(lambda row: row.succeeded) == {0: [6], 1: [6]}
    for one in conditions:
        for path in one.folder.glob("session_*/*"):
            path.unlink()
    with pytest.raises(InvalidInput, match="no trial that can be read"):
        read_study(conditions, KIND)


def test_no_more_than_one_trial_is_alive_at_a_time(tmp_path, alive):
    read_study(saved(tmp_path, sessions=1, trials=3), KIND)
    assert (len(alive), max(alive)) == (6, 0)
