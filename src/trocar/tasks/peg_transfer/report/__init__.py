"""Pictures, rows of the paper and figures of the peg transfer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from trocar.eval import PaperCount, PaperRow, TaskReport, in_words
from trocar.eval.statistics import by_session, session_interval
from trocar.eval.trials import noted
from trocar.eval.turns import NEARLY_S, turns_of
from trocar.geometry import SE3
from trocar.replay import Viewpoint
from trocar.report import style
from trocar.report.timechart import parts_of
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.shapes import Pegboard

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

MOTION = "motion"


def motion_floor_s(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the mean time per transfer by part, for the arm that moves most in each trial.

    The parts add up to that time. ``motion`` alone is its floor, since the arm can do nothing else meanwhile. Planning,
    perception and jaw actions that overlap with motion cost no time, and are not counted.
    """
    count = sum(len(trial.scores) for trial in trials)
    seconds: dict[str, float] = {MOTION: 0.0}
    for trial in trials:
        arms = [parts_of(trial.spans, arm, trial.duration_s) for arm in trial.about["arms"]]
        for name, part_s in max(arms, key=lambda parts: parts.get(MOTION, 0.0)).items():
            seconds[name] = seconds.get(name, 0.0) + part_s / max(count, 1)
    return seconds


def floor_sentence(seconds: dict[str, float]) -> str:
    """Return ``motion_floor_s`` as a sentence: the floor, then the parts that explain the gap, the largest first."""
    gap = sorted(((s, name) for name, s in seconds.items() if name != MOTION and s >= 0.005), reverse=True)
    parts = ", ".join(f"{name} {s:.2f}" for s, name in gap)
    total = sum(seconds.values())
    return (
        f"motion alone (of the arm that moves most) would take {seconds[MOTION]:.2f} s per transfer; the "
        f"{total - seconds[MOTION]:.2f} s above that are {parts}"
    )


def draw_paths(
    times_s: NDArray[np.float64], p_board_m: NDArray[np.float64], transfer: NDArray[np.intp], path: Path, title: str
) -> Path:
    """Draw the path of the tip from above and from the side, coloured by transfer, and return the file's path.

    Args:
        times_s: (n,) increasing.
        p_board_m: (n, 3) tip in the board frame, z up along the pegs.
        transfer: (n,) index of the transfer, below 0 where there is none.
        path: of the picture.
        title: above it.
    """
    tip, board = 1e3 * p_board_m, Pegboard()
    pegs, radius_mm, height_mm = 1e3 * board.pegs_m, 1e3 * board.peg_radius_m, 1e3 * board.peg_height_m
    with style.figure(8.2, 8.0, path) as figure:
        above, side = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
        width, depth = (1e3 * size_m for size_m in board.plates_m[-1][:2])
        outline = {"facecolor": "#F7F5EF", "edgecolor": style.QUIET, "zorder": 0}
        above.add_patch(Rectangle((-width / 2, -depth / 2), width, depth, **outline))
        side.axhline(0, color=style.QUIET, linewidth=1)
        for number, (x, y, _) in enumerate(pegs):
            above.add_patch(Circle((x, y), radius_mm, facecolor=style.INK, edgecolor="white", zorder=3))
            text = {"xytext": (5, 5), "textcoords": "offset points", "fontsize": 8, "color": style.INK, "zorder": 4}
            above.annotate(str(number), (x, y), **text)
            side.add_patch(Rectangle((x - radius_mm, 0), 2 * radius_mm, height_mm, facecolor="#C9C9C9", zorder=1))
        above.update_datalim([(-width / 2, -depth / 2), (width / 2, depth / 2)])
        above.autoscale_view()
        count = max(1, int(transfer.max()) + 1)
        norm = BoundaryNorm(np.arange(count + 1) + 0.5, 256)
        cmap = mpl.colormaps[style.PATHS].with_extremes(bad="#BBBBBB")
        numbers = np.ma.masked_where(transfer[:-1] < 0, transfer[:-1] + 1)
        for axes, columns in ((above, (0, 1)), (side, (0, 2))):
            flat = tip[:, columns]
            lines = LineCollection(
                list(np.stack([flat[:-1], flat[1:]], axis=1)), cmap=cmap, norm=norm, linewidths=1.2, array=numbers
            )
            axes.add_collection(lines)
        bar = figure.colorbar(lines, ax=[above, side], pad=0.01, aspect=40, ticks=np.arange(1, count + 1))
        bar.set_label("transfer")
        above.set_aspect("equal", adjustable="datalim")
        above.set_ylabel("y in the board frame, mm")
        side.set_xlabel("x in the board frame, mm")
        side.set_ylabel("height over the plate, mm")
        side.set_ylim(min(-2.0, tip[:, 2].min() - 2), max(tip[:, 2].max(), height_mm) + 5)
        length_m = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum() / 1e3
        above.set_title(f"{title}: {length_m:.2f} m in {times_s[-1] - times_s[0]:.1f} s")
        side.set_title("From the side")
    return path


WHO = {
    "volunteers": (),
    "surgeon": (),
    "robot, uncalibrated": ("uncalibrated",),
    "robot, calibrated": ("calibrated", "adaptive"),
    "robot, calibrated and optimised": ("optimized", "best"),
}
"""Conditions of the paper, and our methods that correspond to them."""
TABLES = {
    "unilateral": ((12.3, 610, 636), (4.7, 120, 120), (5.6, 26, 75), (5.7, 120, 120), (5.2, 120, 120)),
    "bilateral": ((10.9, 626, 642), (4.8, 115, 118), (3.6, 37, 68), (3.5, 120, 120), (3.0, 120, 120)),
    "handover": ((15.5, 599, 632), (7.9, 120, 120), (6.3, 14, 79), (6.1, 120, 120), (6.0, 120, 120)),
}
PAPER: dict[str, tuple[PaperRow, ...]] = {
    variant: tuple(PaperRow(who, *numbers, methods) for (who, methods), numbers in zip(WHO.items(), rows, strict=True))
    for variant, rows in TABLES.items()
}
"""Hwang et al. 2022, Tables II to IV, by variant: mean time, succeeded, attempted. Attempted there: transfers whose
block was on its source, see ``available``."""
MAX_FAILURES = 3
"""Failed transfers in the storyboard."""
FRAME_M = ((-0.072, 0.072), (-0.054, 0.046), (-0.010, 0.046))
"""The box that fills a picture, along x, y, z of the board: most of its plates, and blocks at carrying height."""


class PegReport(TaskReport):
    """What a report of the peg transfer adds."""

    view = Viewpoint((0.13, -0.46, 0.33))
    parts = ("capture", "perception", "planning", "motion", "jaw", "settling", "waiting")
    colours: Mapping[str, tuple[float, float, float]] = {
        "block": (0.86, 0.55, 0.13),
        "board capsule": (0.93, 0.90, 0.85),
    }
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
        """Return the moments of the first transfer step by step, every third transfer, and failures."""
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
        drawn = []
        for arm, tips in tips_over_board(trial).items():
            title = f"Path of {arm}'s tip over the board, {trial.about['method']}"
            path = folder / ("paths.png" if len(arms) == 1 else f"paths_{arm}.png")
            drawn.append(draw_paths(trial.times_s, tips, _transfer_at(trial, arm), path, title))
        return drawn

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return the paper's denominator, transfers whose block stood on its source; and what motion alone takes."""
        trials = noted(trials)
        done, available = (
            [sum(counts) for counts in by_session(trials, lambda t, key=key: sum(s[key] for s in t.scores)).values()]
            for key in ("succeeded", "available")
        )
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
        painted = "blocks are amber and pegs pale in the pictures only; the camera sees all of it red"
        return [floor_sentence(motion_floor_s(noted(trials))), painted]


def tips_over_board(trial: Trial) -> dict[str, NDArray[np.float64]]:
    """Return the path (n, 3) of each working arm's tip in the frame of the board, m."""
    T_board_world, tools = SE3(trial.arrays["T_world_board"].astype(np.float64)).inverse(), trial.replay().tools
    return {arm: T_board_world.apply(tools[arm].p_world_driven_m) for arm in trial.about["arms"]}


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
