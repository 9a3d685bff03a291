"""``trocar doctor`` reports correctly what is installed."""

import shlex

import pytest

from trocar import __version__
from trocar.cli import installed, options
from trocar.extras import EXTRAS, how_to_install


def without(monkeypatch, *missing):
    """Pretend that these modules are not installed."""
    for module in (installed, options):
        found = module.find_spec
        monkeypatch.setattr(module, "find_spec", lambda name, found=found: None if name in missing else found(name))


def test_it_names_the_version_and_every_extra(trocar):
    code, out, _ = trocar("doctor")
    assert code == 0
    assert __version__ in out
    for extra in EXTRAS:
        assert f"\n{extra}: " in out


def test_what_it_says_to_type_next_is_a_command(trocar, monkeypatch):
    _, out, _ = trocar("doctor")
    words = shlex.split(out.strip().splitlines()[-1].removeprefix("next: "))
    assert words[0] == "trocar"
    code, text, _ = trocar(words[1], "--help")
    assert code == 0
    for option in (word for word in words if word.startswith("--")):
        assert option in text


def test_a_missing_extra_comes_with_its_remedy(trocar, monkeypatch):
    without(monkeypatch, "mujoco", "jax")
    code, out, _ = trocar("doctor")
    assert code == 0
    assert f"missing mujoco: {how_to_install('sim')}" in out
    assert f"missing jax: {how_to_install('learn')}" in out
    assert "calibrate" in out.splitlines()[-1]


@pytest.mark.parametrize(
    ("line", "extra"),
    [
        ("run peg-transfer --out out", "sim"),
        ("export run --out out --format mcap", "bags"),
        ("recording show a.bag", "bags"),
        ("recording import a.bag --out a.npz", "bags"),
        ("view run", "view"),
    ],
)
def test_a_command_that_needs_a_missing_extra_says_the_same(trocar, monkeypatch, tmp_path, line, extra):
    monkeypatch.chdir(tmp_path)
    without(monkeypatch, *EXTRAS[extra])
    code, _, err = trocar(*line.split())
    said = f"trocar: this command needs {', '.join(EXTRAS[extra])}; {how_to_install(extra)}\n"
    assert (code, err) == (2, said) and not list(tmp_path.iterdir())
