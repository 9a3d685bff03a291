"""Bad inputs to every command and public constructor: sentences, no tracebacks, no hangs.

    FUZZ=250 pytest tests/fuzz --hypothesis-profile explore     # 250 times as many, and others each time

Long work is skipped: an input that would begin it counts as accepted.
"""

import os
import shlex

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from fuzzing import judge
from fuzzing.constructors import calls
from fuzzing.files import good_files, make_good
from fuzzing.lines import COMMANDS, Case, cases
from synthetic import synthetic_trial

TIMES = int(os.environ.get("FUZZ", "1"))
FEW = settings(max_examples=40 * TIMES, phases=[Phase.generate], suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a") / "b"
    folder.mkdir()
    make_good(folder, synthetic_trial())
    good_files(folder)
    return folder


def test_no_line_ends_in_a_traceback_a_hang_or_a_figure_that_is_none(good):
    @FEW
    @given(case=cases(good))
    def each(case):
        verdict = judge.judged(case, good)
        assert verdict.kind not in judge.WRONG, f"{shlex.join(case.words)}\n{verdict.told}"

    each()


@settings(parent=FEW, max_examples=150 * TIMES)
@given(call=calls())
def test_no_constructor_takes_what_is_no_number_or_fails_without_a_sentence(call):
    verdict = judge.judged_call(call)
    assert verdict.kind not in judge.WRONG, f"{call}\n{verdict.told}"


KNOWN = {
    "plan transfer waypoints.npy --up 1e308 1e308 0": judge.DONE,
    "plan transfer waypoints.npy --up 0 0 0": judge.REFUSED,
    f"plan transfer {'w' * 300}.npy": judge.REFUSED,
    f"calibrate fit recording.npz --model offset --out {'w' * 300}.npz": judge.REFUSED,
    f"report {'w' * 300}": judge.REFUSED,
    f"run peg-transfer --out {'w' * 300}": judge.REFUSED,
    f"run peg-transfer --sessions {10**9}": judge.REFUSED,
    f"run peg-transfer --trials {10**30}": judge.REFUSED,
    "station list": judge.DONE,
    "plan suture --count 2 --positions 8 --out ä": judge.DONE,
}


@pytest.mark.parametrize("line", KNOWN, ids=lambda line: line[:40])
@pytest.mark.parametrize(("columns", "encoding"), [("80", "utf-8"), ("0", "ascii")])
def test_what_was_found_once_is_not_found_again(good, line, columns, encoding):
    verdict = judge.judged(Case(tuple(line.split()), columns, encoding), good)
    assert verdict.kind == KNOWN[line], verdict


def test_every_command_is_tried():
    assert {words[0] for words in COMMANDS} >= {"run", "report", "view", "calibrate", "plan", "register", "station"}
    assert len(COMMANDS) > 25 and ("run", "peg-transfer") in COMMANDS
    assert all(len(command.params) > 1 for command in COMMANDS.values()), "with their own options"
