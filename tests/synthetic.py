"""Made-up trials for tests of files, summaries, reports and commands, without a simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from trocar.eval import pick_method
from trocar.eval.config import RunConfig
from trocar.eval.scenery import Scenery
from trocar.eval.trial import Trial, trial_file
from trocar.geometry import SE3
from trocar.log import Computation, Span
from trocar.replay import Solid
from trocar.tasks.peg_transfer.task import PegTransfer

TRANSFER_S = 5.0
PARTS_S = {"capture": 0.2, "perception": 0.1, "planning": 0.2, "motion": 3.0, "jaw": 0.5, "settling": 0.25}
"""Time of each transfer by part; .75 s are not accounted for."""
STEPS = ("capture", "perception", "planning", "motion", "settling", "jaw", "motion", "jaw")
"""Steps of a transfer: look, move to the block, close the jaws, carry it, open the jaws."""
TICK_S = 0.01
RED, GREY = (0.8, 0.2, 0.1, 1.0), (0.6, 0.6, 0.6, 1.0)
GOALS = PegTransfer().goals()


def prepared(run: RunConfig, number: int, folder: Path, **_: object) -> Any:
    """Stand in for ``trocar.eval.prepare.prepare``: make a session's folder and leave it empty."""
    from trocar.eval.prepare import Prepared  # the simulator is heavy

    (folder / f"session_{number:02d}").mkdir(exist_ok=True)
    return Prepared(number, None, {})  # type: ignore[arg-type]


def config(**options: object) -> RunConfig:
    """Return a run of peg transfers with these fields of ``RunConfig``; calibration, if any, takes no images."""
    task = PegTransfer()
    quick = {"calibration": "joints"} if pick_method(PegTransfer, str(options.get("method", ""))).calibrated else {}
    return RunConfig(task, **{"difficulty": "mild", **quick, **options})  # type: ignore[arg-type]


def unmarked(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file that Trocar wrote, without ``made_by``."""
    values = json.loads(path.read_text())
    assert values.pop("made_by").startswith("made by Trocar: ")
    return values


def keep(trial: Trial, folder: Path) -> Path:
    """Save a trial where its run in this folder has it, and return the path."""
    path = trial_file(folder, trial.about["session"], trial.about["index"])
    path.parent.mkdir(parents=True, exist_ok=True)
    return trial.save(path)


def about_of(run: RunConfig, session: int, index: int) -> dict[str, Any]:
    """Return what a trial says of itself."""
    made_up = {"settings": {}, "transmissions": dict.fromkeys(run.laboratory.arms, "none")}
    return {**run.about(), "fingerprint": run.fingerprint, "session": session, "index": index, **made_up}


def scenery_of(run: RunConfig, fixed: Solid, loose: Solid) -> Scenery:
    """Return the arms of a run, a ball for each one's jaws, something that stands still and something that moves."""
    station = run.laboratory
    bases = {name: arm.T_world_base for name, arm in station.arms.items()}
    jaws = [Solid(f"{arm}_link6", "sphere", (0.003,), SE3.identity(), GREY) for arm in station.arms]
    return Scenery(
        solids=(fixed, loose, *jaws),
        T_world_body={"world": SE3.identity(), fixed.body: SE3.identity()},
        arms=station.models,
        T_world_base=bases,
        T_world_base_registered=bases,
        cameras={name: [] for name in station.cameras},
        tick_s=TICK_S,
    )


def synthetic_trial(
    run: RunConfig | None = None, index: int = 0, failures: dict[int, str] | None = None, session: int = 0
) -> Trial:
    """Return a trial of twelve transfers of 5 s; ``failures`` names the failure of each that failed."""
    run, failures = run or config(), failures or {}
    scores, spans, computations, events = [], [], [], []
    for number, (source, target) in enumerate(GOALS):
        start_s = number * TRANSFER_S
        failure = failures.get(number, "")
        scores.append(
            {
                "source": source,
                "target": target,
                "attempted": True,
                "available": failure != "NO_BLOCK",
                "succeeded": not failure,
                "failure": failure,
                "reason": f"made up: {failure}" if failure else "",
                "start_s": start_s,
                "end_s": start_s + TRANSFER_S,
            }
        )
        at_s = start_s
        for name in STEPS:
            length_s = PARTS_S[name] / STEPS.count(name)
            spans.append(Span("psm1", name, round(at_s, 6), round(at_s + length_s, 6)))
            at_s += length_s
        computations += [Computation("perception", 0.03, 0.098), Computation("planning", 0.2, 0.103)]
        events.append({"name": "transfer", "time_s": start_s + TRANSFER_S, "outcome": failure or "DONE"})
    hit = {"time_s": 3.0, "end_s": 3.1, "arm": "psm1", "what": "arm", "against": "peg 4", "force_n": 2.0}
    return Trial(
        about=about_of(run, session, index),
        scores=scores,
        spans=spans,
        events=events,
        collisions=[hit | {"p_world_m": [0.0, 0.0, 0.02]}] * (index + 1),
        ended="done",
        reason="",
        duration_s=len(GOALS) * TRANSFER_S,
        command_limit_use={"psm1": (0.5, 0.99), "psm2": (0.0, 0.0)},
        arrays=_arrays(run, np.random.default_rng([session, index])),
        scenery=scenery_of(
            run,
            Solid("board", "box", (0.05, 0.03, 0.005), SE3.from_parts(translation_m=[0.0, 0.0, -0.005]), RED),
            Solid("block0", "box", (0.007, 0.007, 0.007), SE3.identity(), RED),
        ),
        computations=computations,
        machine_speed=0.9,
        wall_s=10.0,
    )


def _arrays(run: RunConfig, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return joints that oscillate a little about the park position, and a block that moves along."""
    times_s = TICK_S * np.arange(round(len(GOALS) * TRANSFER_S / TICK_S) + 1)
    wave = 0.05 * np.sin(np.outer(times_s, rng.uniform(0.5, 2.0, 7)) + rng.uniform(0.0, 6.0, 7))
    arrays = {}
    for name, arm in run.laboratory.arms.items():
        q = np.append(arm.park_q(), arm.park_jaw_rad) + wave * [1, 1, 0.2, 1, 1, 1, 1]
        for kind in ("desired", "commanded", "measured", "true"):
            arrays[f"{kind}_{name}"] = (q + 0.01 * (kind == "true")).astype(np.float32)
    block = np.zeros((len(times_s), 7))
    block[:, :3], block[:, 3] = wave[:, :3], 1.0
    return arrays | {"body_block0": block.astype(np.float32), "T_world_board": np.eye(4)}
