"""Who did what when: an arm's time part by part, every moment once, and the chart of it."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthetic import synthetic_trial
from trocar.errors import TrocarError
from trocar.log import Span
from trocar.report.plot import plot
from trocar.report.timechart import parts_of

SPANS = [Span("psm1", "capture", 0.0, 0.5), Span("psm1", "move", 0.5, 2.0), Span("psm1", "home", 2.5, 3.0)]
SCORES = [{"start_s": 0.0, "end_s": 2.0}, {"start_s": 2.0, "end_s": 3.0}]


@pytest.mark.parametrize(
    ("spans", "duration_s", "parts"),
    [
        ([("capture", 0.0, 0.2), ("motion", 0.5, 1.5), ("capture", 1.5, 1.6)], 2.0, {"capture": 0.3, "motion": 1.0}),
        ([("jaw", 0.1, 0.4), ("motion", 0.0, 1.0)], 1.0, {"motion": 1.0}),
        ([("motion", 0.0, 1.0), ("jaw", 0.8, 1.3)], 1.3, {"motion": 1.0, "jaw": 0.3}),
    ],
    ids=["in turn", "jaws open during a motion", "jaws open beyond it"],
)
def test_every_moment_of_an_arm_counts_once(spans, duration_s, parts):
    others = [Span("b", "motion", 0.0, 9.0)]  # of another arm, which has a time of its own
    other = {"other": duration_s - sum(parts.values())}
    found = parts_of([*(Span("a", *span) for span in spans), *others], "a", duration_s)
    assert found == pytest.approx(parts | other)


@given(
    st.lists(
        st.tuples(st.sampled_from("ab"), st.sampled_from(["x", "y", "z"]), st.floats(0, 9), st.floats(0, 5)),
        max_size=12,
    )
)
def test_parts_are_never_negative_and_add_up_however_spans_overlap(rows):
    spans = [Span(arm, name, start, start + length) for arm, name, start, length in rows]
    for arm in "ab":
        parts = parts_of(spans, arm, 10.0)
        assert sum(parts.values()) == pytest.approx(10.0)
        assert min(parts.values()) > -1e-9


def trial_of(*spans, scores=SCORES, events=()):
    return replace(synthetic_trial(), spans=list(spans), scores=scores, events=list(events))


def rows_of(trial):
    """Return what a chart has: for each row its name, and where its bars begin and end."""
    (axes,) = plot(trial).axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    bars = [[] for _ in names]
    for bar in axes.patches:
        bars[round(bar.get_y() + bar.get_height() / 2)].append(
            (pytest.approx(bar.get_x()), pytest.approx(bar.get_x() + bar.get_width()))
        )
    return list(zip(names, bars, strict=True))


def test_what_lies_before_between_and_after_the_goals_has_rows_of_its_own_without_pauses():
    scores = [{"start_s": 1.0, "end_s": 2.0}, {"start_s": 90.0, "end_s": 92.0}]
    times = [(0.0, 0.5), (1.0, 2.0), (3.0, 3.5), (80.0, 81.0), (90.0, 92.0), (93.0, 95.0)]
    assert rows_of(trial_of(*(Span("psm1", "move", *both) for both in times), scores=scores)) == [
        ("start", [(0.0, 0.5)]),
        ("transfer 1", [(0.0, 1.0)]),
        ("transfer 2", [(0.0, 2.0)]),
        ("between", [(0.0, 0.5), (0.5, 1.5)]),
        ("end", [(0.0, 2.0)]),
    ]


def test_of_arms_side_by_side_each_piece_has_the_spans_of_the_arm_that_had_it():
    """Both arms work from 0 to 3 s: by the scores alone each would have a part of both goals."""
    scores = [{"start_s": 0.0, "end_s": 2.0}, {"start_s": 0.5, "end_s": 3.0}]
    spans = [Span(arm, "move", at_s, at_s + 0.9) for arm in ("psm1", "psm2") for at_s in (0.0, 1.0, 2.0)]
    noted = [
        {"name": "transfer", "time_s": end_s, "arm": arm, "start_s": 0.0, "outcome": "DONE"}
        for arm, end_s in (("psm1", 2.0), ("psm2", 3.0))
    ]
    mixed = [name for name, _ in rows_of(trial_of(*spans, scores=scores))]
    assert mixed == [f"transfer {goal}, {arm}" for goal in (1, 2) for arm in ("psm1", "psm2")]
    assert rows_of(trial_of(*spans, scores=scores, events=noted)) == [
        ("transfer 1, psm1", [(0.0, 0.9), (1.0, 1.9)]),
        ("transfer 2, psm2", [(0.0, 0.9), (1.0, 1.9), (2.0, 2.9)]),
        ("end, psm1", [(0.0, 0.9)]),
    ]


def test_rows_are_numbered_as_the_goals_are_and_an_arm_that_hands_over_has_ended_before_the_goal_has():
    """The second transfer ends first; of the first one, psm1 gives until 2 s while psm2 receives until 3 s."""
    noted = [
        {"name": "transfer", "time_s": 2.5, "goal": 1, "turns": {"psm1": [2.0, 2.5]}},
        {"name": "transfer", "time_s": 3.0, "goal": 0, "turns": {"psm1": [0.0, 2.0], "psm2": [1.0, 3.0]}},
    ]
    spans = [Span("psm1", "move", at_s, at_s + 0.5) for at_s in (0.0, 1.5, 2.0)] + [Span("psm2", "move", 1.0, 3.0)]
    assert rows_of(trial_of(*spans, events=noted)) == [
        ("transfer 1, psm1", [(0.0, 0.5), (1.5, 2.0)]),
        ("transfer 1, psm2", [(0.0, 2.0)]),
        ("transfer 2, psm1", [(0.0, 0.5)]),
    ]


def test_the_legend_counts_what_overlaps_once_as_the_table_does():
    spans = [Span("psm1", "motion", 0.0, 2.0), Span("psm1", "capture", 0.5, 1.0), Span("psm1", "jaw", 1.5, 3.0)]
    said = [text.get_text() for text in plot(trial_of(*spans)).legends[0].get_texts()]
    assert said == ["motion, 2.0 s", "capture, 0.0 s (+ 0.5 s meanwhile)", "jaw, 1.0 s (+ 0.5 s meanwhile)"]


def test_it_grows_with_its_rows_and_without_spans_there_is_nothing_to_draw():
    one, both = (plot(trial_of(*SPANS, *more), title="Mine") for more in ([], [replace(SPANS[0], arm="psm2")]))
    assert one.axes[0].get_title(loc="left") == "Mine"
    assert both.get_figheight() > one.get_figheight()
    with pytest.raises(TrocarError, match="at least one span"):
        plot(trial_of())
