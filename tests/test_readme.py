import json
import re
import shlex
from functools import cache
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from processes import python
from synthetic import synthetic_trial
from trocar.cli import app
from trocar.cli.group import Deferred
from trocar.report.files import report_of
from trocar.report.summary import summarise

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_first_lines_of_python_run(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    result = python(["-c", block], tmp_path)
    assert result.returncode == 0, result.stderr
    duration, bound = map(float, re.findall(r"(\d+\.\d+) s", result.stdout))
    assert bound < duration < 2 * bound


def test_the_lines_of_python_of_the_quick_start_run(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "quickstart.md").read_text(), re.DOTALL)
    own = "\n".join(block for block in blocks if "--8<--" not in block)  # tests/test_examples.py runs the included ones
    result = python(["-c", own], tmp_path)
    assert result.returncode == 0, result.stderr


def test_what_is_to_be_read_in_a_day_exists_and_is_no_more_than_that():
    named = re.findall(r"`((?:src/trocar|examples)/[^`]+\.py)`", (ROOT / "docs" / "reading.md").read_text())
    assert len(named) == len(set(named)) > 30
    assert sum(len((ROOT / name).read_text().splitlines()) for name in named) < 9500


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_that_a_page_names_exists(page):
    lines = re.findall(r"(?:`|^)(?:\.venv/bin/)?trocar ([^`\n]+)", page.read_text(), re.MULTILINE)
    for line in lines:
        words = line.split("#")[0].split()
        text = help_of(*path_of(words))
        assert text.exit_code == 0, line
        for option in (word.split("=")[0] for word in words if word.startswith("--") and word != "--help"):
            assert option in text.output, line


@cache
def help_of(*command):
    return CliRunner().invoke(app, [*command, "--help"])


PARSED = """
import json, shlex, sys
from trocar.cli import main
from trocar.cli.group import Command
Command.invoke = lambda self, ctx: None
for line in json.loads(sys.argv[1]):
    sys.argv = ["trocar", *shlex.split(line.partition(" > ")[0].removesuffix("&"), comments=True)]
    try:
        main()
    except SystemExit as end:
        if end.code:
            print("refused:", line)
"""
BLOCK = re.compile(r"```[a-z]*\n(.*?)```", re.DOTALL)
COMMAND_LINE = re.compile(r"^(?:\.venv/bin/)?trocar (.+)$", re.MULTILINE)


def test_every_line_of_a_code_block_is_parsed():
    """Options exist and values are of their type, as when it is typed in a clone; nothing is run."""
    blocks = [block for page in PAGES for block in BLOCK.findall(page.read_text())]
    lines = [line for block in blocks for line in COMMAND_LINE.findall(block)]
    assert len(lines) > 60
    result = python(["-c", PARSED, json.dumps(lines)], ROOT)
    assert result.returncode == 0 and "refused" not in result.stdout, f"{result.stdout}\n{result.stderr}"


def test_the_waypoints_that_a_page_writes_are_planned_as_it_says(tmp_path):
    text = (ROOT / "docs" / "motion.md").read_text().replace("examples/", f"{ROOT / 'examples'}/")
    write, plan = re.search(r"^(python -c .+)\ntrocar (plan transfer .+)$", text, re.MULTILINE).groups()
    assert python(shlex.split(write)[1:], tmp_path).returncode == 0
    result = python(["-c", "from trocar.cli import main; main()", *shlex.split(plan), "--json"], tmp_path)
    (motion,) = json.loads(result.stdout)["motions"]
    assert motion["found"] and motion["vertical_deviation_m"] < 2e-3, result.stderr


def path_of(words):
    """Return the leading words that name a command; a word that stands for a name (TASK) is one of them."""
    group, path = get_command(app), []
    for word in words:
        if not hasattr(group, "list_commands") or word.startswith("-"):
            break
        context = group.make_context(" ".join(path), [], resilient_parsing=True)
        name = group.list_commands(context)[0] if word == "TASK" else word
        if name in ("own-task", "dots"):  # from examples, which tests/test_examples.py runs
            name = "peg-transfer"
        path.append(name)
        found = group.get_command(context, name)
        assert found is not None, f"no command {' '.join(path)!r}"
        group = found.load() if isinstance(found, Deferred) else found
    return path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_links_exists(page):
    for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_the_docs_list_every_key_of_the_summary():
    section = (ROOT / "docs" / "peg_transfer.md").read_text().split("Keys of `summary.json`")[1]
    first_column = re.findall(r"^\| ([^|]*`[^|]*) \|", section, re.MULTILINE)
    listed = {key for cell in first_column for key in re.findall(r"`(\w+)`", cell)}
    trial = synthetic_trial()
    assert listed == set(summarise([trial], report_of(trial)))
