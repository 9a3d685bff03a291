"""Output on terminals with limited encodings or widths."""

import io
import os
import sys

import pytest
from rich.console import Console

from trocar.cli import prepare_streams


def test_text_that_an_encoding_lacks_is_written_as_an_escape(monkeypatch):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii", errors="strict"))
    prepare_streams()
    Console().print("files: é/run.json", soft_wrap=True)
    sys.stdout.flush()
    assert written.getvalue() == b"files: \\xe9/run.json\n"


@pytest.mark.parametrize(("columns", "width"), [("0", 80), ("-1", 80), ("many", 80), ("3", 80), ("120", 120)])
def test_a_width_that_is_none_counts_as_not_given(monkeypatch, columns, width):
    monkeypatch.setenv("COLUMNS", columns)
    prepare_streams()
    assert os.environ.get("COLUMNS", "80") == str(width)
    assert Console(file=io.StringIO()).width == width
