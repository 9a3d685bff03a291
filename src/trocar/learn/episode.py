"""A trial as an episode of a data set: observations and actions at 30 frames per second."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from trocar.errors import InvalidInput
from trocar.eval.study import RowKind
from trocar.eval.trial import Trial
from trocar.eval.turns import turn_at, turns_of
from trocar.geometry import SE3
from trocar.learn import control
from trocar.learn.observed import NOTED, PREFIX
from trocar.learn.poses import action_names, state_names, vectors

FPS = 30
IMAGES, OBJECTS = "observation.images.", "observation.environment_state"
STATE, ACTION, STEP, PHASE, REWARD, DONE = (
    *("observation.state", "action"),
    *("subtask_index", "phase_index", "next.reward", "next.done"),
)
TRUTH = "truth."
"""Prefix of columns that only the referee knows. LeRobot's policies read only ``observation...`` and ``action...``."""
NO_PHASE = "other"
_OF_SCORE = ("attempted", "available", "succeeded", "failure", "reason", "start_s", "end_s")


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode.

    Attributes:
        columns: (n, k) values of each feature in n frames.
        names: names of the k numbers of each feature.
        task: what is to be done, in words.
        steps: what is being done, in words; ``subtask_index`` refers to them.
        phases: names of phases; ``phase_index`` refers to them.
        images: by camera: the time from which each image is the latest, and the image's file.
        about: metadata as JSON values: origin, success, failures, goals, spans.
    """

    columns: Mapping[str, NDArray[Any]]
    names: Mapping[str, list[str]]
    task: str
    steps: list[str]
    phases: list[str]
    images: Mapping[str, Sequence[tuple[float, bytes]]]
    about: Mapping[str, Any]

    @property
    def frames(self) -> int:
        """Return the number of frames."""
        return len(self.columns[STATE])


def too_short(trial: Trial) -> bool:
    """Return whether a trial ended before its second frame, for example because its policy failed at once."""
    return bool(trial.times_s[-1] < 1 / FPS)


def episode_of(trial: Trial, *, commanded: bool = False, truth: bool = False) -> Episode:
    """Return a trial as an episode.

    Frame k is at k / 30 s; joints are interpolated linearly between ticks of 10 ms. Its state is the encoders' reading
    or, if the trial noted observations, what a policy would observe: the joints as the cable model estimates them. Its
    action is what the script asked for at the next frame, before the cables were compensated.

    Args:
        trial: a finished trial.
        commanded: for a policy on raw cables: actions are what was sent to the controller, corrected for the cables,
            and states are always the encoders' readings.
        truth: whether columns that only the referee knows are added.

    Raises:
        InvalidInput: fewer than two frames, ``commanded`` with command noise, or ``truth`` of real arms.
    """
    arms = [str(arm) for arm in trial.about["arms"]]
    times_s = np.arange(0, trial.times_s[-1] * FPS + 1e-6) / FPS
    which = f"session {trial.about['session']}, trial {trial.about['index']}"
    if too_short(trial):
        raise InvalidInput(which, "is shorter than two frames", "leave it out")
    if commanded and trial.about.get("command_noise"):
        remedy = "drop --commanded, or make demonstrations without noise"
        raise InvalidInput(f"--commanded of {which}", "would teach the pushes of --command-noise", remedy)
    if truth and trial.on_robot:
        raise InvalidInput(which, "is of real arms, whose truth nobody knows", "drop --truth")
    following, scenery = np.append(times_s[1:], trial.times_s[-1]), trial.scenery

    def joints(kind: str, arm: str, at_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return interp1d(trial.times_s, trial.arrays[f"{kind}_{arm}"].astype(np.float64), axis=0)(at_s)

    def of_arms(kind: str, at_s: NDArray[np.float64], bases: Mapping[str, SE3]) -> NDArray[np.float32]:
        return np.hstack([vectors(scenery.arms[a], bases[a], joints(kind, a, at_s)) for a in arms]).astype(np.float32)

    names: dict[str, list[str]] = {STATE: state_names(arms), ACTION: action_names(arms)}
    observed = _observed(trial, len(times_s))
    measured = of_arms("measured", times_s, scenery.T_world_base_registered)
    columns: dict[str, NDArray[Any]] = {
        STATE: measured if commanded else observed.get(control.STATE, measured),
        ACTION: of_arms("commanded" if commanded else "desired", following, scenery.T_world_base_registered),
    }
    if control.OBJECTS in observed:
        columns[OBJECTS] = observed[control.OBJECTS]
        names[OBJECTS] = next(list(event["objects"]) for event in trial.events if event["name"] == NOTED)
    steps, of_step = _numbered(_steps(trial, arms, times_s))
    phases, of_phase = _numbered(name for frame in _phases(trial, arms, times_s) for name in frame)
    columns[STEP], columns[PHASE] = of_step[:, None], of_phase.reshape(-1, len(arms))
    columns[REWARD] = _rewards(trial, len(times_s))[:, None]
    columns[DONE] = (np.arange(len(times_s)) == len(times_s) - 1)[:, None]
    names |= {STEP: ["step"], PHASE: arms, REWARD: ["goals_reached"], DONE: ["done"]}
    if truth:
        poses = of_arms("true", times_s, scenery.T_world_base)
        found = {"poses": poses, "joints": np.hstack([joints("true", arm, times_s) for arm in arms])}
        names[f"{TRUTH}poses"] = [name.replace("_pose", "_true").replace("_jaw", "_jaw_true") for name in names[STATE]]
        of_arm = {arm: (*(joint.name for joint in scenery.arms[arm].joints), "jaw") for arm in arms}
        names[f"{TRUTH}joints"] = [f"{arm}_{joint}" for arm in arms for joint in of_arm[arm]]
        bodies = {key: rows for key, rows in trial.arrays.items() if key.startswith("body_")}
        if bodies:
            ticks = np.rint(times_s / scenery.tick_s).astype(int)
            found["bodies"] = np.hstack([rows[ticks][:, [0, 1, 2, 4, 5, 6, 3]] for rows in bodies.values()])  # xyzw
            parts = [name.removeprefix("_pose") for name in state_names([""])[:-1]]
            names[f"{TRUTH}bodies"] = [key.removeprefix("body_") + part for key in bodies for part in parts]
        columns |= {f"{TRUTH}{key}": values.astype(np.float32) for key, values in found.items()}
    images = {
        name: [(float(at_s), trial.images[blob]) for at_s, blob in taken if blob in trial.images]
        for name, taken in scenery.cameras.items()
    }
    task = " ".join(str(trial.about[key]).replace("-", " ") for key in ("task", "variant") if trial.about[key])
    images = {name: taken for name, taken in images.items() if taken}
    return Episode(columns, names, task, steps, phases, images, {"commanded": commanded, **_about(trial)})


def _observed(trial: Trial, frames: int) -> dict[str, NDArray[np.float32]]:
    """Return the noted observations (frames, k) of a policy; the last one is repeated until the end."""
    noted = {
        name: trial.arrays[PREFIX + name] for name in (control.STATE, control.OBJECTS) if PREFIX + name in trial.arrays
    }
    return {name: rows[np.minimum(np.arange(frames), len(rows) - 1)] for name, rows in noted.items()}


def _about(trial: Trial) -> dict[str, Any]:
    """Return the metadata of an episode."""
    counts = [score for score in trial.scores if score["attempted"]]
    reached = sum(bool(score["succeeded"]) for score in counts)
    return {
        **{key: trial.about[key] for key in ("fingerprint", "seed", "session", "method", "station", "difficulty")},
        "trial": trial.about["index"],
        "success": succeeded(trial),
        "goals_attempted": len(counts),
        "goals_reached": reached,
        "failures": sorted({score["failure"] for score in counts if score["failure"]}),
        "ended": trial.ended,
        "collisions": None if trial.on_robot else len(trial.collisions),
        "goals": [{key: score[key] for key in ("succeeded", "failure", "start_s", "end_s")} for score in counts],
        "spans": [list(asdict(span).values()) for span in trial.spans],
    }


def succeeded(trial: Trial) -> bool:
    """Return whether a trial finished and reached all goals that it attempted."""
    counts = [bool(score["succeeded"]) for score in trial.scores if score["attempted"]]
    return trial.finished and bool(counts) and all(counts)


@dataclass(frozen=True)
class Demonstration:
    """What a study of demonstrations keeps of a trial."""

    fingerprint: str  # of its run
    session: int
    success: bool
    duration_s: float


def _demonstration(trial: Trial) -> Demonstration:
    return Demonstration(trial.about["fingerprint"], trial.about["session"], succeeded(trial), trial.duration_s)


DEMONSTRATION = RowKind(Demonstration, _demonstration)
"""How a study of demonstrations reduces a trial."""


def _numbered(words: Iterable[str]) -> tuple[list[str], NDArray[np.int64]]:
    """Return the distinct words in order of appearance, and each given word's number among them."""
    numbers: dict[str, int] = {}
    found = np.array([numbers.setdefault(word, len(numbers)) for word in words], dtype=np.int64)
    return list(numbers), found


def _steps(trial: Trial, arms: Sequence[str], times_s: NDArray[np.float64]) -> list[str]:
    """Return in words what is being done at each time: the goals that arms are working on."""
    turns, many = turns_of(trial), len(trial.scores)

    def goal(number: int) -> str:
        told = {key: v for key, v in trial.scores[number].items() if key not in _OF_SCORE and _short(v)}
        more = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in told.items())
        return f"{trial.goal_noun} {number + 1} of {many}" + (f" ({more})" if more else "")

    found = []
    for time_s in times_s:
        said: dict[str, list[str]] = {}
        for arm in arms:
            turn = turn_at(turns, arm, float(time_s))
            if turn is not None and turn.goal < many:
                said.setdefault(goal(turn.goal), []).append(arm)
        found.append("; ".join(f"{' and '.join(who)}: {what}" for what, who in said.items()) or "between goals")
    return found


def _short(value: Any) -> bool:
    """Return whether a score's field says which goal it is, rather than how well it was done."""
    return isinstance(value, int | str) and not isinstance(value, bool) and value != ""


def _phases(trial: Trial, arms: Sequence[str], times_s: NDArray[np.float64]) -> NDArray[Any]:
    """Return the name (n, arms) of each arm's span; where spans overlap, of the one that began first."""
    found = np.full((len(times_s), len(arms)), NO_PHASE, dtype=object)
    for span in sorted(trial.spans, key=lambda span: -span.start_s):
        if span.arm in arms:
            found[(times_s >= span.start_s) & (times_s < span.end_s), arms.index(span.arm)] = span.name
    return found


def _rewards(trial: Trial, frames: int) -> NDArray[np.float32]:
    """Return the number of goals that were reached in each frame."""
    reached = [min(int(score["end_s"] * FPS), frames - 1) for score in trial.scores if score["succeeded"]]
    return np.bincount(np.array(reached, dtype=int), minlength=frames).astype(np.float32)
