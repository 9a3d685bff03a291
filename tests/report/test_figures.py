import io
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from synthetic import synthetic_trial
from trocar.errors import TrocarError
from trocar.log import Span
from trocar.report.files import draw_trial
from trocar.report.stills import draw_storyboard
from trocar.report.tables import parts_table, run_table
from trocar.report.timechart import draw_timechart
from trocar.tasks.peg_transfer.report import PAPER, PegReport, draw_paths

SPANS = [
    Span("psm1", "capture", 0.0, 0.5),
    Span("psm1", "move", 0.5, 2.0),
    Span("psm1", "a part of its own", 2.0, 2.5),
    Span("psm1", "home", 2.5, 3.0),
]
SCORES = [{"start_s": 0.0, "end_s": 2.0}, {"start_s": 2.0, "end_s": 3.0}]
SUMMARY = {
    "task": "peg-transfer",
    "variant": "unilateral",
    "method": "calibrated",
    "model": "play",
    "goal_noun": "transfer",
    "trials": 2,
    "sessions": 1,
    "attempted": 12,
    "succeeded": 11,
    "success_rate": 11 / 12,
    "success_ci95": [0.646, 0.985],
    "mean_time_s": None,
    "parts_s": {"motion": 3.0, "jaw": 1.0},
}


def drawn(path):
    assert path.stat().st_size < 500_000
    image = matplotlib.image.imread(path)[..., :3]
    assert image.std() > 0.01
    return image


def trial_of(*spans, scores=SCORES):
    return replace(synthetic_trial(), spans=list(spans), scores=scores)


def tool_path():
    times = np.linspace(0, 6, 120)
    tips = np.stack([0.04 * np.sin(times), 0.01 * np.cos(times), 0.03 + 0.02 * np.sin(2 * times)], axis=1)
    return times, tips, np.where(times < 1, -1, (times > 3).astype(int))


@pytest.mark.slow
def test_figures_are_written_small_and_not_empty(tmp_path):
    drawn(draw_timechart(trial_of(*SPANS), tmp_path / "new" / "time.png"))
    drawn(draw_paths(*tool_path(), tmp_path / "paths.png", "Path"))
    rng = np.random.default_rng(0)
    frames = [(f"step {k}", rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)) for k in range(30)]
    image = matplotlib.image.imread(draw_storyboard(frames[:1], tmp_path / "one.png"))
    assert image.shape[1] > 1000
    assert draw_storyboard([(c, f // 9 * 9 + 4) for c, f in frames], tmp_path / "story.png").exists()


def test_two_arms_have_rows_of_their_own(tmp_path):
    one = drawn(draw_timechart(trial_of(*SPANS), tmp_path / "one.png"))
    both = drawn(draw_timechart(trial_of(*SPANS, replace(SPANS[0], arm="psm2")), tmp_path / "both.png"))
    assert both.shape[0] > one.shape[0]


def test_what_an_arm_does_before_the_first_and_after_the_last_goal_has_a_row_of_its_own(tmp_path):
    scores = [{"start_s": s["start_s"] + 1.0, "end_s": s["end_s"] + 1.0} for s in SCORES]
    inside = [replace(span, start_s=span.start_s + 1.0, end_s=span.end_s + 1.0) for span in SPANS[:3]]
    early, late = Span("psm1", "home", 0.0, 1.0), Span("psm1", "home", 60.0, 61.0)
    heights = [
        drawn(draw_timechart(trial_of(*spans, scores=scores), tmp_path / "chart.png")).shape[0]
        for spans in (inside, [early, *inside], [early, *inside, late])
    ]
    assert heights[0] < heights[1] < heights[2]


def rows_of(monkeypatch, trial, tmp_path):
    """Return what a chart has: for each row its name, and where its bars begin and end."""
    bars = []
    names = []
    real = Axes.barh, Axes.set_yticks

    def barh(axes, y, width, left, **how):
        bars.append((y, left, left + width))
        return real[0](axes, y, width, left=left, **how)

    def set_yticks(axes, ticks, labels):
        names.extend(labels)
        return real[1](axes, ticks, labels)

    monkeypatch.setattr(Axes, "barh", barh)
    monkeypatch.setattr(Axes, "set_yticks", set_yticks)
    drawn(draw_timechart(trial, tmp_path / "chart.png"))
    return [(name, [bar[1:] for bar in bars if bar[0] == row]) for row, name in enumerate(names)]


def test_what_lies_between_two_goals_is_neither_start_nor_end_and_has_no_pauses(monkeypatch, tmp_path):
    scores = [{"start_s": 1.0, "end_s": 2.0}, {"start_s": 90.0, "end_s": 92.0}]
    times = [(0.0, 0.5), (1.0, 2.0), (3.0, 3.5), (80.0, 81.0), (90.0, 92.0), (93.0, 95.0)]
    trial = trial_of(*(Span("psm1", "move", *both) for both in times), scores=scores)
    assert rows_of(monkeypatch, trial, tmp_path) == [
        ("start", [(0.0, 0.5)]),
        ("transfer 1", [(0.0, 1.0)]),
        ("transfer 2", [(0.0, 2.0)]),
        ("between", [(0.0, 0.5), (0.5, 1.5)]),
        ("end", [(0.0, 2.0)]),
    ]


def test_of_arms_side_by_side_each_piece_has_the_spans_of_the_arm_that_had_it(tmp_path):
    """Both arms work from 0 to 3 s: by the scores alone each would have a part of both goals."""
    scores = [{"start_s": 0.0, "end_s": 2.0}, {"start_s": 0.5, "end_s": 3.0}]
    spans = [Span(arm, "move", at_s, at_s + 0.9) for arm in ("psm1", "psm2") for at_s in (0.0, 1.0, 2.0)]
    trial = replace(trial_of(*spans, scores=scores), events=[])
    noted = [
        {"name": "transfer", "time_s": end_s, "arm": arm, "start_s": 0.0, "outcome": "DONE"}
        for arm, end_s in (("psm1", 2.0), ("psm2", 3.0))
    ]
    mixed = drawn(draw_timechart(trial, tmp_path / "mixed.png"))
    apart = drawn(draw_timechart(replace(trial, events=noted), tmp_path / "apart.png"))
    assert apart.shape[0] < mixed.shape[0]  # three rows in place of four: psm1 ends its own, then does more


def test_rows_are_numbered_as_the_goals_are_and_an_arm_that_hands_over_has_ended_before_the_goal_has(
    monkeypatch, tmp_path
):
    """The second transfer ends first; of the first one, psm1 gives until 2 s while psm2 receives until 3 s."""
    noted = [
        {"name": "transfer", "time_s": 2.5, "goal": 1, "turns": {"psm1": [2.0, 2.5]}},
        {"name": "transfer", "time_s": 3.0, "goal": 0, "turns": {"psm1": [0.0, 2.0], "psm2": [1.0, 3.0]}},
    ]
    spans = [Span("psm1", "move", at_s, at_s + 0.5) for at_s in (0.0, 1.5, 2.0)] + [Span("psm2", "move", 1.0, 3.0)]
    trial = replace(trial_of(*spans, scores=SCORES), events=noted)
    assert rows_of(monkeypatch, trial, tmp_path) == [
        ("transfer 1, psm1", [(0.0, 0.5), (1.5, 2.0)]),
        ("transfer 1, psm2", [(0.0, 2.0)]),
        ("transfer 2, psm1", [(0.0, 0.5)]),
    ]


def test_the_legend_counts_what_overlaps_once_as_the_table_does(monkeypatch, tmp_path):
    said = []
    real = Figure.legend
    monkeypatch.setattr(
        Figure,
        "legend",
        lambda self, handles, **how: said.extend(h.get_label() for h in handles) or real(self, handles=handles, **how),
    )
    spans = [Span("psm1", "motion", 0.0, 2.0), Span("psm1", "capture", 0.5, 1.0), Span("psm1", "jaw", 1.5, 3.0)]
    drawn(draw_timechart(trial_of(*spans), tmp_path / "chart.png"))
    assert said == ["motion, 2.0 s", "capture, 0.0 s (+ 0.5 s meanwhile)", "jaw, 1.0 s (+ 0.5 s meanwhile)"]


def test_the_storyboard_of_a_trial_shows_its_moments(tmp_path):
    trial = synthetic_trial(failures={3: "DROPPED"})
    image = drawn(draw_trial(trial, tmp_path / "story.png"))
    assert image.shape[1] > 1000
    captions = [caption for caption, _ in PegReport().moments(trial)]
    assert captions[0] == "start" and "peg 2 to 9: dropped" in captions and "after 12 transfers" in captions
    assert "lifted" in captions and "released on peg 7" in captions


def test_the_path_of_the_tool_is_drawn_over_the_board_where_it_was(tmp_path):
    (path,) = PegReport().pictures(tmp_path, [synthetic_trial()])
    assert path.name == "paths.png"
    drawn(path)


def test_nothing_to_draw_is_one_sentence_and_no_file(tmp_path):
    with pytest.raises(TrocarError, match="at least one span"):
        draw_timechart(trial_of(), tmp_path / "a.png")
    with pytest.raises(TrocarError, match="at least one picture"):
        draw_storyboard([], tmp_path / "a.png")
    with pytest.raises(TrocarError, match="picture 'grey'"):
        draw_storyboard([("grey", np.zeros((4, 4), np.uint8))], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_tables_show_the_run_beside_the_paper():
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(run_table(SUMMARY, PAPER["unilateral"]))
    console.print(parts_table(SUMMARY))
    text = console.export_text()
    for words in ("11 of 12", "91.7 %", "64.6 % to 98.5 %", "34.7 %", "12.30", "75.0 %"):
        assert words in text
    assert "2 trials in 1 session, simulated" in " ".join(text.split()) and "trocar, calibrated (play)" in text
    assert text.index("paper: robot, calibrated") < text.index("paper: surgeon") and "120 of 120" in text
    console.print(run_table(SUMMARY | {"method": "uncalibrated"}, PAPER["unilateral"][::-1]))
    text = console.export_text()
    assert text.rindex("paper: surgeon") > text.rindex("paper: robot, uncalibrated")


def test_a_run_without_a_paper_and_without_a_model_has_a_table_too():
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(run_table({**SUMMARY, "model": None, "success_rate": None, "attempted": 0, "succeeded": 0}))
    text = console.export_text()
    assert "paper" not in text.replace("the paper's rows", "") and "trocar, calibrated " in text and "0 of 0" in text


def test_a_part_of_less_than_nothing_by_rounding_is_nothing():
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(parts_table({**SUMMARY, "parts_s": {"motion": 3.0, "other": -2e-15}}))
    assert "-0.0" not in console.export_text()
