"""Pictures, rows of the paper and figures of the peg transfer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.eval import PaperCount, PaperRow, TaskReport, in_words
from trocar.eval.statistics import session_interval
from trocar.geometry import SE3
from trocar.replay import Viewpoint
from trocar.report.turns import NEARLY_S, turns_of
from trocar.tasks.peg_transfer.goals import PegSet, TransferOutcome
from trocar.tasks.peg_transfer.report.floor import floor_sentence, motion_floor_s
from trocar.tasks.peg_transfer.report.paths import draw_paths

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

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
