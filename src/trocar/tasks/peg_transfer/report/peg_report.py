"""Pictures, rows of the paper and figures of the peg transfer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.patches import Circle, Rectangle
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.eval import PaperCount, PaperRow, TaskReport, in_words
from trocar.eval.statistics import session_interval
from trocar.geometry import SE3
from trocar.replay import Viewpoint
from trocar.report import style
from trocar.report.timechart import NEARLY_S, parts_of, turns_of
from trocar.tasks.peg_transfer.goals import PegSet, TransferOutcome

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

MOTION = "motion"


def motion_floor_s(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the mean time per transfer by part, for the arm that moves most in each trial; the parts add up to it.

    ``motion`` among them is the floor, since that arm can do nothing else meanwhile. Planning, looking and jaw actions
    that overlap with motion cost nothing, and are not counted.

    Args:
        trials: of one run.
    """
    count = sum(len(trial.scores) for trial in trials)
    seconds: dict[str, float] = {MOTION: 0.0}
    for trial in trials:
        arms = [parts_of(trial.spans, arm, trial.duration_s) for arm in trial.about["arms"]]
        for name, part_s in max(arms, key=lambda parts: parts.get(MOTION, 0.0)).items():
            seconds[name] = seconds.get(name, 0.0) + part_s / max(count, 1)
    return seconds


def floor_sentence(seconds: dict[str, float]) -> str:
    """Return this as a sentence: the floor, then the parts that explain the gap, the largest first."""
    gap = sorted(((s, name) for name, s in seconds.items() if name != MOTION and s >= 0.005), reverse=True)
    parts = ", ".join(f"{name} {s:.2f}" for s, name in gap)
    total = sum(seconds.values())
    return (
        f"motion alone (of the arm that moves most) would take {seconds[MOTION]:.2f} s per transfer; the "
        f"{total - seconds[MOTION]:.2f} s above that are {parts}"
    )


PEG_RADIUS_MM, PEG_HEIGHT_MM = 1.75, 20.0  # facts/peg_transfer.md, "The board and the blocks"
BOARD_MM = (152.0, 105.0)  # width and depth of the board's lowest plate, as drawn


def draw_paths(
    times_s: ArrayLike,
    p_board_m: ArrayLike,
    transfer: ArrayLike,
    pegs_m: ArrayLike,
    path: Path,
    *,
    title: str = "Path of the tool over the board",
) -> Path:
    """Draw the path of the tip from above and from the side, coloured by transfer, and return the path.

    Args:
        times_s: (n,) increasing.
        p_board_m: (n, 3) tip in the board frame, z up along the pegs.
        transfer: (n,) index of the transfer, below 0 where there is none.
        pegs_m: (pegs, 2) or (pegs, 3), feet of the pegs in the board frame.
        path: of the picture.
        title: above it.
    """
    times, tip = np.asarray(times_s, dtype=np.float64), 1e3 * np.asarray(p_board_m, dtype=np.float64)
    index, pegs = np.asarray(transfer, dtype=np.float64), 1e3 * np.asarray(pegs_m, dtype=np.float64)
    if tip.shape != (len(times), 3) or index.shape != times.shape or len(times) < 2:
        got = f"got {times.shape}, {tip.shape}, {index.shape}"
        raise InvalidInput("a tool path", f"needs times (n,), tips (n, 3), transfers (n,), n of 2 or more; {got}")
    with style.figure(8.2, 8.0, path) as figure:
        above, side = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
        _board_from_above(above, pegs)
        _board_from_side(side, pegs)
        count = max(1, int(index.max()) + 1)
        norm = BoundaryNorm(np.arange(count + 1) + 0.5, 256) if count > 1 else None
        for axes, columns in ((above, (0, 1)), (side, (0, 2))):
            lines = _coloured(tip[:, columns], index, norm)
            axes.add_collection(lines)
        if norm is not None:
            bar = figure.colorbar(lines, ax=[above, side], pad=0.01, aspect=40, ticks=np.arange(1, count + 1))
            bar.set_label("transfer")
        above.set_aspect("equal", adjustable="datalim")
        above.set_ylabel("y in the board frame, mm")
        side.set_xlabel("x in the board frame, mm")
        side.set_ylabel("height over the plate, mm")
        side.set_ylim(min(-2.0, tip[:, 2].min() - 2), max(tip[:, 2].max(), PEG_HEIGHT_MM) + 5)
        length_m = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum() / 1e3
        above.set_title(f"{title}: {length_m:.2f} m in {times[-1] - times[0]:.1f} s")
        side.set_title("From the side")
    return path


def _coloured(flat: NDArray[np.float64], index: NDArray[np.float64], norm: Normalize | None) -> LineCollection:
    """Return the path as segments coloured by transfer; grey where there is none."""
    segments = np.stack([flat[:-1], flat[1:]], axis=1)
    if norm is None:
        return LineCollection(list(segments), colors=style.BLUE, linewidths=1.2)
    values = np.where(index[:-1] < 0, np.nan, index[:-1] + 1)
    cmap = mpl.colormaps[style.PATHS].with_extremes(bad="#BBBBBB")
    lines = LineCollection(list(segments), cmap=cmap, norm=norm, linewidths=1.2)
    lines.set_array(np.ma.masked_invalid(values))
    return lines


def _board_from_above(axes: Axes, pegs: NDArray[np.float64]) -> None:
    """Draw the outline of the board and its numbered pegs."""
    width, depth = BOARD_MM
    axes.add_patch(
        Rectangle((-width / 2, -depth / 2), width, depth, facecolor="#F7F5EF", edgecolor=style.QUIET, zorder=0)
    )
    for number, peg in enumerate(pegs):
        axes.add_patch(Circle(tuple(peg[:2]), PEG_RADIUS_MM, facecolor=style.INK, edgecolor="white", zorder=3))
        axes.annotate(
            str(number),
            tuple(peg[:2]),
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=8,
            color=style.INK,
            zorder=4,
        )
    axes.update_datalim([(-width / 2, -depth / 2), (width / 2, depth / 2)])
    axes.autoscale_view()


def _board_from_side(axes: Axes, pegs: NDArray[np.float64]) -> None:
    """Draw the plate and the pegs' silhouettes."""
    axes.axhline(0, color=style.QUIET, linewidth=1)
    for peg in pegs:
        axes.add_patch(
            Rectangle((peg[0] - PEG_RADIUS_MM, 0), 2 * PEG_RADIUS_MM, PEG_HEIGHT_MM, facecolor="#C9C9C9", zorder=1)
        )


PAPER: dict[str, tuple[PaperRow, ...]] = {
    "unilateral": (
        PaperRow("volunteers", 12.3, 610, 636),
        PaperRow("surgeon", 4.7, 120, 120),
        PaperRow("robot, uncalibrated", 5.6, 26, 75, ("uncalibrated",)),
        PaperRow("robot, calibrated", 5.7, 120, 120, ("calibrated", "adaptive")),
        PaperRow("robot, calibrated and optimised", 5.2, 120, 120, ("optimized", "best")),
    ),
    "bilateral": (
        PaperRow("volunteers", 10.9, 626, 642),
        PaperRow("surgeon", 4.8, 115, 118),
        PaperRow("robot, uncalibrated", 3.6, 37, 68, ("uncalibrated",)),
        PaperRow("robot, calibrated", 3.5, 120, 120, ("calibrated", "adaptive")),
        PaperRow("robot, calibrated and optimised", 3.0, 120, 120, ("optimized", "best")),
    ),
    "handover": (
        PaperRow("volunteers", 15.5, 599, 632),
        PaperRow("surgeon", 7.9, 120, 120),
        PaperRow("robot, uncalibrated", 6.3, 14, 79, ("uncalibrated",)),
        PaperRow("robot, calibrated", 6.1, 120, 120, ("calibrated", "adaptive")),
        PaperRow("robot, calibrated and optimised", 6.0, 120, 120, ("optimized", "best")),
    ),
}
"""Hwang et al. 2022, Tables II to IV, by variant. Attempted there: transfers whose block was on its source, see
``available``."""

MAX_FAILURES = 3
"""Failed transfers in the storyboard."""

FRAME_M = ((-0.072, 0.072), (-0.054, 0.046), (-0.010, 0.046))
"""The box that fills a picture, along x, y, z of the board: most of its plates, and blocks at carrying height."""


class PegReport(TaskReport):
    """What a report of the peg transfer adds."""

    view = Viewpoint((0.13, -0.46, 0.33))
    parts = ("capture", "perception", "planning", "motion", "jaw", "settling", "waiting")
    colours: Mapping[str, tuple[float, float, float]] = {"block": (0.86, 0.55, 0.13)}
    outcomes = TransferOutcome
    captions: Mapping[str, str] = {
        "paths": "Path of the tool's tip over the board, from above and from the side; colours distinguish transfers"
    }

    def frame(self, trial: Trial) -> NDArray[np.float64]:
        """Return the corners of the box above the board."""
        corners = np.stack(np.meshgrid(*FRAME_M), axis=-1).reshape(-1, 3)
        return SE3(trial.arrays["T_world_board"].astype(np.float64)).apply(corners)

    def goal(self, score: Mapping[str, Any]) -> str:
        """Return the source and the target."""
        return f"peg {score['source']} to {score['target']}"

    def failed_s(self, trial: Trial, score: Mapping[str, Any]) -> float:
        """Return when a dropped block fell fastest; for other failures, the end."""
        times = trial.times_s
        rows = np.flatnonzero((times >= score["start_s"]) & (times <= score["end_s"]))
        if score["failure"] != TransferOutcome.DROPPED.name or len(rows) < 2:
            return super().failed_s(trial, score)
        blocks = [array[rows, 2] for name, array in trial.arrays.items() if name.startswith("body_block")]
        return float(times[rows[np.diff(blocks, axis=1).min(axis=0).argmin()]])

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the first transfer step by step, quarters of the trial, failures."""
        found: list[tuple[str, float]] = [("start", 0.0)]
        if trial.scores:
            found += _first_handover(trial) if trial.about["variant"] == "handover" else _first_transfer(trial)
        for number, score in enumerate(trial.scores, start=1):
            if number % 3 == 0:
                found.append((f"after {number} transfers", score["end_s"]))
        failed = [s for s in trial.scores if not s["succeeded"]][:MAX_FAILURES]
        found += [
            (f"peg {s['source']} to {s['target']}: {in_words(s['failure'])}", self.failed_s(trial, s)) for s in failed
        ]
        return sorted(found, key=lambda item: item[1])

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw the paths of the working tips over the board in the first trial."""
        trial = trials[0]
        arms = trial.about["arms"]
        T_board_world = SE3(trial.arrays["T_world_board"].astype(np.float64)).inverse()
        pegs, drawn = PegSet().board.pegs_m, []
        for arm in arms:
            tips = T_board_world.apply(trial.replay().tools[arm].p_world_driven_m)
            title = f"Path of {arm}'s tip over the board, {trial.about['method']}"
            path = folder / ("paths.png" if len(arms) == 1 else f"paths_{arm}.png")
            drawn.append(draw_paths(trial.times_s, tips, _transfer_at(trial, arm), pegs, path, title=title))
        return drawn

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return the paper's denominator, transfers whose block stood on its source; and what motion alone takes."""
        done, available = _by_session(trials)
        return {
            "available": sum(available),
            "available_ci95": list(session_interval(done, available)),
            "motion_floor_s": motion_floor_s(trials),
        }

    def paper_rows(self, summary: Mapping[str, Any]) -> Sequence[PaperRow]:
        """Return the variant's table of the paper: II, III or IV."""
        return PAPER.get(str(summary["variant"]), ())

    def paper_count(self, summary: Mapping[str, Any]) -> PaperCount:
        """Return the run counted from the transfers whose block stood on its source."""
        low, high = summary["available_ci95"]
        how = "of blocks that stood on their source, as the paper counts"
        return PaperCount(how, summary["succeeded"], summary["available"], (low, high))

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return how close the time is to motion alone, and which colours are changed."""
        return [
            floor_sentence(motion_floor_s(trials)),
            "blocks are amber in the pictures only; the camera sees them red",
        ]


def _by_session(trials: Sequence[Trial]) -> tuple[list[int], list[int]]:
    """Return how many transfers succeeded, and of how many the block stood on its source, in each session."""
    done: Counter[int] = Counter()
    available: Counter[int] = Counter()
    for trial in trials:
        done[trial.about["session"]] += sum(bool(s["succeeded"]) for s in trial.scores)
        available[trial.about["session"]] += sum(bool(s["available"]) for s in trial.scores)
    sessions = sorted(done)
    return [done[s] for s in sessions], [available[s] for s in sessions]


def _first_transfer(trial: Trial) -> list[tuple[str, float]]:
    """Return the steps of the first transfer: its jaws close for the last time on the block, and open to release it."""
    score, (turn, *_) = trial.scores[0], [turn for turn in turns_of(trial) if turn.goal == 0]
    inside = [
        s for s in trial.spans if turn.arm in (None, s.arm) and turn.start_s <= s.start_s and s.end_s <= turn.end_s
    ]
    motions, jaws = ([s for s in inside if s.name == name] for name in ("motion", "jaw"))
    round_the_wall = f"jaws round the wall on peg {score['source']}"
    if len(jaws) < 2 or not score["succeeded"]:
        return [(round_the_wall, motions[0].end_s)] if motions else []
    carrying = [s for s in motions if jaws[-2].end_s <= s.start_s < jaws[-1].start_s]
    if not carrying:
        return [(round_the_wall, jaws[-2].start_s), (f"released on peg {score['target']}", score["end_s"])]
    carry = carrying[0]
    length = carry.end_s - carry.start_s
    stops_over_target = len(carrying) > 1
    return [
        (round_the_wall, jaws[-2].start_s),
        ("lifted", carry.start_s + 0.35 * length),
        ("over the target", carry.end_s if stops_over_target else carry.start_s + 0.65 * length),
        (f"released on peg {score['target']}", score["end_s"]),
    ]


def _first_handover(trial: Trial) -> list[tuple[str, float]]:
    """Return the steps of the first handover, if there was one."""
    steps = {"offer": "block offered", "taking": "both arms at the block", "correction": "taken over"}
    noted = [(words, next((e for e in trial.events if e["name"] == name), None)) for name, words in steps.items()]
    return [(words, float(event["time_s"])) for words, event in noted if event is not None]


def _transfer_at(trial: Trial, arm: str) -> np.ndarray:
    """Return the number of the transfer that an arm is working on at each time of a trial, -1 if none."""
    index = np.full(len(trial.times_s), -1)
    for turn in turns_of(trial):
        if turn.arm in (None, arm):
            index[(trial.times_s >= turn.start_s - NEARLY_S) & (trial.times_s < turn.end_s - NEARLY_S)] = turn.goal
    return index
