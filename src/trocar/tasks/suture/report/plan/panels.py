"""Curves round the circle that explain a plan, and the paper's Figs. 3 to 7."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from trocar.report import style
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.rewards import SURROGATE, DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS
from trocar.tasks.suture.planning.study import ALLOWED, LOCATIONS, PAPER_SWITCHES_DEG, PAPER_TABLE_1, SutureStudy
from trocar.tasks.suture.report.plan.circle import runs

if TYPE_CHECKING:
    from trocar.tasks.suture.demonstrations import Demonstrations

WAY = {1: style.BLUE, -1: style.ORANGE}
PAPER_GREY = "#BBBBBB"
TICKS = {1: "clockwise", -1: "counter-\nclockwise"}
WRIST = (style.BLUE, style.GREEN, style.PURPLE)
MARGIN_UNITS = {
    "smallest": "share of half the range",
    "normalised": "sum of squared shares",
    "clipped": "deg²",
    "paper": "deg², as printed",
}


def draw_reasons(map: DexterityMap, plan: SuturePlan, path: str | Path) -> Path:
    """Draw the reasons for a plan round the circle: reward, margin, joints, manipulability; return the path.

    Args:
        map: dexterity of all sutures.
        plan: the plan, marked in the first panel.
        path: file of the picture.
    """
    path = Path(path)
    with style.figure(8.2, 8.6, path) as figure:
        axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.3, 1, 1, 0.8])
        _reward(axes[0], map, plan)
        margins(axes[1], map)
        wrist = np.take_along_axis(map.joints.largest_wrist_rad, map.choice[None, :, None], 0)[0]
        wrist_angles(axes[2], map, wrist)
        manipulability(axes[3], map, map.manipulability[None], ("suturing arm",))
        for panel in axes[:-1]:
            panel.set_xlabel("")
        figure.align_ylabels(axes)
    return path


def draw_study(study: SutureStudy, folder: str | Path, recorded: Demonstrations | None = None) -> list[Path]:
    """Draw the paper's Figs. 3 to 7 and Table I for a setup, separately and together; return the paths.

    Args:
        study: the data.
        folder: folder of the pictures.
        recorded: demonstrations that the study's manipulability comes from; Fig. 6 then shows their arms.
    """
    folder = Path(folder)
    found = study.dexterity
    arms, by_arm = ("arm 1", "arm 2 (assumed)"), study.manipulability
    if recorded is not None:
        arms, by_arm = (
            tuple(f"arm {number + 1}" for number in range(len(recorded.arms))),
            recorded.per_arm_at(study.thetas_rad),
        )
    panels: dict[str, Callable[[Axes], None]] = {
        "figure_3": lambda axes: directions(axes, found, "Fig. 3: better direction"),
        "figure_4": lambda axes: wrist_angles(axes, found, study.wrist_rad, "Fig. 4: wrist angles"),
        "figure_5": lambda axes: margins(axes, found, "Fig. 5: joint margin"),
        "figure_6": lambda axes: manipulability(axes, found, by_arm, arms, "Fig. 6: manipulability"),
        "figure_7": lambda axes: lambda_curves(axes, study, "Fig. 7: plans at several λ"),
        "table_1": lambda axes: table_bars(axes, study, "Table I"),
    }
    paths = []
    for name, draw in panels.items():
        with style.figure(6.4, 3.4, folder / f"{name}.png") as figure:
            draw(figure.add_subplot())
        paths.append(folder / f"{name}.png")
    together = folder / "figures.png"
    with style.figure(12.2, 9.8, together) as figure:
        _together(figure, list(panels.values()))
    return [together, *paths]


def _together(figure: Figure, panels: list[Callable[[Axes], None]]) -> None:
    """Draw all panels in two columns."""
    for axes, draw in zip(figure.subplots(3, 2).ravel(), panels, strict=True):
        draw(axes)


def directions(axes: Axes, map: DexterityMap, title: str = "Better direction") -> None:
    """Draw the better direction round the circle (Fig. 3), hatched where it is infeasible."""
    theta = np.degrees(map.thetas_rad)
    cell = theta[1] - theta[0]
    for row, direction in enumerate(DIRECTIONS):
        for start, end in runs(map.choice == row):
            color = WAY[direction]
            axes.broken_barh([(theta[start] - cell / 2, (end - start) * cell)], (row - 0.35, 0.7), color=color)
    for start, end in runs(~map.feasible):
        axes.axvspan(
            theta[start] - cell / 2,
            theta[start] + (end - start - 0.5) * cell,
            facecolor="none",
            edgecolor=style.QUIET,
            hatch="////",
            linewidth=0,
        )
    for switch in np.degrees(map.switches_rad):
        axes.annotate(f"{switch:.4g}°", (switch, 0.5), xytext=(4, 0), textcoords="offset points", va="center")
    for angle in PAPER_SWITCHES_DEG:
        axes.axvline(angle, color=style.INK, linestyle="--", linewidth=1, label="the paper's changes")
    axes.set_yticks([0, 1], [TICKS[d] for d in DIRECTIONS])
    axes.set_ylim(1.6, -0.6)
    axes.grid(axis="y", visible=False)
    _legend_above(axes, 1, axes.get_lines()[:1])
    _circle_axis(axes, title)


def wrist_angles(
    axes: Axes, map: DexterityMap, wrist_rad: NDArray[np.float64], title: str = "Wrist in the better direction"
) -> None:
    """Draw the largest angle of each wrist joint in the better direction, with the limits (Fig. 4)."""
    theta, joints = np.degrees(map.thetas_rad), map.setup.arm.joints[3:]
    largest = np.degrees(wrist_rad)
    limits: dict[float, list[str]] = {}
    for joint, curve, color in zip(joints, largest.T, WRIST, strict=True):
        name = joint.name.removeprefix("wrist_")
        limits.setdefault(round(float(np.degrees(joint.upper)), 1), []).append(name)
        axes.plot(theta, curve, color=color, label=name)
    for limit, names in limits.items():
        if limit < 1.2 * np.nanmax(largest):
            axes.axhline(limit, color=style.INK, linestyle="--", linewidth=1, label=f"limit of {', '.join(names)}")
            axes.text(362, limit, f"{limit:.4g}°", va="center", fontsize=8)
    axes.set_ylabel("largest |angle|, deg")
    axes.set_ylim(0, None)
    _legend_above(axes, 5)
    _circle_axis(axes, title)


def margins(axes: Axes, map: DexterityMap, title: str = "Joint margin") -> None:
    """Draw the joint margin in both directions (Fig. 5), thin where a direction is beyond the limits."""
    theta = np.degrees(map.thetas_rad)
    for row, direction in enumerate(DIRECTIONS):
        _thin_beyond(axes, theta, map.margin[row], map.joints.feasible[row], WAY[direction], DIRECTION_NAMES[direction])
    axes.set_ylim(*_padded(map.margin))
    axes.set_ylabel(f"margin Q\n{MARGIN_UNITS[map.reward.margin]}")
    _legend_above(axes, 2)
    _circle_axis(axes, title)


def manipulability(
    axes: Axes, map: DexterityMap, values: NDArray[np.float64], names: tuple[str, ...], title: str = "Manipulability"
) -> None:
    """Draw the mean squared manipulability of each arm round the circle (Fig. 6), in m^4 as ``det J`` is in m^2."""
    theta = np.degrees(map.thetas_rad)
    exponent = int(np.floor(np.log10(max(values.max(), 1e-300))))
    for curve, name, color in zip(values, names, (style.BLUE, style.VERMILION), strict=False):
        axes.plot(theta, curve / 10.0**exponent, color=color, label=name)
    axes.set_ylim(0, None)
    source = "surrogate" if map.source == SURROGATE else "demonstrations"
    axes.set_ylabel(f"M ({source})\n1e{exponent} m⁴")
    if len(values) > 1:
        _legend_above(axes, 2)
    _circle_axis(axes, title)


def lambda_curves(axes: Axes, study: SutureStudy, title: str = "Plans at several λ (dots: the best)") -> None:
    """Draw the reward of each plan at several lambda, over theta of its first suture (Fig. 7)."""
    sweep = study.sweep
    theta, colours = np.degrees(sweep.thetas_rad), mpl.colormaps[style.PATHS]
    for weight, curve in zip(sweep.weights, sweep.rewards, strict=True):
        color = colours(0.92 * weight)
        axes.plot(theta, curve, color=color, linewidth=1.4)
        best = int(np.argmax(curve))
        axes.plot(theta[best], curve[best], "o", color=color, markeredgecolor=style.INK, markersize=5, zorder=4)
    bar = axes.figure.colorbar(  # type: ignore[union-attr]
        ScalarMappable(cmap=ListedColormap(colours(np.linspace(0, 0.92, 64)))),
        ax=axes,
        pad=0.02,
        aspect=24,
    )
    bar.set_label("λ, weight of the margin (dots: best)")
    axes.set_xlim(0, 90)
    axes.set_xticks(range(0, 91, 15))
    axes.set_xlabel("theta of the first suture, deg")
    axes.set_ylabel("reward; 10: best by one part alone")
    axes.set_title(title)


def table_bars(axes: Axes, study: SutureStudy, title: str = "Table I") -> None:
    """Draw Table I as bars beside the paper's."""
    rows = [(i, j) for i in range(len(LOCATIONS)) for j in range(len(ALLOWED))]
    height = 0.38
    for number, (i, j) in enumerate(rows):
        for shift, value, color in (
            (-height / 2, study.table.points[i, j], style.BLUE),
            (height / 2, PAPER_TABLE_1[i, j], PAPER_GREY),
        ):
            axes.barh(number + shift, value, height=height, color=color)
            axes.text(value + 1, number + shift, f"{value:.1f}", va="center", fontsize=8, color=style.INK)
    axes.set_yticks(range(len(rows)), [f"{LOCATIONS[i]},\n{ALLOWED[j]}" for i, j in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 112)
    axes.set_xlabel("points, the best plan 100")
    axes.grid(axis="y", visible=False)
    _legend_above(axes, 2, [Patch(color=style.BLUE, label="ours"), Patch(color=PAPER_GREY, label="paper")])
    axes.set_title(title)


def _reward(axes: Axes, map: DexterityMap, plan: SuturePlan) -> None:
    """Draw the reward in both directions, and the plan's sutures."""
    theta = np.degrees(map.thetas_rad)
    for row, direction in enumerate(DIRECTIONS):
        _thin_beyond(axes, theta, map.values[row], map.joints.feasible[row], WAY[direction], DIRECTION_NAMES[direction])
    for position, direction, reward in zip(plan.positions_rad, plan.directions, plan.rewards, strict=True):
        color = WAY[int(direction)]
        axes.plot(np.degrees(position), reward, "o", color=color, markeredgecolor=style.INK, markersize=8, zorder=4)
    axes.axhline(plan.reward, color=style.INK, linestyle="--", linewidth=1)
    axes.annotate(
        f"worst suture {plan.reward:.3f}",
        (360, plan.reward),
        xytext=(-2, -3),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
    )
    axes.set_ylim(*_padded(map.values))
    axes.set_ylabel("reward D")
    _legend_above(axes, 2)
    _circle_axis(axes, f"Reward, λ = {map.reward.weight:g} (dots: the plan; thin: beyond the limits)")


def _thin_beyond(
    axes: Axes,
    theta_deg: NDArray[np.float64],
    values: NDArray[np.float64],
    feasible: NDArray[np.bool_],
    color: str,
    name: str,
) -> None:
    """Draw a curve, thin and dotted where it is not feasible."""
    axes.plot(theta_deg, np.where(feasible, values, np.nan), color=color, linewidth=2.0, label=name)
    axes.plot(theta_deg, values, color=color, linewidth=0.9, linestyle=":")


def _padded(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return padded limits of an axis; values far below the others, out of all reach, are left out if possible."""
    finite = values[np.isfinite(values)]
    near = finite[finite > -10]
    shown = near if len(near) else finite
    low, high = (float(shown.min()), float(shown.max())) if len(shown) else (0.0, 0.0)
    room = 0.06 * (high - low or 1.0)
    return low - room, high + room


def _legend_above(axes: Axes, columns: int, handles: Sequence[Artist] | None = None) -> None:
    """Put the legend above the axes on the right, where there are no data."""
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderaxespad=0.2,
        handlelength=1.2,
        columnspacing=1.0,
        handletextpad=0.5,
        fontsize=8,
    )


def _circle_axis(axes: Axes, title: str) -> None:
    """Label the positions on the circle."""
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 45))
    axes.set_xlabel("theta, deg")
    axes.set_title(title)
