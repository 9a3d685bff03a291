"""Figures of the docs: pages show what was measured, and figures older than the code are detected."""

import json
import shutil
import subprocess

import pytest

import figures
import measure_figures
from declared_figures import Measurement, Record, read_measurements
from figure_tables import OfMachine, bare, fixed, percent, spread
from measure_figures import read_answer
from trocar.errors import TrocarError

DECLARED = """
[sources]
everything = ["code.py"]

[measured.drops]
command = "python code.py"
keep = ["runs.*.count", "rate"]
index = { runs = "name" }
sources = ["everything"]
minutes = 0.1

[measured.speed]
command = "python code.py --times"
find = { all_ms = 'took ([\\d.]+) ms' }
machine = ["all_ms"]
sources = ["code.py"]
minutes = 5
"""
CODE = """
import json, sys
if "--times" in sys.argv:
    print("one took 2.5 ms\\\\ntwo took 4 ms")
else:
    runs = [{"name": "slow", "count": 3, "no": 1}, {"name": "fast", "count": 4, "no": 1}]
    print(json.dumps({"runs": runs, "rate": 0.0625, "no": 2}))
"""
TEMPLATE = """| drops | rate | printed by |
|---|---|---|
| {{ drops.runs.fast.count }} | {{ drops.rate | percent }} % | `{{ drops.command }}` |
"""
TIMES = "| {{ speed.all_ms | max | fixed(1) }} ms |"
PAGE = "# Title\n\nBefore.\n\n" + "\n\nBetween.\n\n".join(
    f"<!-- figures: {name} -->\n<!-- /figures -->" for name in ("drops", "times")
)


def git(root, *words):
    author = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *author, *words], cwd=root, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A small repository with two measurements, two tables and one page."""
    root = tmp_path / "repository"
    for path, text in (
        ("docs/figures/all.toml", DECLARED),
        ("docs/figures/tables/drops.md.j2", TEMPLATE),
        ("docs/figures/tables/times.md.j2", TIMES),
        ("README.md", PAGE),
        ("code.py", CODE),
    ):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    git(tmp_path, "init", "-q", str(root))
    git(root, "add", ".")
    git(root, "commit", "-qm", "first")
    monkeypatch.setattr(measure_figures, "is_busy", lambda: False)
    monkeypatch.setattr(figures, "is_busy", lambda: False)
    return root


def test_the_pages_of_this_repository_are_what_was_measured():
    assert figures.Figures(figures.ROOT).wrong() == []


def test_measuring_writes_what_commands_print_into_the_page_and_nothing_else(repository, capsys):
    assert figures.main(["check"], repository) == 1
    assert figures.main(["measure"], repository) == 0
    page = (repository / "README.md").read_text()
    assert "| 4 | 6.2 % | `python code.py` |" in page
    assert "| 4.0† ms |" in page
    assert f"† depends on the machine: {measure_figures.machine_name()}." in page
    assert page.startswith("# Title\n\nBefore.\n\n<!-- figures: drops -->\n")
    assert "<!-- /figures -->\n\nBetween.\n" in page
    record = json.loads((repository / "docs/figures/measured/drops.json").read_text())
    assert record["values"] == {"runs": {"slow": {"count": 3}, "fast": {"count": 4}}, "rate": 0.0625}
    assert record["commit"] == git(repository, "rev-parse", "--short", "HEAD").strip()
    assert figures.main(["check"], repository) == 0
    capsys.readouterr()
    assert figures.main(["measure"], repository) == 0
    assert capsys.readouterr().out.startswith("0 to measure")


def test_what_somebody_types_into_a_table_is_found_and_put_right(repository, capsys):
    figures.main(["measure"], repository)
    page = repository / "README.md"
    good = page.read_text()
    page.write_text(good.replace("| 4 |", "| 5 |"))
    assert figures.main(["check"], repository) == 1
    assert "README.md: tables are not what was measured" in capsys.readouterr().out
    assert figures.main(["write"], repository) == 0
    assert page.read_text() == good


def test_another_command_than_the_recorded_one_is_wrong(repository, capsys):
    figures.main(["measure"], repository)
    declared = repository / "docs/figures/all.toml"
    declared.write_text(declared.read_text().replace('"python code.py"', '"python code.py --seed 2"'))
    assert figures.main(["check"], repository) == 1
    assert "drops was measured by 'python code.py', but is declared as" in capsys.readouterr().out


def test_a_table_is_older_than_code_that_has_changed_and_names_the_file(repository, capsys):
    figures.main(["measure"], repository)
    (repository / "code.py").write_text(CODE + "faster = True\n")
    capsys.readouterr()
    assert figures.main(["check"], repository) == 0
    told = capsys.readouterr().out
    assert "older than the code: drops (README.md) measured at" in told
    assert "since then have changed: code.py" in told
    assert figures.main(["measure", "drops"], repository) == 1
    assert "code.py is not committed" in capsys.readouterr().out


def test_comments_and_docstrings_make_no_table_older(repository, capsys):
    figures.main(["measure"], repository)
    capsys.readouterr()
    (repository / "code.py").write_text(f'"""Counts drops."""\n{CODE}\n# Faster than before.\n')
    assert figures.main(["check"], repository) == 0
    assert "older than the code: drops" not in capsys.readouterr().out


def test_code_that_changes_while_it_is_measured_gives_no_figure(repository, monkeypatch, capsys):
    def run(root, line):
        (root / "code.py").write_text(CODE + f"# {line}\n")
        return '{"runs": [], "rate": 1}'

    monkeypatch.setattr(measure_figures, "_run", run)
    assert figures.main(["measure", "drops"], repository) == 1
    assert "the sources of drops have changed while it was measured" in capsys.readouterr().out
    assert not (repository / "docs/figures/measured/drops.json").exists()


def test_without_the_history_the_age_is_told_from_the_files_and_nothing_crashes(repository, capsys):
    figures.main(["measure"], repository)
    shutil.rmtree(repository / ".git")
    capsys.readouterr()
    assert figures.main(["check"], repository) == 0
    assert "2 of 2 measurements are of today's code" in capsys.readouterr().out
    (repository / "code.py").write_text(CODE + "faster = True\n")
    assert figures.main(["check"], repository) == 0
    assert "which this clone does not have" in capsys.readouterr().out
    assert figures.main(["measure", "drops"], repository) == 1
    assert "are measured in a git checkout" in capsys.readouterr().out


def test_times_are_not_measured_on_a_busy_machine_and_long_ones_can_be_left_out(repository, monkeypatch, capsys):
    monkeypatch.setattr(figures, "is_busy", lambda: True)
    assert figures.main(["measure", "--at-most", "1"], repository) == 0
    assert "1 to measure" in capsys.readouterr().out
    assert figures.main(["measure", "speed"], repository) == 1
    assert "this machine is busy" in capsys.readouterr().out
    assert figures.main(["measure", "speed", "--busy"], repository) == 0


def test_what_cannot_be_is_told_in_a_sentence(repository, capsys):
    assert figures.main(["measure", "love"], repository) == 2
    assert "measurement 'love' is unknown; choose of drops, speed" in capsys.readouterr().err
    (repository / "docs/figures/tables/drops.md.j2").write_text("{{ drops.rates }}")
    figures.main(["measure"], repository)
    assert figures.main(["check"], repository) == 1
    assert "template of table 'drops': " in capsys.readouterr().out
    (repository / "docs/figures/all.toml").write_text('[measured.a]\ncommand = "x"\nsources = []\nwhen = 1')
    assert figures.main(["check"], repository) == 2
    assert "unexpected keyword argument 'when'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("measurement", "answer", "words"),
    [
        ({"keep": ("a.b",)}, '{"a": {"c": 1}}', "a.b: there is no 'b' in what the command printed"),
        ({"keep": ("a",)}, "warning: no", "the command printed no JSON: 'warning: no'"),
        ({"find": {"p50": r"p50 (\d+)"}}, "p95 7", "p50 is not in what the command printed"),
    ],
)
def test_an_answer_that_lacks_something_is_refused(measurement, answer, words):
    with pytest.raises(TrocarError, match=words):
        read_answer(Measurement("m", "python x", (), 1.0, **measurement), answer)


def test_all_matches_and_all_groups_of_a_pattern_are_kept():
    asked = Measurement("m", "python x", (), 1.0, find={"pairs": r"^(\w+) (\d+\.?\d*)$", "one": r"b (\d+)"})
    assert read_answer(asked, "a 1.5\nb 2\n") == {"pairs": ["a", 1.5, "b", 2], "one": 2}


def test_numbers_are_shown_as_tables_show_them():
    assert [bare(v, 2) for v in (0.083, 3.529, -0.5, 0.0, 0.001)] == [".08", "3.53", "-.50", "0", "0"]
    assert [percent(v) for v in (0.9363, 1.0, 0.0, 0.0767)] == ["93.6", "100", "0", "7.7"]
    assert spread({"mean": 3.42, "low": 3.41, "high": 3.43}, 2) == "3.42 ± 0.01"
    assert fixed(OfMachine(7.2), 1) == "7.2†"


def test_every_record_is_of_a_declared_measurement_and_says_where_it_is_from():
    declared = read_measurements(figures.ROOT)
    for path in (figures.ROOT / "docs/figures/measured").glob("*.json"):
        record = Record(**{k: v for k, v in json.loads(path.read_text()).items() if k != "made_by"})
        assert path.stem in declared
        assert record.digest or record.origin, path.stem
    assert all((figures.ROOT / name.removeprefix("!")).exists() for m in declared.values() for name in m.sources)
