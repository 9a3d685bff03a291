import re
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_that_a_page_names_exists(page):
    lines = re.findall(r"(?:`|^)(?:\.venv/bin/)?trocar ([^`\n]+)", page.read_text(), re.MULTILINE)
    for line in lines:
        words = line.split("#")[0].split()
        command = path_of(words)
        text = CliRunner().invoke(app, [*command, "--help"])
        assert text.exit_code == 0, line
        for option in (word.split("=")[0] for word in words if word.startswith("--") and word != "--help"):
            assert option in text.output, line


def path_of(words):
    """Return the leading words that name a command; a word that stands for a name (TASK) is one of them."""
    group, path = get_command(app), []
    for word in words:
        if not hasattr(group, "list_commands") or word.startswith("-"):
            break
        context = group.make_context(" ".join(path), [], resilient_parsing=True)
        name = group.list_commands(context)[0] if word == "TASK" else word
        if name == "own-task":  # from examples/own_task.py, which tests/test_examples.py runs
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
