"""A trial in numbers: what the study needs from it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from trocar.eval.study import Results, RowKind
from trocar.eval.trial import Trial
from trocar.motion.analysis import JointAnalysis, analyse_joints

KINDS = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class Row:
    """One trial.

    Attributes:
        fingerprint: of its run.
        session: number.
        index: of the trial in its session.
        attempted: transfers that the task set.
        available: those of them whose block stood on its source: the paper's denominator.
        succeeded: transfers.
        duration_s: of the whole trial.
        collisions: of arms and blocks with pegs, board and each other.
        failures: names with their number.
        path_m: length of the tips' paths, all working arms together.
        joints: RMS of velocity, acceleration, jerk of the turning joints, rad/s and so on.
        tip: RMS of the size of velocity, acceleration, jerk of the tip, m/s and so on.
        tip_max: the largest of these.
        wall_s: real time of the trial; 0 if it was lost.
    """

    fingerprint: str
    session: int
    index: int
    attempted: int
    available: int
    succeeded: int
    duration_s: float
    collisions: int
    failures: dict[str, int]
    path_m: float
    joints: dict[str, float]
    tip: dict[str, float]
    tip_max: dict[str, float]
    wall_s: float


def row_of(trial: Trial) -> Row:
    """Return a trial's row; motions are estimated from the measured joints of its working arms."""
    about, scores = trial.about, [score for score in trial.scores if score["attempted"]]
    found = [
        analyse_joints(
            trial.scenery.arms[arm], trial.arrays[f"measured_{arm}"][:, :6].astype(np.float64), trial.scenery.tick_s
        )
        for arm in about["arms"]
    ]
    turning = [~np.array([joint.prismatic for joint in trial.scenery.arms[arm].joints]) for arm in about["arms"]]
    return Row(
        fingerprint=about["fingerprint"],
        session=about["session"],
        index=about["index"],
        attempted=len(scores),
        available=sum(bool(score["available"]) for score in scores),
        succeeded=sum(bool(score["succeeded"]) for score in scores),
        duration_s=trial.duration_s,
        collisions=len(trial.collisions),
        failures=dict(Counter(str(score["failure"]) for score in scores if score["failure"])),
        path_m=sum(one.path_m for one in found),
        joints={
            kind: _rms([one.joints.rms()[kind][t] for one, t in zip(found, turning, strict=True)]) for kind in KINDS
        },
        tip={kind: _rms([_sizes(one, kind) for one in found]) for kind in KINDS},
        tip_max={kind: max(float(_sizes(one, kind).max()) for one in found) for kind in KINDS},
        wall_s=trial.wall_s,
    )


def _sizes(found: JointAnalysis, kind: str) -> np.ndarray:
    return np.linalg.norm(getattr(found.tip, kind), axis=1)


def _rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


KIND = RowKind(Row, row_of)


def successes(results: Results[Row]) -> tuple[list[int], list[int]]:
    """Return how many transfers succeeded and how many were set, by session."""
    done = results.by_session(lambda row: row.succeeded)
    tried = results.by_session(lambda row: row.attempted)
    return [int(sum(values)) for values in done.values()], [int(sum(values)) for values in tried.values()]


def transfer_time_s(row: Row) -> float:
    """Return the completion time over the number of transfers, as in the paper's tables."""
    return row.duration_s / row.attempted
