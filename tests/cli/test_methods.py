"""What methods are made of, and the cache of calibrations."""

import json
from dataclasses import dataclass, field
from functools import partial

from synthetic import config
from trocar.eval.method import METHODS, Method
from trocar.eval.prepare import CACHE, prepare


def test_methods_are_described_with_their_cost_and_settings(trocar):
    code, out, _ = trocar("methods", "peg-transfer")
    assert code == 0
    text = " ".join(out.split())
    for words in ("650 images of the arm", "settle_s=0.06", "planner: sqp", "settings: those of calibrated, but "):
        assert words in text
    found = json.loads(trocar("methods", "peg-transfer", "--json")[1])["methods"]
    assert list(found) == ["calibrated", "uncalibrated", "adaptive", "optimized", "best"]
    assert found["uncalibrated"]["cables"] == "encoder readings are taken at face value"
    assert "in each trial" in found["adaptive"]["cables"]
    assert found["calibrated"]["settings"]["settle_s"] == 0.06
    debridement = json.loads(trocar("methods", "debridement", "--json")[1])["methods"]
    assert debridement["best"]["robot"].startswith("wrapped by trocar.tasks.debridement")
    code, _, error = trocar("methods", "peg-transfr")
    assert code == 2 and "did you mean 'peg-transfer'" in error


def test_a_method_of_ones_own_is_described_whatever_its_agent_and_settings_are(trocar, registries):
    @dataclass(frozen=True)
    class Kinds:
        words: tuple[str, ...] = ("a", "b")
        table: dict = field(default_factory=lambda: {"a": 1})

    METHODS.register("peg-transfer/mine", Method("mine", partial(print, "mine"), Kinds))
    code, out, err = trocar("methods", "peg-transfer", "--json")
    assert code == 0, err
    mine = json.loads(out)["methods"]["mine"]
    assert "print" in mine["agent"] and mine["settings"] == {"words": "('a', 'b')", "table": "{'a': 1}"}


def test_the_cache_is_listed_and_emptied(trocar, tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    assert "0 cable models in the cache" in trocar("calibrate", "cache")[1]
    prepare(config(model="offset"), 0, tmp_path / "run")
    (tmp_path / "cache" / "mine.npz").write_bytes(b"")
    found = json.loads(trocar("calibrate", "cache", "--json")[1])
    assert found["folder"] == str(tmp_path / "cache") and len(found["files"]) == 1
    code, out, _ = trocar("calibrate", "cache", "--empty")
    assert code == 0 and "1 cable models removed" in out
    assert [file.name for file in (tmp_path / "cache").iterdir()] == ["mine.npz"]
