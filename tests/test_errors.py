"""Errors keep their fields, also on the way to another process, and their sentences are made from them."""

import ast
import pickle
from pathlib import Path

import pytest

import trocar
from trocar import errors

MADE = [
    errors.InvalidInput("a trajectory", "needs two times, got 1", "give more"),
    errors.InvalidValue("the seed", -1, "give 0 or more"),
    errors.UnknownName("planner", "slpine", ["spline", "sqp"]),
    errors.BadFile("x.npz", "is no recording", "give another"),
    errors.NotInstalled("--format parquet", "pyarrow", "parquet"),
    errors.OutOfReach("too far", arm="psm1", joint="yaw", by=0.1),
    errors.OutsideWorkspace("psm1", "x = 3.0 mm", "[0.0, 1.0] mm"),
    errors.LimitExceeded("too fast", arm="psm1", ratio=1.2),
    errors.TooNear("too near", first="psm1 shaft", second="table", distance_m=1e-3, required_m=2e-3, arms=("psm1",)),
    errors.StartMismatch("psm1", "starts elsewhere", "start it there"),
    errors.ArmMoving("psm1"),
    errors.AlreadyThere("waypoints 1 and 2 coincide"),
    errors.StaleReading("psm1", 0.3, 0.1),
    errors.NoPlan("no path", planner="convex"),
    errors.ArmStopped("psm1", "the cable broke"),
    errors.MachineError("the disk is full"),
    errors.EmergencyStop("a person pressed the emergency stop"),
]


@pytest.mark.parametrize("error", MADE, ids=lambda error: type(error).__name__)
def test_an_error_comes_back_from_another_process_as_it_was(error):
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error) and str(back) == str(error) and vars(back) == vars(error)


def test_every_kind_is_tried():
    kinds = {kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.TrocarError)}
    assert kinds - {type(error) for error in MADE} == {errors.TrocarError, errors.MotionRefused}


def test_an_unknown_name_lists_the_choices_and_guesses_what_was_meant():
    assert str(MADE[2]) == "planner 'slpine' is unknown; did you mean 'spline'? choose one of spline, sqp"
    assert str(errors.UnknownName("planner", "x", [])) == "planner 'x' is unknown; there are none"


def test_sentences_are_made_from_fields():
    assert str(MADE[1]) == "the seed is -1; give 0 or more"
    assert str(MADE[3]) == "'x.npz' is no recording; give another"
    assert str(errors.BadFile("x", "is cut", kind="station file")) == "station file 'x' is cut"


WORDS = {"problem", "remedy", "reason"}
"""Fields of refusals that are sentences, for people."""
SEARCHES = {"startswith", "endswith", "find", "index", "search", "match", "fullmatch", "count"}


def reads_words(node, caught):
    """Whether an expression reads a caught error as a whole, or a field of it that is a sentence."""
    return any(
        (isinstance(part, ast.Attribute) and part.attr in WORDS) or (isinstance(part, ast.Name) and part.id in caught)
        for part in ast.walk(node)
    )


def decisions_by_words(text):
    """Lines that look for words in the sentence of an error."""
    tree = ast.parse(text)
    caught = {node.name for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler) and node.name}
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            read = [node.left, *node.comparators]
            searches = any(
                isinstance(part, ast.Constant) and part.value and isinstance(part.value, str) for part in read
            )
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            read = [node.func.value, *node.args]
            searches = node.func.attr in SEARCHES
        else:
            continue
        if searches and any(reads_words(part, caught) for part in read):
            yield node.lineno


@pytest.mark.parametrize(
    "line",
    ["if 'comes within' in str(error): pass", "if error.reason == 'late': pass", "str(error).startswith('psm1')"],
)
def test_a_decision_by_words_would_be_found(line):
    assert list(decisions_by_words(f"try:\n    pass\nexcept ValueError as error:\n    {line}\n"))


def test_programs_decide_by_types_and_fields_and_refuse_by_kind():
    root = Path(trocar.__file__).parent
    texts = {path.relative_to(root).as_posix(): path.read_text() for path in root.rglob("*.py")}
    assert {name: list(decisions_by_words(text)) for name, text in texts.items() if [*decisions_by_words(text)]} == {}
    bare = [name for name, text in texts.items() if "raise TrocarError(" in text or "raise MotionRefused(" in text]
    assert bare == []
