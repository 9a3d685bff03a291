"""The preparation of a session: which runs share the models of its cables, and that nothing depends on the cache."""

import tomllib
from pathlib import Path
from types import SimpleNamespace

from synthetic import config
from trocar.eval import prepare as preparing
from trocar.eval.config import RunConfig
from trocar.eval.prepare import (
    CACHE,
    NO_PART,
    _source_digest,
    cable_file,
    cached_calibrations,
    calibration_key,
    prepare,
)
from trocar.tasks.peg_transfer.task import PegTransfer

ONE = PegTransfer(transfers=1)


def test_models_are_shared_where_nothing_differs_that_they_depend_on():
    run = config(model="offset")
    same = [
        RunConfig(ONE, model="offset", calibration="joints", difficulty="mild"),
        config(model="offset", planner="spline", new_session=True, trials=5),
        config(model="offset", method="optimized", settings=("settle_s=0.2",)),
    ]
    other = [config(model="ridge"), config(model="offset", seed=1), config(model="offset", flawless_camera=True)]
    key = calibration_key(run, 0, "psm1")
    assert {calibration_key(one, 0, "psm1") for one in same} == {key}
    assert key not in {calibration_key(one, 0, "psm1") for one in other} | {calibration_key(run, 1, "psm1")}


def test_models_outlast_changes_to_tasks_and_not_to_what_calibrates(tmp_path, monkeypatch):
    for name in ("tasks", "calibration"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "code.py").write_text("x = 1")
    monkeypatch.setattr(preparing, "trocar", SimpleNamespace(__file__=tmp_path / "__init__.py"))
    before = _source_digest.__wrapped__()
    (tmp_path / "tasks" / "code.py").write_text("x = 2")
    assert _source_digest.__wrapped__() == before
    (tmp_path / "calibration" / "code.py").write_text("x = 2")
    assert _source_digest.__wrapped__() != before


def test_what_calibrates_imports_nothing_of_the_packages_whose_changes_do_not_matter():
    contracts = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(contract["layers"] for contract in contracts["contracts"] if contract["type"] == "layers")
    above = " | ".join(layers[: layers.index("trocar.collect")]).split(" | ")
    assert {f"trocar.{package}" for package in NO_PART} == {*above} - {"trocar.eval"}, "what collects imports none"


def test_a_damaged_or_forbidden_cache_is_no_trouble(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv(CACHE, str(cache))
    run = config(model="offset")
    prepare(run, 0, tmp_path / "first")
    (known,) = cached_calibrations()
    known.write_bytes(b"half a model")
    prepare(run, 0, tmp_path / "second")
    monkeypatch.setenv(CACHE, str(known))  # a file: nothing can be kept in it
    prepare(run, 0, tmp_path / "third")
    files = [cable_file(tmp_path / name, 0, "psm1").read_bytes() for name in ("first", "second", "third")]
    assert files[0] == files[1] == files[2]
