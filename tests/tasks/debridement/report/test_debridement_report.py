"""Trials in numbers, Table I, and the report of hand-made trials."""

import json
from dataclasses import replace

import pytest
from rich.console import Console

from made_up_debridement import made_up, score
from trocar.eval.config import RunConfig
from trocar.log import Span
from trocar.report.files import report_of, write_report
from trocar.tasks.debridement.report import DebridementReport
from trocar.tasks.debridement.report.figures import figures_of, row_of
from trocar.tasks.debridement.report.table_one import MODES, PARTS, PERSON, TABLE_1, clopper_pearson, lines_of, within
from trocar.tasks.debridement.score import FragmentScore
from trocar.tasks.debridement.task import Debridement

# A trial in numbers.


@pytest.mark.parametrize(("arms", "fragments_each"), [(2, 3), (1, 6)])
def test_time_by_part_is_the_mean_of_the_working_arms_and_adds_up(arms, fragments_each):
    """An arm that is parked does not count; spans that overlap, as images taken while an arm moves, count once."""
    trial = made_up(RunConfig(Debridement(arms=arms), seed=2))
    more = [Span(arm, "capture", 4.0, 6.0) for arm in trial.about["arms"]]
    for row in (row_of(trial), row_of(replace(trial, spans=[*trial.spans, *more]))):
        assert row.duration_s == 10.0 * fragments_each == pytest.approx(sum(row.parts_s.values()))
        of_one = {"perception": 1.5, "planning": 2.0, "motion": 5.5, "waiting": 1.0}
        assert row.parts_s == pytest.approx({part: fragments_each * seconds for part, seconds in of_one.items()})


def test_plans_of_all_arms_are_counted():
    assert row_of(made_up()).plans == 6


def test_failures_are_counted_of_fragments_or_of_attempts():
    scores = [
        score(0, 0.0, attempts=3, grasp_failures=2, fragment_false_negatives=4),
        score(1, 0.0, failure="DROPPED_EN_ROUTE", attempts=1, drops_en_route=1),
        score(2, 10.0, failure="NOT_CLEARED", attempts=0),
    ]
    row = row_of(made_up(scores=scores))
    assert row.modes["grasp_failures"] == [2, 4]
    assert row.modes["drops_en_route"] == [1, 4]
    assert row.modes["fragment_false_negatives"] == [1, 3]  # a fragment counts once, however often it was overlooked
    assert (row.fragments, row.cleared, row.first_attempts, row.attempts, row.recoveries) == (3, 1, 0, 4, 2)
    assert row.failures == {"DROPPED_EN_ROUTE": 1, "NOT_CLEARED": 1}


def test_a_trial_without_fragments_has_a_row():
    row = row_of(made_up(scores=[]))
    assert row.fragments == 0 and set(map(tuple, row.modes.values())) == {(0, 0)}


# Table I as published, and ours beside it.


@pytest.mark.parametrize("column", TABLE_1.values(), ids=list(TABLE_1))
def test_parts_add_up_to_the_time_of_a_fragment(column):
    assert sum(column.shares.values()) == pytest.approx(100.0)
    assert sum(column.parts_s.values()) == pytest.approx(column.s_per_fragment)
    assert set(column.parts_s) <= set(PARTS) and set(column.failures) <= set(MODES)


PRINTED = {
    "one-arm": ("60 91.8 12.1 32.8 55.1 - 11.06", "1.9 0.0 0.0 0.0 3.5 5.2 0.0 0.0 0.0"),
    "two-arms": ("60 60.3 10.0 36.6 45.7 7.7 10.58", "0.0 0.0 0.0 3.6 3.6 7.1 0.0 1.8 0.0"),
}
"""Table I: fragments, s per fragment, shares, replans; rates of the nine modes."""


@pytest.mark.parametrize("variant", TABLE_1)
def test_the_papers_columns_are_as_printed(variant):
    lines = lines_of(variant, figures_of([row_of(made_up())]))
    figures, rates = PRINTED[variant]
    assert " ".join(line[2] for line in lines[:7]) == figures
    assert " ".join(line[2].split()[0] for line in lines[7:16]) == rates
    assert [line[1] for line in lines[:2]] == ["30", "29.0"]
    assert [line[1] for line in lines[7:16]] == ["0.0"] * 4 + ["5.0"] + ["0.0"] * 4, "only grasps failed the person"


def test_the_nine_modes_are_fields_of_a_score():
    assert len(MODES) == 9 and set(MODES) <= set(FragmentScore.__dataclass_fields__)


def test_intervals_are_those_of_counts():
    """Against Clopper and Pearson's closed form at 0, and tabulated 2 of 56."""
    assert clopper_pearson(0, 60) == pytest.approx((0.0, 1 - 0.025 ** (1 / 60)))
    assert clopper_pearson(2, 56) == pytest.approx((0.0044, 0.1231), abs=1e-4)
    assert clopper_pearson(60, 60) == pytest.approx((0.025 ** (1 / 60), 1.0))


def test_every_published_rate_lies_in_its_interval():
    for column in (PERSON, *TABLE_1.values()):
        for mode in MODES:
            low, high = column.interval(mode)
            assert low <= column.rate(mode) <= high < 0.21


def text_of(table, width=80):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(table)
    return console.export_text()


def failed():
    """Return a trial in which one fragment of six was left behind after a grasp failure and a drop."""
    left = score(5, 0.0, failure="DROPPED_EN_ROUTE", attempts=2, grasp_failures=1, drops_en_route=1)
    return made_up(session=1, scores=[*(score(k, 0.0) for k in range(5)), left])


def test_time_is_of_fragments_that_were_cleared():
    figures = figures_of([row_of(made_up()), row_of(failed())])
    assert (figures["cleared"], figures["fragments"]) == (11, 12)
    assert figures["s_per_fragment"]["mean"] == pytest.approx(60.0 / 11)
    assert sum(figures["table_parts_s"].values()) == pytest.approx(60.0 / 11)
    assert sum(figures["table_parts_share"].values()) == pytest.approx(1.0)
    assert figures["replans_per_fragment"]["mean"] == pytest.approx(12 / 11)
    assert figures["first_attempt"]["count"] == 11


def test_trials_that_were_stopped_and_contacts_are_counted():
    late = replace(failed(), ended="OUT_OF_TIME", collisions=[{}, {}, {}], wall_s=40.0)
    figures = figures_of([row_of(made_up()), row_of(late), row_of(replace(late, about=late.about | {"session": 2}))])
    assert figures["unfinished_trials"] == 2
    assert figures["contacts_per_trial"]["mean"] == pytest.approx(2.0)
    assert figures["left_behind"] == {"DROPPED_EN_ROUTE": 2}
    assert figures["wall_s_per_trial"] == pytest.approx(100.0 / 3)


def test_intervals_of_counts_do_not_go_below_zero():
    """One session of three has all the contacts, and few fragments for its plans."""
    few = made_up(session=1, scores=[score(0, 0.0), *(score(k, 0.0, failure="NOT_CLEARED") for k in range(1, 6))])
    idle = [replace(made_up(session=k), spans=[]) for k in (2, 3)]
    figures = figures_of([row_of(trial) for trial in (replace(few, collisions=[{}] * 9), *idle)])
    assert figures["replans_per_fragment"]["mean"] == pytest.approx(6 / 13)
    assert figures["contacts_per_trial"]["mean"] == pytest.approx(3.0)
    for name in ("replans_per_fragment", "contacts_per_trial"):
        assert figures[name]["low"] == 0.0 < figures[name]["mean"] < figures[name]["high"]


def test_rates_have_counts_and_intervals_over_sessions():
    rates = figures_of([row_of(made_up()), row_of(failed())])["failure_modes"]
    grasp = rates["grasp_failures"]
    assert (grasp["count"], grasp["of"], grasp["rate"]) == (1, 13, pytest.approx(1 / 13))
    low, high = grasp["ci95"]
    assert 0.0 < low < 1 / 13 < high < 1.0
    assert rates["pickup_failures"]["ci95"][0] == 0.0


def test_nothing_cleared_gives_no_time():
    scores = [score(k, 0.0, failure="NOT_CLEARED", attempts=0) for k in range(6)]
    figures = figures_of([row_of(made_up(scores=scores))])
    assert figures["s_per_fragment"] is None and figures["failure_modes"]["grasp_failures"]["rate"] is None
    json.dumps(figures, allow_nan=False)
    line = next(line for line in lines_of("two-arms", figures) if line[0].startswith("grasp"))
    assert line[-2:] == ["-", "-"]


def test_within_says_on_which_side_we_are():
    def figures(rate):
        return {"failure_modes": {"multiple_grasps": {"rate": rate}}}

    said = [within("two-arms", "multiple_grasps", figures(rate)) for rate in (0.0, 0.071, 0.5, None)]
    assert said == ["below", "yes", "above", "-"]
    never = {"failure_modes": {"pickup_failures": {"rate": 0.0}}}
    assert within("two-arms", "pickup_failures", never) == "yes", "neither did it happen in the paper"


def test_a_run_s_report_has_table_one_beside_the_papers(tmp_path):
    trials = [made_up(), failed()]
    report = report_of(trials[0])
    assert isinstance(report, DebridementReport)
    summary, files = write_report(tmp_path, trials)
    assert {"failures.png", "timechart.png", "storyboard.png", "report.html"} <= {file.name for file in files}
    assert json.loads((tmp_path / "summary.json").read_text())["table_1"]["cleared"] == 11
    text = text_of(report.tables(summary)[0])
    for words in ("60.3", "11 of 12", "36.6", "10.58", "7.1 [2.1, 16.8]", "1/13", "drop en route"):
        assert words in text
    assert [row.mean_time_s for row in report.paper_rows(summary)] == [60.3, 29.0]
    assert any("cleared" in note for note in report.notes(trials))


def test_the_storyboard_shows_the_first_grasp_step_by_step_and_failures():
    trial = failed()
    noted = {"name": "fragment", "arm": "left", "outcome": "GRASP_FAILURE", "reason": ""}
    earlier = {"name": "closing", "time_s": 2.0, "arm": "right"}
    more = [earlier, *(noted | {"time_s": 26.0 + at} for at in range(4))]
    trial = replace(trial, events=sorted([*trial.events, *more], key=lambda event: event["time_s"]))
    moments = DebridementReport().moments(trial)
    words = [caption for caption, _ in moments]
    assert words[:5] == [
        "start",
        "left goes for a fragment",
        "left: jaws open round it",
        "left: lifted, and looked at",
        "left: over the receptacle",
    ]
    assert [at for _, at in moments[:5]] == [0.0, 1.0, 5.0, 6.0, 9.0], "of the arm that goes for it"
    cleared = [caption for caption in words if caption.endswith("in the receptacle")]
    assert cleared == [f"fragment {number} in the receptacle" for number in range(1, 6)]
    assert words.count("left: grasp failure") == 3, "of many, the first few"
    assert words[-1] == "end: 5 of 6 cleared"
    assert [at for _, at in moments] == sorted(at for _, at in moments)
