"""Figures of the study of the peg transfer show the rows, and people as published."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.patches import PathPatch

from kept_figures import kept_figures
from trocar.eval.study import Results
from trocar.tasks.peg_transfer.report import PAPER
from trocar.tasks.peg_transfer.report.study_figures import COMPLETION_S, PEOPLE, draw_motion, draw_performance

KINDS = ("velocity", "acceleration", "jerk")


def row(number):
    parts = {
        part: {kind: add + 10 * k + number for k, kind in enumerate(KINDS)}
        for part, add in (("joints", 100), ("tip", 200))
    }
    return SimpleNamespace(path_m=5.0 + number, collisions=number, duration_s=60.0 + number, **parts)


def results(variant, method, trials):
    condition = SimpleNamespace(name=variant, method=method)
    return Results(condition, [row(number) for number in range(trials)])


CELLS = [
    results(variant, method, trials)
    for variant, method, trials in (
        ("unilateral", "best", 3),
        ("unilateral", "uncalibrated", 5),
        ("handover", "best", 4),
        ("handover", "uncalibrated", 4),
    )
]
PLACES = (-0.2, 0.2, 0.8, 1.2)
FIGURES = [{"success_rate": rate, "success_ci95": [rate - 0.1, rate + 0.05]} for rate in (0.9, 0.4, 0.8, 0.3)]


@pytest.fixture
def figures(monkeypatch):
    return kept_figures(monkeypatch)


def bars(axes):
    """Return place, value and ends of all values with an interval."""
    found = [bar for bar in axes.containers if isinstance(bar, ErrorbarContainer)]
    points = [[*bar.lines[0].get_xydata()[0], *bar.lines[2][0].get_segments()[0][:, 1]] for bar in found]
    return np.array(points).round(6).tolist()


def test_success_distance_collisions_and_time_of_each_condition_stand_beside_each_other(figures, tmp_path):
    draw_performance(CELLS, FIGURES, tmp_path / "performance.png")
    success, distance, collisions, time = figures[0].axes
    assert bars(success) == [
        [place, rate, rate - 10.0, rate + 5.0] for place, rate in zip(PLACES, (90.0, 40.0, 80.0, 30.0), strict=True)
    ]
    assert [tick.get_text() for tick in success.get_xticklabels()] == ["unilateral", "handover"]
    for axes, first in ((distance, 5.0), (collisions, 0.0), (time, 60.0)):
        points = [line.get_xydata().tolist() for line in axes.lines if len(line.get_xdata()) in (3, 4)]
        few = [points[0], *points[-2:]] if axes is distance else [one for one in points if one[0][1] == first]
        assert [0.8, first] in [one[0] for one in few] and [-0.2, first + 2] in [one[-1] for one in few]
        assert sum(isinstance(patch, PathPatch) for patch in axes.patches) == 1, "a box, of the five trials"
        assert axes.get_ylim()[0] == 0.0


def test_people_are_drawn_as_published_at_every_variant(figures, tmp_path):
    draw_performance(CELLS, FIGURES, tmp_path / "performance.png")
    _, _, collisions, time = figures[0].axes
    for who, median in (("surgeon", 6.0), ("volunteers", 8.0)):
        marks = [
            line.get_xydata().round(6).tolist() for line in collisions.lines if line.get_marker() == PEOPLE[who][0]
        ]
        assert marks == [[[0.46, median]], [[1.46, median]]]
    assert sorted(bars(time)) == [
        *([0.46, 56.7, 50.7, 62.7], [0.46, 145.8, 101.1, 190.5]),
        *([1.46, 94.8, 84.8, 104.8], [1.46, 181.8, 119.9, 243.7]),
    ]
    assert collisions.get_ylim()[1] > 8.0 and time.get_ylim()[1] > 243.7, "nothing lies outside"
    legend = [text.get_text() for text in time.get_legend().get_texts()]
    assert sorted(legend) == ["surgeon, published", "volunteers, published"]


@pytest.mark.parametrize("variant", COMPLETION_S)
@pytest.mark.parametrize("who", ["volunteers", "surgeon"])
def test_a_published_trial_takes_as_long_as_its_twelve_transfers(variant, who):
    (transfer_s,) = [one.mean_time_s for one in PAPER[variant] if one.who == who]
    assert COMPLETION_S[variant][who][0] == pytest.approx(12 * transfer_s, rel=0.03)


def test_each_panel_of_the_motion_shows_its_own_derivative(figures, tmp_path):
    draw_motion([CELLS[0], CELLS[2]], tmp_path / "motion.png")
    for number, axes in enumerate(figures[0].axes):
        first = (100, 200)[number // 3] + 10 * (number % 3)
        what = ("turning joints", "tip")[number // 3]
        assert axes.get_title("left").startswith(f"{what}: RMS {KINDS[number % 3]}, {('rad', 'm')[number // 3]}/s")
        assert axes.lines[0].get_xydata().tolist() == [[0.0, first + k] for k in range(3)]
        assert axes.lines[1].get_xydata().tolist() == [[1.0, first + k] for k in range(4)]
