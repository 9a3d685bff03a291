"""The tutorial runs from its first cell to its last, and is stored in the repository without outputs.

Cells are run by Python itself, in order and in one namespace, as a kernel would: no notebook package is needed.
"""

import ast
import json
from pathlib import Path

import pytest

TUTORIAL = Path(__file__).parents[1] / "examples" / "tutorial.ipynb"
NOTEBOOK = json.loads(TUTORIAL.read_text(encoding="utf-8"))
CODE = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def last_value(source, namespace):
    """Run a cell and return the value of the expression at its end, None where there is none."""
    lines = ast.parse(source).body
    ends = lines[-1]
    if not isinstance(ends, ast.Expr):
        exec(compile(source, str(TUTORIAL), "exec"), namespace)
        return None
    exec(compile(ast.Module(lines[:-1], []), str(TUTORIAL), "exec"), namespace)
    return eval(compile(ast.Expression(ends.value), str(TUTORIAL), "eval"), namespace)


@pytest.fixture(scope="module")
def shown():
    """Return what each cell shows, by the text of its last line."""
    namespace = {"__name__": "__main__"}
    sources = ["".join(cell["source"]) for cell in CODE]
    return {source.splitlines()[-1]: last_value(source, namespace) for source in sources}


def test_it_is_kept_without_outputs():
    assert NOTEBOOK["nbformat"] == 4
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in CODE)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    assert TUTORIAL.stat().st_size < 20_000


@pytest.mark.slow
def test_all_cells_run_and_show_short_lines(shown):
    values = {line: repr(value) for line, value in shown.items() if value is not None}
    assert len(values) >= 10
    for line, text in values.items():
        assert len(text) < 250 and text.count("\n") <= 2, line


@pytest.mark.slow
def test_pictures_are_shown_and_the_trial_succeeded(shown):
    pictures = [value for line, value in shown.items() if line.startswith("plot(")]
    assert len(pictures) == 4
    assert all(picture._repr_png_().startswith(b"\x89PNG") for picture in pictures)
    assert "1 of 1 transfers" in repr(shown["trial"])
    assert "<table>" in shown["trial"]._repr_html_()
    assert shown["np.isfinite(reached).all(axis=1)"].tolist() == [True, False, True]
