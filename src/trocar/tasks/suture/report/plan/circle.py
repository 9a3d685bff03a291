"""The circle with the sutures of a plan, over rings that show the reward of sutures all round it."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Wedge
from numpy.typing import NDArray

from trocar.geometry import TURN
from trocar.report import style
from trocar.tasks.suture.planning.joints import suture_joints
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.primitive import bite_m, comes_out, tip_end_m
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import CLOCKWISE, DIRECTION_NAMES, DIRECTIONS, SutureSetup

MESH, BLOCKED = "#F7F5EF", "#D9D9D9"
RING, GAP = 0.17, 0.03  # width of a ring, and gap between the two, as shares of the rings' inner radius

SIZE_IN = (7.4, 6.6)
LABEL_RAD = math.radians(25.0)  # labels this far apart do not overlap


def draw_plan(map: DexterityMap, plan: SuturePlan, path: str | Path, title: str = "") -> Path:
    """Draw :func:`circle` with a plan and return the path.

    Args:
        map: dexterity of all sutures.
        plan: the plan to draw.
        path: file of the picture.
        title: title; default: number of sutures and reward.
    """
    with style.figure(*SIZE_IN, path) as figure:
        circle(figure, map, plan, title)
    return Path(path)


def circle(figure: Figure, map: DexterityMap, plan: SuturePlan | None = None, title: str = "") -> None:
    """Draw the circle as seen from above the tissue, in mm, and the sutures of a plan.

    The outer ring is coloured by the dexterity of clockwise sutures, the inner one by that of counterclockwise sutures;
    grey hatching marks positions out of reach in that direction. Arrows are the sutures from entry to exit, or to where
    the tip stops in the tissue.

    Args:
        figure: empty.
        map: dexterity of all sutures.
        plan: None: rings only.
        title: title; default: number of sutures and reward.
    """
    setup = map.setup
    inner = _rings_from(setup)
    norm = Normalize(*map.span(np.empty(0) if plan is None else plan.rewards))
    figure.set_size_inches(*SIZE_IN)
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.axis("off")
    _draw_tissue(axes, setup)
    for row, radius in ((0, inner * (1 + RING + GAP)), (1, inner)):
        _draw_ring(axes, map, row, radius, inner * RING, norm)
    outer = inner * (1 + 2 * RING + GAP)
    _draw_angles(axes, outer)
    _draw_base(axes, setup, outer)
    if plan is not None:
        _draw_sutures(axes, setup, plan, inner, norm)
        figure.text(0.01, 0.955, plan.certified, color=style.QUIET, fontsize=8, va="top")
    colours = ScalarMappable(norm, style.PATHS)
    figure.colorbar(colours, ax=axes, shrink=0.62, pad=0.02, aspect=28).set_label("reward of a suture")
    hatched = Patch(facecolor=BLOCKED, edgecolor=style.QUIET, hatch="////", linewidth=0, label="beyond the limits")
    axes.legend(handles=[hatched], loc="lower right", borderaxespad=0)
    default = "Dexterity: outer ring clockwise, inner ring counterclockwise" if plan is None else _title(plan)
    figure.suptitle(f"{title or default}\n", x=0.01, ha="left", fontsize=10, fontweight="bold")


def _title(plan: SuturePlan) -> str:
    """Return the title of a plan: number of sutures, reward, and whether it is out of reach."""
    title = f"{len(plan.rewards)} sutures, reward of the worst {plan.reward:.3f}"
    return title if plan.feasible else f"{title}, out of reach"


def _rings_from(setup: SutureSetup) -> float:
    """Return the rings' inner radius in mm, which encloses all arrows."""
    return 1.1e3 * math.hypot(setup.circle.radius_m, tip_end_m(setup))


def _draw_tissue(axes: Axes, setup: SutureSetup) -> None:
    """Draw the mesh within the circle."""
    radius = 1e3 * setup.circle.radius_m
    mesh = Circle((0, 0), radius, facecolor=MESH, edgecolor=style.INK, linewidth=1.2, zorder=1)
    axes.add_patch(mesh)
    for offset in np.linspace(-radius, radius, 17)[1:-1]:
        half = math.sqrt(radius**2 - offset**2)
        axes.plot([-half, half], [offset, offset], color="#E6E1D3", linewidth=0.6, zorder=1.5)
        axes.plot([offset, offset], [-half, half], color="#E6E1D3", linewidth=0.6, zorder=1.5)
    axes.text(0, 0, f"mesh\nradius\n{radius:.4g} mm", ha="center", va="center", fontsize=8, color=style.QUIET, zorder=2)


def _draw_ring(axes: Axes, map: DexterityMap, row: int, radius: float, width: float, norm: Normalize) -> None:
    """Draw one ring, with a cell centred at each position, and hatch what is out of reach."""
    n = len(map.thetas_rad)
    edges = (np.arange(n + 1) - 0.5) * (TURN / n)
    radii = np.array([radius, radius + width])[:, None]
    feasible = map.joints.feasible[row]
    shown = np.ma.masked_array(map.values[row], ~feasible)[None]
    axes.pcolormesh(
        radii * np.cos(edges), radii * np.sin(edges), shown, cmap=style.PATHS, norm=norm, rasterized=True, zorder=1
    )
    for start, end in runs(~feasible):
        arc = np.degrees(edges[[start, end]])
        wedge = Wedge(
            (0, 0), radius + width, arc[0], arc[1], width=width, facecolor=BLOCKED, edgecolor=style.QUIET, hatch="////"
        )
        wedge.set_linewidth(0)
        axes.add_patch(wedge)
    for edge in (radius, radius + width):
        axes.add_patch(Circle((0, 0), edge, fill=False, edgecolor="white", linewidth=0.8, zorder=2))


def runs(marked: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return runs (from, to), ends excluded, of marked cells; a run across the end of the array counts as two."""
    steps = np.diff(marked.astype(int), prepend=0, append=0)
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _draw_angles(axes: Axes, outer: float) -> None:
    """Draw ticks and angles outside the rings."""
    for angle in range(0, 360, 30):
        along = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        x, y = np.outer(along, [outer, 1.03 * outer])
        axes.plot(x, y, color=style.QUIET, linewidth=0.8)
        x, y = 1.09 * outer * along
        axes.text(x, y, f"{angle}°", ha="center", va="center", color=style.QUIET, fontsize=8)
    axes.set_xlim(-1.36 * outer, 1.36 * outer)
    axes.set_ylim(-1.27 * outer, 1.27 * outer)


def _draw_base(axes: Axes, setup: SutureSetup, outer: float) -> None:
    """Draw the direction of the arm's base, if the base stands beside the circle."""
    place = 1e3 * setup.T_base_circle.inverse().translation_m
    away = math.hypot(place[0], place[1])
    if away < 1e-6:
        return
    along = place[:2] / away
    axes.annotate(
        "",
        xy=tuple(1.15 * outer * along),
        xytext=tuple(1.26 * outer * along),
        arrowprops={"arrowstyle": "-|>", "color": style.VERMILION, "linewidth": 2.0, "mutation_scale": 16},
        annotation_clip=False,
    )
    side = 1 if along[0] > -1e-6 else -1
    axes.annotate(
        f"the arm's base:\n{away:.0f} mm beside,\n{place[2]:.0f} mm above\nthe circle's centre",
        tuple(1.21 * outer * along),
        xytext=(14 * side, 0),
        textcoords="offset points",
        ha="left" if side > 0 else "right",
        va="center",
        fontsize=8,
        color=style.VERMILION,
        annotation_clip=False,
    )


def _draw_sutures(axes: Axes, setup: SutureSetup, plan: SuturePlan, inner: float, norm: Normalize) -> None:
    """Draw the sutures as arrows to where the tip ends, red-edged if out of reach, and mark them in their ring."""
    joints = suture_joints(setup, plan.positions_rad)
    radius, length = 1e3 * setup.circle.radius_m, 1e3 * tip_end_m(setup)
    back = 1e3 * bite_m(setup) / 2 if setup.insertion.theta_is == "middle" else 0.0
    colours = mpl.colormaps[style.PATHS]
    for i, (theta, direction, reward) in enumerate(zip(plan.positions_rad, plan.directions, plan.rewards, strict=True)):
        feasible = bool(joints.feasible[DIRECTIONS.index(int(direction)), i])
        out = np.array([math.cos(theta), math.sin(theta)])
        heading = -int(direction) * np.array([-out[1], out[0]])
        entry = radius * out - back * heading
        arrow = FancyArrowPatch(
            tuple(entry),
            tuple(entry + length * heading),
            arrowstyle="simple,head_length=9,head_width=11,tail_width=4",
            shrinkA=0,
            shrinkB=0,
            facecolor=colours(norm(reward)),
            edgecolor=style.INK if feasible else style.VERMILION,
            linewidth=0.8 if feasible else 2.0,
            zorder=4,
        )
        axes.add_patch(arrow)
        axes.plot(*entry, "o", color="white", markeredgecolor=style.INK, markersize=4, zorder=5)
        ring = inner * (1 + 1.5 * RING + GAP) if int(direction) == CLOCKWISE else inner * (1 + RING / 2)
        x, y = np.outer(out, [radius, ring])
        axes.plot(x, y, color=style.INK, linewidth=0.7, linestyle=":", zorder=3)
        axes.plot(*(ring * out), "o", color="white", markeredgecolor=style.INK, markersize=6, zorder=5)
    for i in (labelled := apart(plan)):
        x, y = 0.70 * radius * np.array([math.cos(plan.positions_rad[i]), math.sin(plan.positions_rad[i])])
        text = f"{math.degrees(plan.positions_rad[i]):.4g}°\n{plan.rewards[i]:.3f}"
        axes.text(x, y, text, ha="center", va="center", fontsize=8, color=style.INK, zorder=6)
    order = ", ".join(
        f"{where} ring {DIRECTION_NAMES[d]}" for where, d in zip(("outer", "inner"), DIRECTIONS, strict=True)
    )
    notes = [order]
    if len(labelled) < len(plan.rewards):
        notes.append(f"{len(labelled)} of {len(plan.rewards)} sutures labelled, including the worst")
    if not comes_out(setup):
        notes.append("the needle never comes out: arrows end where its tip stops in the tissue")
    axes.text(0, 0.0, "\n".join(notes), transform=axes.transAxes, color=style.QUIET, fontsize=8, va="bottom")


def apart(plan: SuturePlan) -> list[int]:
    """Return the sutures to label: the worst and, from there round, each at least ``LABEL_RAD`` from the last one."""
    worst = int(np.argmin(plan.rewards))
    chosen = [worst]
    for i in (np.arange(1, len(plan.rewards)) + worst) % len(plan.rewards):
        behind, ahead = (plan.positions_rad[[i, worst]] - plan.positions_rad[[chosen[-1], i]]) % TURN
        if min(behind, ahead) > LABEL_RAD:
            chosen.append(int(i))
    return chosen
