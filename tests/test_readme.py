import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from synthetic import synthetic_trial
from trocar.cli import app
from trocar.report import summarise
from trocar.trials import Plan

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_first_lines_of_python_run():
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    result = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True, check=True)
    duration, bound = map(float, re.findall(r"(\d+\.\d+) s", result.stdout))
    assert bound < duration < 2 * bound


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_that_a_page_names_exists(page):
    lines = re.findall(r"(?:`|^)trocar ([^`\n]+)", page.read_text(), re.MULTILINE)
    for line in lines:
        words = line.split("#")[0].split()
        command = [word for word in words[:2] if re.fullmatch(r"[a-z]+", word)]
        text = CliRunner().invoke(app, [*command, "--help"])
        assert text.exit_code == 0, line
        for option in (word for word in words if word.startswith("--") and word != "--help"):
            assert option in text.output, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_links_exists(page):
    for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_the_docs_list_every_key_of_the_summary():
    section = (ROOT / "docs" / "peg_transfer.md").read_text().split("Keys of `summary.json`")[1]
    first_column = re.findall(r"^\| ([^|]*`[^|]*) \|", section, re.MULTILINE)
    listed = {key for cell in first_column for key in re.findall(r"`(\w+)`", cell)}
    assert listed == set(summarise([synthetic_trial(Plan())]))
