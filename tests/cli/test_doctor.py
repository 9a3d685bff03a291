"""``trocar doctor`` reports correctly what is installed."""

import shlex
import sys

import pytest

from trocar import __version__
from trocar.cli import doctor, main, options
from trocar.extras import EXTRAS, how_to_install


@pytest.fixture
def say(monkeypatch, capsys):
    def command(*words):
        monkeypatch.setattr(sys, "argv", ["trocar", *words])
        with pytest.raises(SystemExit) as stop:
            main()
        return stop.value.code or 0, capsys.readouterr().out

    return command


def without(monkeypatch, *missing):
    """Pretend that these modules are not installed."""
    for module in (doctor, options):
        found = module.find_spec
        monkeypatch.setattr(module, "find_spec", lambda name, found=found: None if name in missing else found(name))


def test_it_names_the_version_and_every_extra(say):
    code, out = say("doctor")
    assert code == 0
    assert __version__ in out
    for extra in EXTRAS:
        assert f"\n{extra}: " in out


def test_what_it_says_to_type_next_is_a_command(say, monkeypatch):
    _, out = say("doctor")
    words = shlex.split(out.strip().splitlines()[-1].removeprefix("next: "))
    assert words[0] == "trocar"
    code, text = say(words[1], "--help")
    assert code == 0
    for option in (word for word in words if word.startswith("--")):
        assert option in text


def test_a_missing_extra_comes_with_its_remedy(say, monkeypatch):
    without(monkeypatch, "mujoco", "jax")
    code, out = say("doctor")
    assert code == 0
    assert f"missing mujoco: {how_to_install('sim')}" in out
    assert f"missing jax: {how_to_install('learn')}" in out
    assert "calibrate" in out.splitlines()[-1]


def test_commands_that_need_a_missing_extra_say_the_same(monkeypatch, capsys, tmp_path):
    without(monkeypatch, "mujoco")
    monkeypatch.setattr(sys, "argv", ["trocar", "run", "peg-transfer", "--out", str(tmp_path / "run")])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "pip install '.[sim]'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
