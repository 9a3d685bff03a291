"""The circle with a plan's sutures, and rings that show the reward of a suture at each position round it."""

from __future__ import annotations

import math
import textwrap
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Wedge
from numpy.typing import NDArray
from PIL import Image

from trocar.counting import counted
from trocar.errors import InvalidInput
from trocar.geometry import TURN
from trocar.report import style
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.primitive import Suture, sutures_at
from trocar.tasks.suture.planning.rewards import NO_REWARD, DexterityMap
from trocar.tasks.suture.planning.setup import CLOCKWISE, DIRECTION_NAMES, DIRECTIONS, SutureSetup

MESH, MESH_LINE, DEFECT, BLOCKED = "#F7F5EF", "#E6E1D3", "#EBD5CC", "#D9D9D9"
RING, GAP = 0.17, 0.03  # width of a ring, and gap between the two, as shares of the rings' inner radius
SIZE_IN = (7.4, 6.6)
AXES_AT, BAR_AT = (0.01, 0.005, 0.87, 0.925), (0.897, 0.183, 0.019, 0.573)  # left, bottom, width, height: shares
LINE = 118  # letters of small text in a line as wide as the figure
BESIDE = 0.70  # sine of the angle from which on a port's label has room beside its arrow
LABEL_RAD = math.radians(25.0)  # labels this far apart do not overlap
TEXTURE_PIXELS, SPAN = 1000, 1.01  # pixels of a texture's side; half the side as a share of the rings' outer radius


def draw_plan(map: DexterityMap, plan: SuturePlan, path: str | Path, title: str = "") -> Path:
    """Draw :func:`circle` with a plan and return the path of the picture."""
    with style.figure(*SIZE_IN, path, placed=True) as figure:
        circle(figure, map, plan, title)
    return Path(path)


def circle(figure: Figure, map: DexterityMap, plan: SuturePlan | None = None, title: str = "") -> None:
    """Draw the circle as seen from above the tissue, in mm, and the sutures of a plan; without one, the rings only.

    The outer ring is coloured by the dexterity of clockwise sutures, the inner one by that of counterclockwise sutures;
    grey hatching marks positions out of reach in that direction. Arrows are the sutures from entry to exit, or to where
    the tip stops in the tissue, on the mesh over the defect. Red arcs outside the rings are forbidden, triangles mark
    fixed positions. The figure must be empty; its default title is the number of sutures and the reward.
    """
    setup, norm = map.setup, Normalize(*map.span(np.empty(0) if plan is None else plan.rewards))
    outer = ring_radii_mm(setup).max()
    figure.set_size_inches(*SIZE_IN)
    axes = figure.add_axes(AXES_AT)
    axes.set_aspect("equal")
    axes.axis("off")
    _draw_mesh(axes, setup)
    _draw_rings(axes, map, norm)
    _draw_angles(axes, outer)
    _draw_port(axes, "the arm's base", setup.T_base_circle.inverse().translation_m, outer)
    if setup.puller.up_m:
        port_m = setup.circle.T_world_circle.inverse().apply(setup.puller.port_m)
        _draw_port(axes, "the second\narm's port", port_m, outer)
    if plan is not None:
        _draw_arrows(axes, map, plan, norm)
        _label_sutures(axes, setup, plan)
        _draw_spacing(axes, plan, outer)
        lines = textwrap.fill(plan.certified, LINE)
        figure.text(0.01, 0.955, lines, color=style.QUIET, fontsize=8, va="top")
    colours = ScalarMappable(norm, style.PATHS)
    figure.colorbar(colours, cax=figure.add_axes(BAR_AT)).set_label("reward of a suture", labelpad=1)
    hatched = Patch(facecolor=BLOCKED, edgecolor=style.QUIET, hatch="////", linewidth=0, label="cannot be driven")
    handles: list[Artist] = [hatched]
    if plan is not None and plan.spacing is not None:
        if plan.spacing.forbidden_rad:
            handles.append(Patch(facecolor=style.VERMILION, linewidth=0, label="forbidden"))
        if plan.spacing.fixed_rad:
            handles.append(Line2D([], [], marker="^", color=style.INK, linestyle="", label="fixed position"))
    axes.legend(handles=handles, loc="lower right", borderaxespad=0)
    usual = "Dexterity: outer ring clockwise, inner ring counterclockwise"
    if plan is not None:
        reach = "" if plan.feasible else ", out of reach"
        usual = f"{counted(len(plan.rewards), 'suture')}, reward of the worst {_shown(plan.reward)}{reach}"
    figure.suptitle(title or usual, x=0.01, y=0.99, ha="left", fontsize=10, fontweight="bold")


def texture(map: DexterityMap, plan: SuturePlan) -> tuple[NDArray[np.uint8], float]:
    """Return rings and arrows alone as a picture (k, k, 4), rows along y and columns along x, and its side in m."""
    norm, half_mm = Normalize(*map.span(plan.rewards)), SPAN * float(ring_radii_mm(map.setup).max())
    with mpl.rc_context({**style.RC, "hatch.linewidth": 0.0}):
        figure = Figure(figsize=(5.0, 5.0))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.axis("off")
        axes.set_xlim(-half_mm, half_mm)
        axes.set_ylim(half_mm, -half_mm)  # rows of the picture run along y
        _draw_rings(axes, map, norm)
        _draw_arrows(axes, map, plan, norm)
        png = BytesIO()
        figure.savefig(png, format="png", dpi=TEXTURE_PIXELS / 5.0, transparent=True)
    return np.asarray(Image.open(png)), 2e-3 * half_mm


def ring_radii_mm(setup: SutureSetup) -> NDArray[np.float64]:
    """Return inner and outer radius (2, 2) of the rings, clockwise first; they enclose all arrows and the mesh."""
    reach_m = float(np.linalg.norm(Suture(setup, 0.0, CLOCKWISE).ends_m, axis=1).max())
    inner = 1e3 * max(1.1 * reach_m, 1.04 * setup.circle.mesh_radius_m)
    return inner * np.array([[1 + RING + GAP, 1 + 2 * RING + GAP], [1.0, 1 + RING]])


def _toward(angle_rad: float) -> NDArray[np.float64]:
    return np.array([math.cos(angle_rad), math.sin(angle_rad)])


def _draw_mesh(axes: Axes, setup: SutureSetup) -> None:
    """Draw the mesh to its edge, the circle of sutures on it, and the defect that it covers."""
    circle = setup.circle
    edge, radius, defect = (1e3 * value for value in (circle.mesh_radius_m, circle.radius_m, circle.defect_radius_m))
    axes.add_patch(Circle((0, 0), edge, facecolor=MESH, edgecolor=style.INK, linewidth=1.2, zorder=2.2))
    offsets = np.linspace(-edge, edge, 19)[1:-1]
    halves = np.sqrt(edge**2 - offsets**2)
    axes.hlines(offsets, -halves, halves, color=MESH_LINE, linewidth=0.6, zorder=2.3)
    axes.vlines(offsets, -halves, halves, color=MESH_LINE, linewidth=0.6, zorder=2.3)
    axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=style.QUIET, linewidth=0.8, linestyle="--", zorder=2.4))
    text = f"mesh, radius {edge:.3g} mm"
    if defect > 0:
        axes.add_patch(Circle((0, 0), defect, facecolor=DEFECT, edgecolor=style.QUIET, linewidth=0.8, zorder=2.4))
        text = f"defect,\nradius\n{defect:.3g} mm\n({text.replace(', ', chr(10))})"
    axes.text(0, 0, text, ha="center", va="center", fontsize=7, color=style.QUIET, zorder=2.6)


def _draw_spacing(axes: Axes, plan: SuturePlan, outer: float) -> None:
    """Draw forbidden arcs and fixed positions outside the rings."""
    if plan.spacing is None:
        return
    for start, end in plan.spacing.forbidden_rad:
        arc = Wedge((0, 0), 1.035 * outer, math.degrees(start), math.degrees(end), width=0.025 * outer)
        arc.set(facecolor=style.VERMILION, linewidth=0, zorder=3)
        axes.add_patch(arc)
    for angle in plan.spacing.fixed_rad:
        x, y = 1.028 * outer * _toward(angle)
        axes.plot(x, y, marker=(3, 0, math.degrees(angle) + 90), color=style.INK, markersize=8, zorder=4)


def _draw_rings(axes: Axes, map: DexterityMap, norm: Normalize) -> None:
    """Draw both rings, with a cell centred at each position, and hatch what is out of reach."""
    n = len(map.thetas_rad)
    edges = (np.arange(n + 1) - 0.5) * (TURN / n)
    for row, (low, high) in enumerate(ring_radii_mm(map.setup)):
        radii, feasible = np.array([low, high])[:, None], map.joints.feasible[row]
        shown = np.ma.masked_array(map.values[row], ~feasible)[None]
        x, y = radii * np.cos(edges), radii * np.sin(edges)
        axes.pcolormesh(x, y, shown, cmap=style.PATHS, norm=norm, rasterized=True, zorder=1)
        for start, end in runs(~feasible):
            arc = np.degrees(edges[[start, end]])
            wedge = Wedge((0, 0), high, arc[0], arc[1], width=high - low, facecolor=BLOCKED, hatch="////", linewidth=0)
            wedge.set_edgecolor(style.QUIET)
            axes.add_patch(wedge)
        for edge in (low, high):
            axes.add_patch(Circle((0, 0), edge, fill=False, edgecolor="white", linewidth=0.8, zorder=2))


def runs(marked: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return runs (from, to), ends excluded, of marked cells; a run across the end of the array counts as two."""
    steps = np.diff(marked.astype(int), prepend=0, append=0)
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _draw_angles(axes: Axes, outer: float) -> None:
    """Draw ticks and angles outside the rings."""
    for angle in range(0, 360, 30):
        along = _toward(math.radians(angle))
        x, y = np.outer(along, [outer, 1.03 * outer])
        axes.plot(x, y, color=style.QUIET, linewidth=0.8)
        x, y = 1.11 * outer * along
        axes.text(x, y, f"{angle}°", ha="center", va="center", color=style.QUIET, fontsize=8)
    axes.set_xlim(-1.36 * outer, 1.36 * outer)
    axes.set_ylim(-1.27 * outer, 1.27 * outer)


def _draw_port(axes: Axes, what: str, p_circle_m: NDArray[np.float64], outer: float) -> None:
    """Draw the direction of an arm's port (3,), unless it is right above the circle's centre."""
    place = 1e3 * p_circle_m
    away = math.hypot(place[0], place[1])
    if away < 1e-6:
        return
    along = place[:2] / away
    arrow = {"arrowstyle": "-|>", "color": style.VERMILION, "linewidth": 2.0, "mutation_scale": 16}
    tip, tail, label = (tuple(share * outer * along) for share in (1.15, 1.26, 1.20))
    axes.annotate("", xy=tip, xytext=tail, arrowprops=arrow, annotation_clip=False)
    text = f"{what}:\n{away:.0f} mm beside,\n{place[2]:.0f} mm above\nthe circle's centre"
    if abs(along[1]) < BESIDE:  # there is no room beside it
        up, text = along[1] > -1e-6, text.replace("circle's ", "circle's\n")
        aligned = {"xytext": (0, 9 if up else -9), "ha": "center", "va": "bottom" if up else "top"}
    else:
        right, label = along[0] > -1e-6, (label[0], min(max(label[1], -1.12 * outer), 1.12 * outer))
        aligned = {"xytext": (14 if right else -14, 0), "ha": "left" if right else "right", "va": "center"}
    how = {"textcoords": "offset points", "annotation_clip": False, "fontsize": 8, "color": style.VERMILION}
    axes.annotate(text, label, **aligned, **how)


def _draw_arrows(axes: Axes, map: DexterityMap, plan: SuturePlan, norm: Normalize) -> None:
    """Draw the sutures as arrows to where the tip ends, red-edged if out of reach, and mark them in their ring."""
    feasible = map.at(plan.positions_rad).joints.feasible
    colours, rings = mpl.colormaps[style.PATHS], ring_radii_mm(map.setup).mean(1)
    for i, suture in enumerate(sutures_at(map.setup, plan.positions_rad, plan.directions)):
        can = bool(feasible[suture.row, i])
        start, end = 1e3 * suture.ends_m
        shape = {"arrowstyle": "simple,head_length=9,head_width=11,tail_width=4", "shrinkA": 0, "shrinkB": 0}
        edge = {"edgecolor": style.INK, "linewidth": 0.8} if can else {"edgecolor": style.VERMILION, "linewidth": 2.0}
        face = colours(norm(plan.rewards[i]))
        axes.add_patch(FancyArrowPatch(tuple(start), tuple(end), facecolor=face, zorder=4, **shape, **edge))
        axes.plot(*start, "o", color="white", markeredgecolor=style.INK, markersize=4, zorder=5)
        line = np.outer(_toward(suture.theta_rad), [1e3 * map.setup.circle.radius_m, rings[suture.row]])
        axes.plot(*line, color=style.INK, linewidth=0.7, linestyle=":", zorder=3)
        axes.plot(*line[:, 1], "o", color="white", markeredgecolor=style.INK, markersize=6, zorder=5)


def _shown(reward: float) -> str:
    """Return a reward as text; ``none`` where no joints can hold the needle (``NO_REWARD``)."""
    return f"{reward:.3f}" if reward > NO_REWARD else "none"


def _label_sutures(axes: Axes, setup: SutureSetup, plan: SuturePlan) -> None:
    """Write angle and reward of sutures within the circle, and notes below."""
    between_m = 0.5 * (setup.circle.radius_m + setup.circle.defect_radius_m)
    for i in (labelled := apart(plan)):
        theta = plan.positions_rad[i]
        x, y = 1e3 * max(0.72 * setup.circle.radius_m, between_m) * _toward(theta)
        text = f"{math.degrees(theta):.4g}°\n{_shown(plan.rewards[i])}"
        axes.text(x, y, text, ha="center", va="center", fontsize=8, color=style.INK, zorder=6)
    names = [DIRECTION_NAMES[direction] for direction in DIRECTIONS]
    notes = [f"outer ring {names[0]}, inner ring {names[1]}"]
    if len(labelled) < len(plan.rewards):
        notes.append(f"{len(labelled)} of {len(plan.rewards)} sutures labelled, including the worst")
    if not setup.comes_out:
        notes.append("the needle never comes out: arrows end where its tip stops in the tissue")
    axes.text(0, 0.0, "\n".join(notes), transform=axes.transAxes, color=style.QUIET, fontsize=8, va="bottom")


def apart(plan: SuturePlan) -> list[int]:
    """Return the sutures to label: the worst, then round the circle each ``LABEL_RAD`` or more from other labels."""
    worst = int(np.argmin(plan.rewards))
    chosen = [worst]
    for i in (np.arange(1, len(plan.rewards)) + worst) % len(plan.rewards):
        behind, ahead = (plan.positions_rad[[i, worst]] - plan.positions_rad[[chosen[-1], i]]) % TURN
        if min(behind, ahead) > LABEL_RAD:
            chosen.append(int(i))
    return chosen


def _plot_map(thing: DexterityMap, plan: SuturePlan | None = None, title: str = "") -> style.Picture:
    return style.picture(lambda figure: circle(figure, thing, plan, title), placed=True)


def _plot_plan(thing: SuturePlan, map: DexterityMap | None = None, title: str = "") -> style.Picture:
    if map is None:
        raise InvalidInput("a plan of sutures", "is drawn on its dexterity map", "give plot(plan, map=map)")
    return _plot_map(map, thing, title)


PLOTS = {DexterityMap: _plot_map, SuturePlan: _plot_plan}
"""What ``trocar.report.plot.plot`` draws of suture plans."""
