"""Pictures, rows of the paper and figures of the peg transfer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.geometry import SE3
from trocar.replay import Viewpoint
from trocar.report.turns import NEARLY_S, turns_of
from trocar.tasks.kit import PaperRow, TaskReport
from trocar.tasks.peg_transfer.goals import PegSet
from trocar.tasks.peg_transfer.report.floor import floor_sentence, motion_floor_s
from trocar.tasks.peg_transfer.report.paths import draw_paths

if TYPE_CHECKING:
    from trocar.trials.trial import Trial

PAPER: dict[str, tuple[PaperRow, ...]] = {
    "unilateral": (
        PaperRow("volunteers", 12.3, 610, 636),
        PaperRow("surgeon", 4.7, 120, 120),
        PaperRow("robot, uncalibrated", 5.6, 26, 75),
        PaperRow("robot, calibrated", 5.7, 120, 120),
        PaperRow("robot, calibrated and optimised", 5.2, 120, 120),
    ),
    "bilateral": (
        PaperRow("volunteers", 10.9, 626, 642),
        PaperRow("surgeon", 4.8, 115, 118),
        PaperRow("robot, uncalibrated", 3.6, 37, 68),
        PaperRow("robot, calibrated", 3.5, 120, 120),
        PaperRow("robot, calibrated and optimised", 3.0, 120, 120),
    ),
    "handover": (
        PaperRow("volunteers", 15.5, 599, 632),
        PaperRow("surgeon", 7.9, 120, 120),
        PaperRow("robot, uncalibrated", 6.3, 14, 79),
        PaperRow("robot, calibrated", 6.1, 120, 120),
        PaperRow("robot, calibrated and optimised", 6.0, 120, 120),
    ),
}
"""Hwang et al. 2022, Tables II to IV, by variant. Attempted there: transfers whose block was on its source, see
``available``."""

MAX_FAILURES = 3
"""Failed transfers that get a picture."""


class PegReport(TaskReport):
    """What a report of the peg transfer shows besides the usual."""

    view = Viewpoint((0.13, -0.46, 0.33), (0.004, 0.0, 0.030))
    parts = ("capture", "perception", "planning", "motion", "jaw", "settling", "waiting")
    colours: Mapping[str, tuple[float, float, float]] = {"block": (0.86, 0.55, 0.13)}

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the first transfer step by step, quarters of the trial, failures."""
        found: list[tuple[str, float]] = [("start", 0.0)]
        if trial.scores:
            found += _first_handover(trial) if trial.about["variant"] == "handover" else _first_transfer(trial)
        for number, score in enumerate(trial.scores, start=1):
            if number % 3 == 0:
                found.append((f"after {number} transfers", score["end_s"]))
        failed = [s for s in trial.scores if not s["succeeded"]][:MAX_FAILURES]
        found += [(f"peg {s['source']} to {s['target']}: {_words(s['failure'])}", s["end_s"]) for s in failed]
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
        available = sum(bool(s["available"]) for trial in trials for s in trial.scores)
        return {"available": available, "motion_floor_s": motion_floor_s(trials)}

    def paper_rows(self, summary: Mapping[str, Any]) -> Sequence[PaperRow]:
        """Return the variant's table of the paper: II, III or IV."""
        return PAPER.get(str(summary["variant"]), ())

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what the paper counts, and how near to motion alone the time is."""
        summary = self.summary(trials)
        available = summary["available"]
        done = sum(bool(s["succeeded"]) for trial in trials for s in trial.scores)
        return [
            f"counted as in the paper, from the transfers whose block stood on its source: {done} of {available}",
            floor_sentence(summary["motion_floor_s"]),
            "blocks are amber in the pictures only; the camera sees them red",
        ]


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
    """Return the steps of the first handover, where there was one."""
    steps = {"offer": "block offered", "taking": "both arms at the block", "correction": "taken over"}
    noted = [(words, next((e for e in trial.events if e["name"] == name), None)) for name, words in steps.items()]
    return [(words, float(event["time_s"])) for words, event in noted if event is not None]


def _transfer_at(trial: Trial, arm: str) -> np.ndarray:
    """Return the number of the transfer that an arm is busy with at each time of a trial, -1 where with none."""
    index = np.full(len(trial.times_s), -1)
    for turn in turns_of(trial):
        if turn.arm in (None, arm):
            index[(trial.times_s >= turn.start_s - NEARLY_S) & (trial.times_s < turn.end_s - NEARLY_S)] = turn.goal
    return index


def _words(name: str) -> str:
    return name.lower().replace("_", " ")
