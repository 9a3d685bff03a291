"""Exit codes for each cause of an error."""

import errno

import pytest

from trocar.cli import doctor
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

    monkeypatch.setattr(doctor, "how_to_install", fails)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    found, _, err = trocar("doctor")
    assert found == code and said in err
    assert ("Traceback" in err) == (code == 70)
    assert code == 70 or err.count("\n") == 1


@pytest.mark.parametrize("words", [("report", ""), ("run", "peg-transfer", "--out="), ("plan", "suture", "--out", "")])
def test_an_empty_word_is_refused(trocar, words):
    code, out, err = trocar(*words)
    assert (code, out) == (2, "") and "a word of the command is empty" in err


def test_doctor_tells_programs_too(trocar):
    import json

    code, out, _ = trocar("doctor", "--json")
    said = json.loads(out)
    assert code == 0 and said["extras"]["sim"]["mujoco"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("statoin", "list"), "trocar: command 'statoin' is unknown; did you mean 'station'? choose one of run"),
        (("calibrate", "evalute"), "trocar: command 'evalute' is unknown; did you mean 'evaluate'?"),
        (("register", "cell", "suture", "--seed", "abc"), "trocar: --seed is 'abc'; it should be a valid integer\n"),
        (("register", "cell", "suture", "--seed", "-1"), "trocar: --seed is '-1'; it should be greater than or equal"),
    ],
)
def test_a_mistyped_word_is_quoted_with_what_was_meant(trocar, words, said):
    code, out, err = trocar(*words)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
