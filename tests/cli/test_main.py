"""Exit codes for each cause of an error, and output on terminals with limited encodings or widths."""

import errno
import io
import json
import os
import sys

import pytest
from rich.console import Console

from trocar.cli import installed, prepare_streams
from trocar.errors import MachineError, TrocarError


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (TrocarError("the sentence"), 2, "trocar: the sentence\n"),
        (MachineError("the sentence"), 3, "trocar: the sentence\n"),
        (MemoryError(), 3, "trocar: there is not enough memory"),
        (OSError(errno.ENOSPC, "No space left on device", "/there"), 3, "('/there': No space left on device)"),
        (RuntimeError("the error"), 70, "a mistake in Trocar or in a plugin"),
    ],
)
def test_what_goes_wrong_is_told_by_the_exit_code(trocar, monkeypatch, error, code, said):
    def fails(extra):
        raise error

    monkeypatch.setattr(installed, "how_to_install", fails)
    monkeypatch.setattr(installed, "find_spec", lambda name: None)
    found, _, err = trocar("doctor")
    assert found == code and said in err
    assert ("Traceback" in err) == (code == 70)
    assert code == 70 or err.count("\n") == 1


@pytest.mark.parametrize("words", [("report", ""), ("run", "peg-transfer", "--out="), ("plan", "suture", "--out", "")])
def test_an_empty_word_is_refused(trocar, words):
    code, out, err = trocar(*words)
    assert (code, out) == (2, "") and "a word of the command is empty" in err


def test_doctor_tells_programs_too(trocar):
    code, out, _ = trocar("doctor", "--json")
    said = json.loads(out)
    assert code == 0 and said["extras"]["sim"]["mujoco"]


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
