"""Figures like Figs. 9 to 11 of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from trocar.eval.study import Results
from trocar.eval.trial import Trial, trial_file
from trocar.report import style
from trocar.tasks.peg_transfer.report import tips_over_board
from trocar.tasks.peg_transfer.shapes import Pegboard

if TYPE_CHECKING:
    from trocar.tasks.peg_transfer.report.study import Row

COMPLETION_S = {
    "unilateral": {"volunteers": (145.8, 44.7), "surgeon": (56.7, 6.0)},
    "bilateral": {"volunteers": (129.7, 56.5), "surgeon": (56.7, 11.2)},
    "handover": {"volunteers": (181.8, 61.9), "surgeon": (94.8, 10.0)},
}
"""Mean and standard deviation of people's completion time of a trial, caption of Fig. 10."""
COLLISIONS = {"surgeon": 6, "volunteers": 8}
"""People's median collisions per trial on all variants, section V-D.4."""
KINDS = ("velocity", "acceleration", "jerk")
PEOPLE = {"volunteers": ("s", style.QUIET), "surgeon": ("^", style.INK)}
LEAST_OF_BOX = 5
"""Minimum number of trials for a box."""
THINNED = 5
"""One in this many samples of a path is drawn."""


class Cells:
    """A study's conditions (cells) on one axis: variants one unit apart, the methods of each side by side."""

    def __init__(self, results: Sequence[Results[Row]]):
        self.results = results
        self.variants = list(dict.fromkeys(result.condition.name for result in results))
        self.methods = list(dict.fromkeys(result.condition.method for result in results))

    def place(self, result: Results[Row]) -> float:
        """Return a cell's position on the axis."""
        aside = self.methods.index(result.condition.method) - (len(self.methods) - 1) / 2
        return self.variants.index(result.condition.name) + aside * (0.8 / len(self.methods))

    def colour(self, method: str) -> str:
        """Return the colour of a method."""
        return style.SERIES[self.methods.index(method) % len(style.SERIES)]

    def handles(self) -> list[Patch]:
        """Return the handles of a legend."""
        return [Patch(color=self.colour(name), label=name) for name in self.methods]

    def name(self, axes: Axes) -> None:
        """Write the variants below an axis."""
        axes.set_xticks(range(len(self.variants)), self.variants)
        axes.set_xlim(-0.6, len(self.variants) - 0.4)

    def draw_boxes(self, axes: Axes, value: Callable[[Row], float]) -> None:
        """Draw a box of each cell's trials: quartiles, whiskers to 1.5 quartile ranges, outliers as points.

        With fewer than ``LEAST_OF_BOX`` trials, each is a point, since quartiles would mean nothing.
        """
        for result in self.results:
            colour, place = self.colour(result.condition.method), self.place(result)
            values = [value(row) for row in result.rows]
            if len(values) < LEAST_OF_BOX:
                axes.plot(np.full(len(values), place), values, "o", color=colour, markersize=4)
                continue
            drawn = axes.boxplot(
                [values],
                positions=[place],
                widths=0.7 / len(self.methods),
                patch_artist=True,
                manage_ticks=False,
                flierprops={"markersize": 2},
                medianprops={"color": style.INK},
            )
            drawn["boxes"][0].set_facecolor(colour)
        axes.set_ylim(bottom=0.0)
        self.name(axes)

    def draw_success(self, axes: Axes, figures: Sequence[Mapping[str, Any]]) -> None:
        """Draw success rates with their 95 % intervals over sessions."""
        for result, cell in zip(self.results, figures, strict=True):
            rate, (low, high) = 100 * cell["success_rate"], np.multiply(100, cell["success_ci95"])
            colour, around = self.colour(result.condition.method), [[rate - low], [high - rate]]
            axes.errorbar(self.place(result), rate, around, fmt="o", capsize=3, color=colour)
        axes.set_ylim(-3, 103)
        axes.set_title("success, %, 95 % interval")
        axes.legend(handles=self.handles(), fontsize=7, loc="lower right")
        self.name(axes)


def draw_paths(results: Sequence[Results[Row]], path: Path) -> Path:
    """Draw the tips' paths over the board of one trial of each cell (Fig. 9), and return the path."""
    cells, pegs = Cells(results), 1e3 * Pegboard().pegs_m
    variants, methods = cells.variants, cells.methods
    with style.figure(3.2 * len(methods), 2.5 * len(variants) + 0.4, path) as figure:
        grid = figure.subplots(len(variants), len(methods), squeeze=False, sharex=True, sharey=True)
        for result in results:
            axes = grid[variants.index(result.condition.name), methods.index(result.condition.method)]
            row = result.rows[0]
            trial = Trial.load(trial_file(result.condition.folder, row.session, row.index))  # one at a time
            for k, (arm, tips_m) in enumerate(tips_over_board(trial).items()):
                tip = 1e3 * tips_m[::THINNED]
                axes.plot(tip[:, 0], tip[:, 1], linewidth=0.7, color=style.SERIES[k], label=arm)
            axes.plot(pegs[:, 0], pegs[:, 1], "o", color=style.INK, markersize=3)
            axes.set_aspect("equal")
            axes.set_title(f"{result.condition.name}, {result.condition.method}: {row.path_m:.1f} m", fontsize=8)
        grid[0, 0].legend(fontsize=7)
        figure.supxlabel("x in the board frame, mm", fontsize=9)
        figure.supylabel("y, mm", fontsize=9)
    return path


def draw_performance(results: Sequence[Results[Row]], figures: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw success, distance, collisions and completion time (Fig. 10), and return the path."""
    panels: dict[str, Callable[[Row], float]] = {
        "distance of the tips, m per trial": lambda row: row.path_m,
        "collisions per trial": lambda row: float(row.collisions),
        "completion time, s": lambda row: row.duration_s,
    }
    cells = Cells(results)
    with style.figure(11.0, 3.6, path) as figure:
        grid = figure.subplots(1, 4)
        cells.draw_success(grid[0], figures)
        for axes, (name, value) in zip(grid[1:], panels.items(), strict=True):
            cells.draw_boxes(axes, value)
            axes.set_title(name)
        for place, variant in enumerate(cells.variants):
            for who, (marker, colour) in PEOPLE.items():
                at = place + 0.46
                grid[2].plot(at, COLLISIONS[who], marker, color=colour, markersize=4)
                if variant in COMPLETION_S:
                    mean, sd = COMPLETION_S[variant][who]
                    label = f"{who}, published" if place == 0 else None
                    grid[3].errorbar(at, mean, sd, fmt=marker, color=colour, markersize=4, linewidth=0.8, label=label)
        for axes in grid[2:]:
            axes.autoscale(axis="y")
            axes.set_ylim(bottom=0.0)
        grid[3].legend(fontsize=7)
    return path


def draw_motion(results: Sequence[Results[Row]], path: Path) -> Path:
    """Draw velocity, acceleration and jerk of joints and tip (Fig. 11), and return the path."""
    cells = Cells(results)
    units = {"velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
    with style.figure(10.0, 5.6, path) as figure:
        grid = figure.subplots(2, 3)
        for row, (part, unit) in enumerate((("joints", "rad"), ("tip", "m"))):
            for axes, kind in zip(grid[row], KINDS, strict=True):
                cells.draw_boxes(axes, lambda row, part=part, kind=kind: getattr(row, part)[kind])
                what = "turning joints" if part == "joints" else "tip"
                axes.set_title(f"{what}: RMS {kind}, {unit}{units[kind]}", fontsize=9)
        grid[0, 0].legend(handles=cells.handles(), fontsize=7)
    return path
