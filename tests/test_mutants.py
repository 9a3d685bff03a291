"""``benchmarks/mutants.py``: its mutants are valid Python, and are run against the tests of the file."""

import ast

import mutants
import pytest

FILE = "src/trocar/geometry/rigid_fit.py"


@pytest.fixture(scope="module")
def found():
    return mutants.mutants_of(mutants.ROOT / FILE)


def test_every_mutant_is_another_program_that_can_be_read(found):
    source = (mutants.ROOT / FILE).read_bytes()
    plain = ast.dump(ast.parse(source))
    assert len(found) > 10
    assert all(ast.dump(ast.parse(mutant.applied(source))) != plain for mutant in found)
    assert len({mutant.start for mutant in found}) == len(found), "one token, one mutant"


def test_words_of_several_tokens_are_turned_round(tmp_path, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    (tmp_path / "file.py").write_text("a = b is not c\nd = e not in f\ng = h in i\nj = not -k\n")
    source = (tmp_path / "file.py").read_bytes()
    broken = [mutant.applied(source).decode().splitlines() for mutant in mutants.mutants_of(tmp_path / "file.py")]
    plain = source.decode().splitlines()
    changed = [
        " ".join(line.split()) for lines in broken for line, old in zip(lines, plain, strict=True) if line != old
    ]
    assert changed == ["a = b is c", "d = e in f", "g = h not in i", "j = -k", "j = not k"]


def test_the_mirror_of_a_file_is_tried_first():
    used = {path: mutants.imports_of(path) for path in (mutants.ROOT / "tests" / "geometry").glob("test_*.py")}
    assert mutants.tests_of(FILE, used)[0] == "tests/geometry/test_rigid_fit.py"
    assert mutants.tests_of("src/trocar/geometry/so3.py", used), "no mirror of its own, but those that import it"
    alone = mutants.tests_of("src/trocar/geometry/deeper/alone.py", {})
    assert "tests/geometry/test_groups.py" in alone, "nobody imports it: those of the nearest folder that has some"
