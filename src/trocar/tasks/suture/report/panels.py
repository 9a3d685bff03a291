"""Curves round the circle that explain a plan, and the paper's Figs. 3 to 7."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from trocar.report import style
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS
from trocar.tasks.suture.planning.study import (
    ALLOWED,
    LOCATIONS,
    PAPER_SWITCHES_DEG,
    PAPER_TABLE_1,
    SutureStudy,
    fitted_note,
)
from trocar.tasks.suture.report.circle import runs

COLOURS = {1: style.BLUE, -1: style.ORANGE}
PAPER_GREY = "#BBBBBB"
WRIST = (style.BLUE, style.GREEN, style.PURPLE)
MARGIN_UNITS = {
    "smallest": "share of half the range",
    "normalised": "sum of squared shares",
    "clipped": "deg²",
    "paper": "deg², as printed",
}

REASONS_AT = {"left": 0.108, "right": 0.966, "top": 0.969, "bottom": 0.053, "hspace": 0.22}
"""Edges and spacing of the panels in ``draw_reasons``, as Matplotlib takes them."""


def draw_reasons(map: DexterityMap, plan: SuturePlan, path: str | Path) -> Path:
    """Draw the reasons for a plan round the circle (reward, margin, joints, manipulability); return the path."""
    with style.figure(8.2, 8.6, path, placed=True) as figure:
        axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.3, 1, 1, 0.8], gridspec_kw=REASONS_AT)
        title = f"Reward, λ = {map.reward.weight:g} (dots: the plan; thin: cannot be driven)"
        rewards(axes[0], map, plan, title)
        margins(axes[1], map, "Joint margin")
        wrist_angles(axes[2], map, "Wrist in the better direction")
        manipulability(axes[3], map, map.by_arm, "Manipulability")
        for panel in axes[:-1]:
            panel.set_xlabel("")
        figure.align_ylabels(axes)
    return Path(path)


def draw_study(study: SutureStudy, folder: str | Path) -> list[Path]:
    """Draw the paper's Figs. 3 to 7 and Table I for a setup, together and separately; return the paths."""
    folder, map = Path(folder), study.map
    panels: dict[str, Callable[[Axes], None]] = {
        "figure_3": lambda axes: directions(axes, map, "Fig. 3: better direction"),
        "figure_4": lambda axes: wrist_angles(axes, map, "Fig. 4: wrist angles"),
        "figure_5": lambda axes: margins(axes, map, "Fig. 5: joint margin"),
        "figure_6": lambda axes: manipulability(axes, map, map.by_arm, "Fig. 6: manipulability"),
        "figure_7": lambda axes: lambda_curves(axes, study, "Fig. 7: plans at several λ"),
        "table_1": lambda axes: table_bars(axes, study, "Table I"),
    }
    note = fitted_note(study.fitted)
    for name, draw in panels.items():
        with style.figure(6.4, 3.6 if note else 3.4, folder / f"{name}.png") as figure:
            draw(figure.add_subplot())
            _caption(figure, note, 98)
    with style.figure(12.2, 9.8, folder / "figures.png") as figure:
        for axes, draw in zip(figure.subplots(3, 2).ravel(), panels.values(), strict=True):
            draw(axes)
        _caption(figure, note, 190)
    return [folder / f"{name}.png" for name in ("figures", *panels)]


def _caption(figure: Figure, note: str, line: int) -> None:
    """Write a note below the panels, in lines of at most this many letters."""
    if note:
        figure.supxlabel(textwrap.fill(note, line), x=0.01, ha="left", fontsize=8, color=style.QUIET)


def rewards(axes: Axes, map: DexterityMap, plan: SuturePlan, title: str) -> None:
    """Draw the reward in both directions, and the plan's sutures."""
    _both_directions(axes, map, map.values)
    for position, direction, reward in zip(plan.positions_rad, plan.directions, plan.rewards, strict=True):
        color = COLOURS[int(direction)]
        axes.plot(np.degrees(position), reward, "o", color=color, markeredgecolor=style.INK, markersize=8, zorder=4)
    axes.axhline(plan.reward, color=style.INK, linestyle="--", linewidth=1)
    worst, box = f"worst suture {plan.reward:.3f}", {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1}
    place = {"xytext": (-2, -3), "textcoords": "offset points", "ha": "right", "va": "top"}
    axes.annotate(worst, (360, plan.reward), fontsize=8, bbox=box, **place)  # left out where it is beyond the axes
    _round_circle(axes, title, "reward D")


def directions(axes: Axes, map: DexterityMap, title: str) -> None:
    """Draw the better direction round the circle (Fig. 3), hatched where it is infeasible."""
    theta = np.degrees(map.thetas_rad)
    cell = theta[1] - theta[0]
    for row, direction in enumerate(DIRECTIONS):
        bars = [(theta[start] - cell / 2, (end - start) * cell) for start, end in runs(map.choice == row)]
        axes.broken_barh(bars, (row - 0.35, 0.7), color=COLOURS[direction])
    for start, end in runs(~map.feasible):
        low, high = theta[start] - cell / 2, theta[start] + (end - start - 0.5) * cell
        axes.axvspan(low, high, facecolor="none", edgecolor=style.QUIET, hatch="////", linewidth=0)
    for switch in np.degrees(map.switches_rad):
        axes.annotate(f"{switch:.4g}°", (switch, 0.5), xytext=(4, 0), textcoords="offset points", va="center")
    for angle in PAPER_SWITCHES_DEG:
        axes.axvline(angle, color=style.INK, linestyle="--", linewidth=1, label="the paper's changes")
    axes.set_yticks([0, 1], [DIRECTION_NAMES[d].replace("counter", "counter-\n") for d in DIRECTIONS])
    axes.set_ylim(1.6, -0.6)
    axes.grid(axis="y", visible=False)
    _legend_above(axes, handles=axes.get_lines()[:1])
    _round_circle(axes, title)


def wrist_angles(axes: Axes, map: DexterityMap, title: str) -> None:
    """Draw the largest angle of each wrist joint in the better direction, with the limits (Fig. 4)."""
    theta, joints = np.degrees(map.thetas_rad), map.setup.arm.joints[3:]
    largest = np.degrees(map.chosen(map.joints.largest_wrist_rad))
    limits: dict[float, list[str]] = {}
    for joint, curve, color in zip(joints, largest.T, WRIST, strict=True):
        name = joint.name.removeprefix("wrist_")
        limits.setdefault(round(float(np.degrees(joint.upper)), 1), []).append(name)
        axes.plot(theta, curve, color=color, label=name)
    for limit, names in limits.items():
        if limit < 1.2 * np.nanmax(largest):
            axes.axhline(limit, color=style.INK, linestyle="--", linewidth=1, label=f"limit of {', '.join(names)}")
            axes.text(362, limit, f"{limit:.4g}°", va="center", fontsize=8)
    axes.set_ylim(0, None)
    _legend_above(axes, ncols=5)
    _round_circle(axes, title, "largest |angle|, deg")


def margins(axes: Axes, map: DexterityMap, title: str) -> None:
    """Draw the joint margin in both directions (Fig. 5), thin where a direction cannot be driven."""
    _both_directions(axes, map, map.margin)
    _round_circle(axes, title, f"margin Q\n{MARGIN_UNITS[map.reward.margin]}")


def manipulability(axes: Axes, map: DexterityMap, by_arm: NDArray[np.float64], title: str) -> None:
    """Draw the mean squared manipulability of arms round the circle (Fig. 6), in m^4 as ``det J`` is in m^2."""
    exponent = int(np.floor(np.log10(max(by_arm.max(), 1e-300))))
    assumed = "" if map.recorded else " (assumed)"
    for curve, name, color in zip(by_arm, ("arm 1", f"arm 2{assumed}"), (style.BLUE, style.VERMILION), strict=False):
        axes.plot(np.degrees(map.thetas_rad), curve / 10.0**exponent, color=color, label=name)
    axes.set_ylim(0, None)
    if len(by_arm) > 1:
        _legend_above(axes, ncols=2)
    _round_circle(axes, title, f"M ({'demonstrations' if map.recorded else 'surrogate'})\n1e{exponent} m⁴")


def lambda_curves(axes: Axes, study: SutureStudy, title: str) -> None:
    """Draw the reward of each plan at several lambda, over theta of its first suture (Fig. 7)."""
    sweep = study.sweep
    theta, colours = np.degrees(sweep.thetas_rad), mpl.colormaps[style.PATHS]
    for weight, curve in zip(sweep.weights, sweep.rewards, strict=True):
        color, best = colours(0.92 * weight), int(np.argmax(curve))
        axes.plot(theta, curve, color=color, linewidth=1.4)
        axes.plot(theta[best], curve[best], "o", color=color, markeredgecolor=style.INK, markersize=5, zorder=4)
    shades = ScalarMappable(cmap=ListedColormap(colours(np.linspace(0, 0.92, 64))))
    bar = axes.figure.colorbar(shades, ax=axes, pad=0.02, aspect=24)  # type: ignore[union-attr]
    bar.set_label("λ, weight of the margin (dots: best)")
    xlabel, ylabel = "theta of the first suture, deg", "reward; 10: best by one part alone"
    axes.set(title=title, xlim=(0, 90), xticks=range(0, 91, 15), xlabel=xlabel, ylabel=ylabel)


def table_bars(axes: Axes, study: SutureStudy, title: str) -> None:
    """Draw Table I as bars beside the paper's."""
    height = 0.38
    for shift, points, color in ((-0.5, study.points, style.BLUE), (0.5, PAPER_TABLE_1, PAPER_GREY)):
        for number, value in enumerate(points.ravel()):
            axes.barh(number + shift * height, value, height=height, color=color)
            axes.text(value + 1, number + shift * height, f"{value:.1f}", va="center", fontsize=8, color=style.INK)
    names = [f"{location},\n{allowed}" for location in LOCATIONS for allowed in ALLOWED]
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.set(title=title, xlim=(0, 112), xlabel="points, the best plan 100")
    axes.grid(axis="y", visible=False)
    ours, paper = Patch(color=style.BLUE, label="ours"), Patch(color=PAPER_GREY, label="paper")
    _legend_above(axes, ncols=2, handles=[ours, paper])


def _both_directions(axes: Axes, map: DexterityMap, values: NDArray[np.float64]) -> None:
    """Draw values (2, n) of both directions, thin and dotted where they cannot be driven."""
    theta = np.degrees(map.thetas_rad)
    for row, direction in enumerate(DIRECTIONS):
        color, inside = COLOURS[direction], np.where(map.joints.feasible[row], values[row], np.nan)
        axes.plot(theta, inside, color=color, linewidth=2.0, label=DIRECTION_NAMES[direction])
        axes.plot(theta, values[row], color=color, linewidth=0.9, linestyle=":")
    near = values[np.isfinite(values) & (values > -10)]  # values far below belong to positions out of reach
    low, high = (float(near.min()), float(near.max())) if len(near) else (0.0, 0.0)
    room = 0.06 * (high - low or 1.0)
    axes.set_ylim(low - room, high + room)
    _legend_above(axes, ncols=2)


def _legend_above(axes: Axes, **how: Any) -> None:
    """Put the legend above the axes on the right, where there are no data."""
    spacing = {"borderaxespad": 0.2, "handlelength": 1.2, "columnspacing": 1.0, "handletextpad": 0.5}
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, **spacing, **how)


def _round_circle(axes: Axes, title: str, ylabel: str = "") -> None:
    """Label the axes of a panel over the positions on the circle."""
    axes.set(title=title, xlim=(0, 360), xticks=range(0, 361, 45), xlabel="theta, deg", ylabel=ylabel)
