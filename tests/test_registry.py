"""Things by name: built in, registered, from a plugin."""

import os
import pickle
import sys

import pytest

from trocar.errors import TrocarError
from trocar.registry import PLUGIN_MODULE, Lazy, Registry, load_plugin


def fresh():
    return Registry("colour", "trocar.nothing_has_this_group", {"red": 1, "half": Lazy("fractions:Fraction")})


def test_things_are_picked_by_name_and_lazy_ones_are_loaded_then():
    table = fresh()
    assert table.pick("red") == 1
    assert table.pick("half")(1, 2) == 0.5
    assert list(table) == ["red", "half"] and len(table) == 2


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(TrocarError, match="colour 'blue' is unknown; choose one of red, half"):
        fresh().pick("blue")


def test_a_name_can_be_taken_once():
    table = fresh()
    table.register("blue", 3)
    assert table["blue"] == 3
    with pytest.raises(TrocarError, match="colour 'blue' is already registered"):
        table.register("blue", 4)
    with pytest.raises(TrocarError, match="a colour is registered as 5; give it a name"):
        table.register(5, 4)


def test_entry_points_of_installed_packages_are_found():
    table = Registry("task", "trocar.tasks")
    assert {"peg-transfer", "suture"} <= set(table)
    names = list(table)
    assert table[names[-1]].name == names[-1]
    assert list(table) == names, "what is loaded first is not listed first"


def test_a_plugin_is_run_once_and_told_by_its_text(tmp_path, monkeypatch):
    file = tmp_path / "mine.py"
    file.write_text("import os\nos.environ['TROCAR_TEST'] = os.environ.get('TROCAR_TEST', '') + 'x'\n")
    monkeypatch.setenv("TROCAR_TEST", "")
    first = load_plugin(file)
    assert load_plugin(str(file)) == first
    assert os.environ["TROCAR_TEST"] == "x"
    file.write_text("VALUE = 2\n")
    assert load_plugin(file) != first


def test_plugins_of_one_file_name_keep_their_own_module(tmp_path):
    digests = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        file = tmp_path / folder / "mine.py"
        file.write_text(f"class Mine:\n    folder = {folder!r}\n")
        digests.append(load_plugin(file))
    first, second = (sys.modules[f"{PLUGIN_MODULE}mine_{digest[:8]}"].Mine for digest in digests)
    assert (first.folder, second.folder) == ("a", "b")
    assert pickle.loads(pickle.dumps(first)) is first, "as a worker does"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (None, "is not a Python file"),
        ("1 / 0", "cannot be loaded, line 1: ZeroDivisionError"),
        ("def", "cannot be loaded: SyntaxError"),
        ("import nothing_of_this_name", "line 1: ModuleNotFoundError: No module named 'nothing_of"),
        ("raise SystemExit(0)", "cannot be loaded, line 1: SystemExit"),
        ("\0", "cannot be loaded"),
    ],
)
def test_a_plugin_that_is_not_there_or_fails_is_a_sentence(tmp_path, text, match):
    file = tmp_path / "broken.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(TrocarError, match=match):
        load_plugin(file)
