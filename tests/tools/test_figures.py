"""Figures of the docs: pages show what was measured, and figures older than the code are detected."""

import json
import re
import shutil
import subprocess
import threading

import pytest

import figures
import measure_figures
from declared_figures import Measurement, Record, read_measurements
from figure_tables import bare, fixed, percent
from measure_figures import read_answer
from trocar.errors import TrocarError

DECLARED = """
[sources]
everything = ["code.py"]

[kept]
counts = ["runs.*.count"]

[measured.drops]
command = "python code.py"
keep = ["counts", "rate"]
index = { runs = "name" }
sources = ["everything"]
minutes = 0.1

[measured.speed]
command = "python code.py --times"
find = { all_ms = 'took ([\\d.]+) ms' }
alone = true
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
TRIALS = """
import os, re, sys
from pathlib import Path
import numpy as np
from trocar.eval.trial import FORMAT, VERSION
from trocar.files.archive import Archive

def force_n(session):
    return 2.0 * session

sessions, folder = int(re.search(r"--sessions (.d+)", " ".join(sys.argv))[1]), Path(sys.argv[-1])
for session in range(sessions):
    path = folder / f"session_{session:02d}" / "trial_000.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"format": FORMAT, "version": VERSION, "about": {"versions": CODE_VERSION}, "forces": force_n(session)}
    last_bit = 1e-15 * (os.environ["MACHINE"] == "another")
    Archive(header, {"q": np.full(3, force_n(session) + last_bit)}).save(path)
    with open("sessions_made", "a") as file:
        print(session, file=file)
print(f"{sessions} sessions, {sum(force_n(session) for session in range(sessions)):g} N")
"""
OF_TRIALS = """
[measured.trials]
command = "python trials.py --sessions 5"
run_with = "--out {folder}"
find = { force_n = 'sessions, (.*) N' }
sources = ["trials.py"]
minutes = 1
"""
HEADLINES = """{% from "phrases.j2" import headline %}
{% call headline("drops", drops, "3") %}{{ drops.runs.fast.count }}, {{ drops.rate | percent }} %{% endcall %}
"""
ALL = """{% from "phrases.j2" import row %}
{% call row("drops", drops, "3") %}{{ drops.runs.fast.count }}{% endcall %}
"""
TIMES = "| {{ speed.all_ms | max | fixed(1) }} ms |"
PAGE = "# Title\n\nBefore.\n\n<!-- figures: headlines -->\n<!-- /figures -->\n\nAfter.\n"
DOCS = "<!-- figures: all -->\n<!-- /figures -->\n\n<!-- figures: times -->\n<!-- /figures -->\n"


def git(root, *words):
    author = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *author, *words], cwd=root, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def repository(tmp_path):
    """A small repository with two measurements, three tables and two pages; what tables share is the real file."""
    root = tmp_path / "repository"
    for path, text in (
        ("docs/figures/all.toml", DECLARED),
        ("docs/figures/tables/headlines.md.j2", HEADLINES),
        ("docs/figures/tables/all.md.j2", ALL),
        ("docs/figures/tables/times.md.j2", TIMES),
        ("docs/figures/tables/phrases.j2", (figures.ROOT / "docs/figures/tables/phrases.j2").read_text()),
        ("README.md", PAGE),
        ("docs/figures.md", DOCS),
        ("code.py", CODE),
    ):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    git(tmp_path, "init", "-q", str(root))
    git(root, "add", ".")
    git(root, "commit", "-qm", "first")
    return root


def test_the_pages_of_this_repository_are_what_was_measured():
    assert figures.Figures(figures.ROOT).wrong() == []


def test_all_figures_are_few_enough_for_an_evening_of_two_cores():
    declared = read_measurements(figures.ROOT).values()
    rows = (figures.ROOT / "docs/figures/tables/all.md.j2").read_text().count("{% call row(")
    assert rows <= 24
    assert sum(each.minutes for each in declared) / figures.AT_ONCE <= 150
    assert all(2 * each.minutes <= sum(other.minutes for other in declared) for each in declared)


def test_measuring_writes_what_commands_print_into_the_pages_and_nothing_else(repository, capsys):
    assert figures.main(["check"], repository) == 1
    assert figures.main(["measure"], repository) == 0
    page, commit = (repository / "README.md").read_text(), git(repository, "rev-parse", "--short", "HEAD").strip()
    assert f"| drops | 4, 6.2 % | 3 | at `{commit}`: `python code.py` |" in page
    assert "| 4.0 ms |" in (repository / "docs/figures.md").read_text()
    assert page.startswith("# Title\n\nBefore.\n\n<!-- figures: headlines -->\n")
    assert page.endswith("<!-- /figures -->\n\nAfter.\n")
    record = json.loads((repository / "docs/figures/measured/drops.json").read_text())
    assert record["values"] == {"runs": {"slow": {"count": 3}, "fast": {"count": 4}}, "rate": 0.0625}
    assert record["commit"] == commit
    assert figures.main(["check"], repository) == 0
    capsys.readouterr()
    assert figures.main(["measure"], repository) == 0
    told = capsys.readouterr().out
    assert f"drops: of this code, measured on {record['date']}" in told and "0 to measure" in told


def test_records_are_written_by_the_thread_that_marks_older_ones_alone(repository):
    """Of two writers, one would overwrite what the other has just measured by the older record that it had read."""
    record = measure_figures.measure(repository, read_measurements(repository)["drops"], 1)
    path = repository / "docs/figures/measured/drops.json"
    assert record.values and not path.exists()
    figures.Figures(repository).keep("drops", record)
    assert json.loads(path.read_text())["digest"] == record.digest


def test_what_was_never_measured_is_said_in_the_docs_and_left_out_of_readme(repository):
    assert figures.main(["write"], repository) == 0
    assert "drops" not in (repository / "README.md").read_text()
    docs = (repository / "docs/figures.md").read_text()
    assert "| drops | not measured yet | 3 | `python code.py` |" in docs
    assert "Not measured yet: `python code.py --times`" in docs
    assert figures.Figures(repository).wrong() == []
    assert figures.main(["check"], repository) == 1


def test_the_longest_is_measured_first_two_at_a_time_and_what_compares_speeds_alone_at_the_end(
    repository, monkeypatch, capsys
):
    declared = repository / "docs/figures/all.toml"
    for name, minutes in (("short", 1), ("long", 9), ("middle", 5)):
        declared.write_text(
            f'{declared.read_text()}[measured.{name}]\ncommand = "python code.py"\nkeep = ["rate"]\n'
            f'sources = ["code.py"]\nminutes = {minutes}\n'
        )
    git(repository, "commit", "-qam", "more")
    running, begun, seen = set(), [], {}
    both = threading.Barrier(2)

    def measured(root, each, jobs, before):
        running.add(each.name)
        begun.append(each.name)
        if len(begun) <= 2:
            both.wait(10)
        seen[each.name] = set(running)
        running.discard(each.name)
        return Record(each.command, "0000000", {"rate": 0.5, "all_ms": 1, "runs": {"fast": {"count": 1}}}, "", "")

    monkeypatch.setattr(figures, "measure", measured)
    assert figures.main(["measure"], repository) == 0
    assert set(begun[:2]) == {"long", "middle"} and begun[-1] == "speed"
    assert max(len(seen["long"]), len(seen["middle"])) == 2 and seen["speed"] == {"speed"}
    assert "about 10 minutes of two idle cores" in capsys.readouterr().out


def test_what_somebody_types_into_a_table_is_found_and_put_right(repository, capsys):
    figures.main(["measure"], repository)
    page = repository / "README.md"
    good = page.read_text()
    page.write_text(good.replace("| 4, 6.2 % |", "| 5, 6.2 % |"))
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


def test_a_figure_of_older_code_fails_the_check_of_readme_and_leaves_it_when_it_is_written(repository, capsys):
    figures.main(["measure"], repository)
    (repository / "code.py").write_text(CODE + "faster = True\n")
    capsys.readouterr()
    assert figures.Figures(repository).wrong() == []  # what CI asks
    assert figures.main(["check"], repository) == 1
    told = capsys.readouterr().out
    assert "README is out of date: drops, measured on " in told
    assert "since then have changed: code.py" in told
    assert "older than the code: speed" in told
    assert figures.main(["write"], repository) == 0
    assert "drops" not in (repository / "README.md").read_text()
    assert re.search(r"\| 4 \| 3 \| at `\w+`, older code: ", (repository / "docs/figures.md").read_text())
    assert figures.Figures(repository).wrong() == []
    assert figures.main(["measure", "drops"], repository) == 1
    assert "code.py is not committed" in capsys.readouterr().out
    git(repository, "commit", "-qam", "faster")
    assert figures.main(["measure"], repository) == 0
    assert "| drops | 4, 6.2 % |" in (repository / "README.md").read_text()
    assert "older code" not in (repository / "docs/figures.md").read_text()


@pytest.fixture
def trials(repository, monkeypatch):
    """The same repository with a measurement of five sessions; gives its program anew, and which sessions it made."""

    def change(text):
        (repository / "trials.py").write_text(text)
        git(repository, "commit", "-qam", "changed")
        (repository / "sessions_made").unlink(missing_ok=True)

    def made():
        return [int(number) for number in (repository / "sessions_made").read_text().split()]

    monkeypatch.setenv("MACHINE", "this")
    declared = repository / "docs/figures/all.toml"
    declared.write_text(declared.read_text() + OF_TRIALS)
    table = repository / "docs/figures/tables/all.md.j2"
    table.write_text(table.read_text() + '{% call row("force", trials, "") %}{{ trials.force_n }}{% endcall %}\n')
    text = TRIALS.replace("(.d+)", r"(\d+)").replace("CODE_VERSION", "1")
    (repository / "trials.py").write_text(text)
    (repository / ".gitignore").write_text("out\nsessions_made\n")
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "trials")
    return text, change, made


def test_figures_are_carried_over_to_code_that_makes_the_same_trials(repository, trials, capsys):
    text, change, made = trials
    assert figures.main(["measure", "trials"], repository) == 0
    measured = git(repository, "rev-parse", "--short", "HEAD").strip()
    assert made() == [0, 1, 2, 3, 4]
    change(text.replace("2.0 * session", "float(session + session)").replace('"versions": 1', '"versions": 2'))
    later = git(repository, "rev-parse", "--short", "HEAD").strip()
    assert figures.main(["check"], repository) == 1
    assert figures.main(["measure", "--at-most", "1"], repository) == 0
    assert f"the first 2 sessions are the same as at {measured}, carried over" in capsys.readouterr().out
    assert made() == [0, 1]
    assert (
        f"| force | 20 |  | at `{measured}`, carried over to `{later}`: "
        in (repository / "docs/figures.md").read_text()
    )
    assert "trials" not in figures.Figures(repository).older()


@pytest.mark.parametrize("changed", ["2.5 * session", "2.0 * session + (session == 1) * 1e-15"])
def test_code_that_makes_other_trials_is_measured_again_in_all_sessions(repository, trials, changed, capsys):
    text, change, made = trials
    figures.main(["measure", "trials"], repository)
    change(text.replace("2.0 * session", changed))
    assert figures.main(["measure", "trials"], repository) == 0
    assert "carried over" not in capsys.readouterr().out
    assert made() == [0, 1, 0, 1, 2, 3, 4]
    assert json.loads((repository / "docs/figures/measured/trials.json").read_text())["same_at"] == ""


def test_figures_are_carried_over_on_a_machine_whose_last_bits_are_others(repository, trials, monkeypatch):
    text, change, made = trials
    figures.main(["measure", "trials"], repository)
    record = repository / "docs/figures/measured/trials.json"
    before = json.loads(record.read_text())
    change(text.replace("2.0 * session", "float(session + session)"))
    monkeypatch.setenv("MACHINE", "another")
    code = repository / f"out/figures/code-of-trials-{before['digest'][:8]}"
    code.with_suffix(".part").mkdir(parents=True)  # somebody stopped it while the files of that code were written
    assert figures.main(["measure", "trials"], repository) == 0
    assert made() == [0, 1] and not [*code.parent.glob("code-of-*")]
    after = json.loads(record.read_text())
    assert (after["values"], after["commit"]) == (before["values"], before["commit"]) and after["same_at"]
    assert after["trials"].keys() == before["trials"].keys() and after["trials"] != before["trials"]


def test_code_that_makes_other_trials_on_another_machine_too_is_measured_again(repository, trials, monkeypatch):
    text, change, made = trials
    figures.main(["measure", "trials"], repository)
    change(text.replace("2.0 * session", "2.0 * session + (session == 1) * 1e-15"))
    monkeypatch.setenv("MACHINE", "another")
    assert figures.main(["measure", "trials"], repository) == 0
    assert made() == [0, 1, 0, 1, 2, 3, 4]
    assert json.loads((repository / "docs/figures/measured/trials.json").read_text())["same_at"] == ""


@pytest.mark.parametrize("words", [["--again"], ["trials", "--again"]])
def test_all_sessions_are_measured_again_where_that_is_asked_for(repository, trials, words):
    text, change, made = trials
    figures.main(["measure", "trials"], repository)
    change(text.replace("2.0 * session", "float(session + session)"))
    assert figures.main(["measure", *words], repository) == 0
    assert made() == [0, 1, 2, 3, 4]


def test_code_that_changes_while_it_is_measured_gives_no_figure(repository, monkeypatch, capsys):
    def run(root, line):
        (root / "code.py").write_text(CODE + f"measured = {line!r}\n")
        return '{"runs": [], "rate": 1}'

    monkeypatch.setattr(measure_figures, "_run", run)
    assert figures.main(["measure", "drops"], repository) == 1
    assert "the sources of drops have changed while it was measured" in capsys.readouterr().out
    assert not (repository / "docs/figures/measured/drops.json").exists()


def test_without_the_history_the_age_is_told_from_the_files_comments_and_docstrings_aside(repository, capsys):
    figures.main(["measure"], repository)
    shutil.rmtree(repository / ".git")
    capsys.readouterr()
    (repository / "code.py").write_text(f'"""Counts drops."""\n{CODE}\n# Faster than before.\n')
    assert figures.main(["check"], repository) == 0
    assert "2 of 2 measurements are of today's code" in capsys.readouterr().out
    (repository / "code.py").write_text(CODE + "faster = True\n")
    assert figures.main(["check"], repository) == 1
    assert "which this clone does not have" in capsys.readouterr().out
    assert figures.main(["measure", "drops"], repository) == 1
    assert "are measured in a git checkout" in capsys.readouterr().out


def test_what_takes_long_can_be_left_out(repository, capsys):
    assert figures.main(["measure", "--at-most", "1"], repository) == 0
    assert "1 to measure" in capsys.readouterr().out
    assert not (repository / "docs/figures/measured/speed.json").exists()


def test_what_cannot_be_is_told_in_a_sentence(repository, capsys):
    assert figures.main(["measure", "love"], repository) == 2
    assert "measurement 'love' is unknown; choose one of drops, speed" in capsys.readouterr().err
    (repository / "docs/figures/tables/all.md.j2").write_text("{{ drops.rates }}")
    figures.main(["measure"], repository)
    assert figures.main(["check"], repository) == 1
    assert "template of table 'all': " in capsys.readouterr().out
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
    assert fixed(7.25, 1) == "7.2"


def test_every_record_is_of_a_declared_measurement_and_sources_exist():
    declared = read_measurements(figures.ROOT)
    assert {path.stem for path in (figures.ROOT / "docs/figures/measured").glob("*.json")} <= set(declared)
    assert all((figures.ROOT / name.removeprefix("!")).exists() for m in declared.values() for name in m.sources)
