"""Made-up debridement trials: fragments with known outcomes, each of which takes 10 s of an arm's time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from synthetic import GREY, RED, TICK_S, about_of, keep, scenery_of
from trocar.eval.config import RunConfig
from trocar.eval.jobs import opened
from trocar.eval.study import Condition, conditions_of
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.log import Span
from trocar.replay import Solid
from trocar.tasks.debridement.report.table_one import MODES
from trocar.tasks.debridement.task import Debridement

PARTS_S = {"capture": 0.2, "perception": 1.0, "planning": 2.0, "motion": 5.0, "jaw": 0.5, "settling": 0.3}
"""Time of each fragment by part; one more second, waiting or unaccounted for, makes 10 s of one arm."""
FRAGMENT_S = 10.0


def score(number: int, start_s: float, *, failure: str = "", attempts: int = 1, **modes: int) -> dict:
    """Return the score of a fragment, which was cleared unless ``failure`` names a failure."""
    return {
        "attempted": True,
        "succeeded": not failure,
        "failure": failure,
        "reason": "made up" if failure else "",
        "start_s": start_s,
        "end_s": start_s + FRAGMENT_S,
        "fragment": number,
        "attempts": attempts,
        "first_attempt": not failure and attempts == 1,
        "recoveries": attempts - 1 if not failure else 0,
        **dict.fromkeys(MODES, 0),
        **modes,
    }


def made_up(config: RunConfig | None = None, session: int = 0, scores: list[dict] | None = None) -> Trial:
    """Return a trial in which the arms take the fragments in turn, 10 s each."""
    config = config or RunConfig(Debridement(), seed=2)
    assert isinstance(config.task, Debridement)
    arms, count = config.arms, config.task.fragments
    scores = scores if scores is not None else [score(k, FRAGMENT_S * (k // len(arms))) for k in range(count)]
    spans, events = [], []
    for number in range(count):
        arm, at_s = arms[number % len(arms)], FRAGMENT_S * (number // len(arms))
        events.append({"name": "allocated", "time_s": at_s + 1.0, "arm": arm, "place": [0.0, 0.0, -0.15]})
        for name, length_s in PARTS_S.items():
            spans.append(Span(arm, name, round(at_s, 6), round(at_s + length_s, 6)))
            at_s += length_s
        if number % 2 == 0:
            spans.append(Span(arm, "waiting", round(at_s, 6), round(at_s + 1.0, 6)))
        for name, late_s in {"closing": 5.0, "pickup": 6.0, "releasing": 9.0, "fragment": 10.0}.items():
            more = {"outcome": "DONE", "reason": ""} if name == "fragment" else {}
            start_s = FRAGMENT_S * (number // len(arms))
            events.append({"name": name, "time_s": start_s + late_s, "arm": arm, **more})
    duration_s = FRAGMENT_S * -(-count // len(arms))
    rows = round(duration_s / TICK_S) + 1
    arrays: dict[str, np.ndarray] = {"T_world_receptacle": np.eye(4)}
    for name, arm_fixed in config.laboratory.arms.items():
        q = np.append(arm_fixed.park_q(), arm_fixed.park_jaw_rad)
        for kind in ("desired", "commanded", "measured", "true"):
            arrays[f"{kind}_{name}"] = np.tile(q, (rows, 1)).astype(np.float32)
    arrays["body_fragment0"] = np.tile([-0.07, -0.06, -0.158, 1.0, 0.0, 0.0, 0.0], (rows, 1)).astype(np.float32)
    return Trial(
        about=about_of(config, session, 0),
        scores=scores,
        spans=spans,
        events=sorted(events, key=lambda event: event["time_s"]),
        collisions=[],
        ended="done",
        reason="",
        duration_s=duration_s,
        command_limit_use=dict.fromkeys(config.laboratory.arms, (0.5, 0.9)),
        arrays=arrays,
        scenery=scenery_of(
            config,
            Solid(
                "receptacle", "box", (0.055, 0.035, 0.006), SE3.from_parts(translation_m=[-0.0745, 0.012, -0.156]), GREY
            ),
            Solid("fragment0", "box", (0.006, 0.004, 0.004), SE3.identity(), RED),
        ),
        wall_s=20.0,
    )


def saved(folder: Path, sessions: int = 3, **more: object) -> list[Condition]:
    """Save the trials of a study and return its conditions; with two arms, each trial has one multiple grasp."""
    cells = conditions_of(Debridement, folder, methods="paper", sessions=sessions, seed=2, **more)  # type: ignore[arg-type]
    opened(cells)
    for cell in cells:
        for session, _ in cell.places:
            trial = made_up(cell.config, session)
            if cell.name == "two-arms":
                scores = [score(0, 0.0, attempts=2, multiple_grasps=1), *trial.scores[1:]]
                trial = replace(trial, scores=scores)
            keep(trial, cell.folder)
    return cells
