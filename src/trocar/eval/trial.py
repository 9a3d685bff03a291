"""One trial and its file: what was done, what the referee saw, and everything that a replay needs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import BadFile
from trocar.eval.scenery import Scenery
from trocar.files.archive import Archive, read_archive, read_header
from trocar.files.output import write_json
from trocar.files.reading import read_json
from trocar.log import Computation, Span
from trocar.notebook import table
from trocar.replay import Replay

FORMAT = "trocar trial"
VERSION = 3

Notes = list[dict[str, Any]]

NUMBER = (int, float)
ABOUT = {
    **dict.fromkeys(("task", "variant", "goal_noun", "station", "station_digest", "method", "planner"), str),
    **dict.fromkeys(("perception", "fingerprint"), str),
    **dict.fromkeys(("seed", "session", "index"), int),
    **dict.fromkeys(("model", "calibration", "prior"), (str, type(None))),
    **dict.fromkeys(("new_session", "refit_offsets", "flawless_camera"), bool),
    **dict.fromkeys(("arms", "set", "difficulty", "plugins"), list),
    **dict.fromkeys(("options", "flaws", "versions"), dict),
}
"""Keys that every trial records about itself, with their types."""
SCORE = {"attempted": bool, "succeeded": bool, "failure": str, "reason": str, "start_s": NUMBER, "end_s": NUMBER}
EVENT = {"name": str, "time_s": NUMBER}
COLLISION = {
    **dict.fromkeys(("time_s", "end_s", "force_n"), NUMBER),
    **{"arm": str, "what": str, "against": str, "p_world_m": list},
}


@dataclass(frozen=True, eq=False)
class Trial:
    """A finished trial.

    The file holds nothing that depends on the machine's speed, so the same seed writes the same bytes. The real times
    of computations lie beside it, in ``.timing.json``.

    Attributes:
        about: configuration of the run with its ``fingerprint``, session, index and settings. On real arms also
            ``robot``, and ``tally``: the number of goals that a person counted, None if nobody did.
        scores: one dict per goal (the task's ``Score``); on real arms what the script itself noted.
        spans: spans that the scripts noted.
        events: events that the scripts noted.
        collisions: dicts of ``trocar.sim.record.Collision``.
        ended: ``done``, or what stopped the script: ``OUT_OF_TIME``, ``FAULT``, ``AGENT_ERROR``.
        reason: why, in a sentence; empty when done.
        duration_s: duration on the trial's clock.
        command_limit_use: largest share of the velocity and acceleration limits in each arm's commands.
        arrays: (n, 7) ``desired_ARM``, ``commanded_ARM``, ``measured_ARM``, ``true_ARM`` (six joints and the jaw) and
            ``body_NAME`` (position m, quaternion wxyz in the world), all at 100 Hz from 0 s on; the task's own arrays;
            and series that scripts noted. Trials on real arms have no ``true_ARM``, bodies or collisions.
        scenery: solids, arms and where they stand.
        images: files of the cameras' images, by name.
        computations: real times of computations; not in the file.
        machine_speed: speed of the machine (``trocar.log.machine_speed``); not in the file.
        wall_s: real time of the whole trial; not in the file.
    """

    about: dict[str, Any]
    scores: Notes
    spans: list[Span]
    events: Notes
    collisions: Notes
    ended: str
    reason: str
    duration_s: float
    command_limit_use: dict[str, tuple[float, float]]
    arrays: dict[str, NDArray]
    scenery: Scenery
    images: Mapping[str, bytes] = field(default_factory=dict)
    computations: list[Computation] = field(default_factory=list)
    machine_speed: float = 1.0
    wall_s: float = 0.0

    def __repr__(self) -> str:
        about, done = self.about, sum(bool(score["succeeded"]) for score in self.scores)
        what = " ".join(str(about[key]) for key in ("task", "variant", "method") if about[key])
        where = f"session {about['session']}, trial {about['index']} of seed {about['seed']}"
        ended = "" if self.finished else f", ended by {self.ended}"
        return (
            f"<Trial {what}, {where}: {done} of {len(self.scores)} {self.goal_noun}s in {self.duration_s:.1f} s"
            f"{ended}, {len(self.collisions)} collisions>"
        )

    def _repr_html_(self) -> str:
        rows = []
        for number, score in enumerate(self.scores):
            result = "done" if score["succeeded"] else score["failure"] or "not attempted"
            times = (f"{score[key]:.1f}" for key in ("start_s", "end_s"))
            rows.append((f"{self.goal_noun} {number + 1}", result, *times, score["reason"]))
        return table(self, (self.goal_noun, "result", "from, s", "to, s", "reason"), rows)

    @property
    def finished(self) -> bool:
        """Return whether the script ended by itself within its budget."""
        return self.ended == "done"

    @property
    def on_robot(self) -> bool:
        """Return whether real arms did it, without a referee, so that the trial contains no truth."""
        return bool(self.about.get("robot"))

    @property
    def goal_noun(self) -> str:
        """Return what a goal is called, such as ``transfer``."""
        return str(self.about["goal_noun"])

    @property
    def session(self) -> int:
        """Return the number of its session."""
        return int(self.about["session"])

    @property
    def arms(self) -> tuple[str, ...]:
        """Return the names of its arms; the ones that worked come first."""
        working = list(self.about["arms"])
        return (*working, *(name for name in self.scenery.arms if name not in working))

    @property
    def times_s(self) -> NDArray[np.float64]:
        """Return the times (n,) of the rows of its arrays: 100 Hz from 0 s on."""
        rows = max((len(array) for name, array in self.arrays.items() if name.startswith("measured_")), default=0)
        return self.scenery.tick_s * np.arange(rows, dtype=np.float64)

    def noted(self) -> Trial:
        """Return the trial without arrays, images and scenery, for summaries of many trials."""
        return replace(self, arrays={}, images={}, scenery=replace(self.scenery, solids=(), T_world_body={}, arms={}))

    def replay(self) -> Replay:
        """Return the trial's replay."""
        return self.scenery.replay(self)

    def save(self, path: str | Path) -> Path:
        """Write the trial to ``path`` and its real times beside it; an interrupted write leaves nothing half-done."""
        path = Path(path)
        header = {
            "format": FORMAT,
            "version": VERSION,
            "about": self.about,
            "scores": self.scores,
            "spans": [asdict(span) for span in self.spans],
            "events": self.events,
            "collisions": self.collisions,
            "ended": self.ended,
            "reason": self.reason,
            "duration_s": self.duration_s,
            "command_limit_use": self.command_limit_use,
            "scenery": self.scenery.values(),
        }
        computations = [asdict(computation) for computation in self.computations]
        timing = {"wall_s": self.wall_s, "machine_speed": self.machine_speed, "computations": computations}
        write_json(timing_file(path), timing, "record of real times")
        return Archive(header, self.arrays, self.images).save(path)

    @staticmethod
    def load(path: str | Path) -> Trial:
        """Return the trial in a file that :meth:`save` wrote.

        Raises:
            BadFile: there is no such file, or it is not a trial of this version.
        """
        path = Path(path)
        trial = _trial_of(read_archive(path, FORMAT, VERSION), path)
        _check(trial, path)
        return trial

    @staticmethod
    def load_noted(path: str | Path) -> Trial:
        """Return the trial in a file as :meth:`noted` would, but read only the file's header.

        Raises:
            BadFile: there is no such file, or it is not a trial of this version.
        """
        path = Path(path)
        header = read_header(path, FORMAT, VERSION)
        scenery = header.get("scenery")
        if isinstance(scenery, dict):
            header["scenery"] = scenery | {"solids": [], "T_world_body": {}, "arms": {}}
        return _trial_of(Archive(header), path)


def _trial_of(archive: Archive, path: Path) -> Trial:
    """Return the trial in an archive, with the real times beside it (BadFile: it is not a trial)."""
    try:
        log = archive.header
        return Trial(
            about=_note(log["about"], ABOUT),
            scores=_notes(log["scores"], SCORE),
            spans=[Span(**span) for span in log["spans"]],
            events=_notes(log["events"], EVENT),
            collisions=_notes(log["collisions"], COLLISION),
            ended=str(log["ended"]),
            reason=str(log["reason"]),
            duration_s=float(log["duration_s"]),
            command_limit_use={arm: (float(v), float(a)) for arm, (v, a) in log["command_limit_use"].items()},
            arrays=dict(archive.arrays),
            scenery=Scenery.of(log["scenery"]),
            images=archive.blobs,
            **_timing(timing_file(path)),
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        raise BadFile(path, f"is not a readable {FORMAT}", "run that trial again") from None


def trial_about(path: str | Path) -> dict[str, Any]:
    """Return what a trial's file records about itself, without reading its arrays."""
    try:
        return _note(read_header(path, FORMAT, VERSION).get("about"), ABOUT)
    except TypeError:
        raise BadFile(path, f"is not a readable {FORMAT}", "run that trial again") from None


def timing_file(path: str | Path) -> Path:
    """Return the path of the file with a trial's real times."""
    return Path(path).with_suffix(".timing.json")


def trial_file(folder: str | Path, session: int, index: int) -> Path:
    """Return the path of a trial in a session of a run."""
    return session_folder(folder, session) / f"trial_{index:03d}.npz"


def session_folder(folder: str | Path, session: int) -> Path:
    """Return the folder of one session of a run."""
    return Path(folder) / f"session_{session:02d}"


def trial_place(path: str | Path) -> tuple[int, ...]:
    """Return session and number of a trial's file."""
    return tuple(int(number) for number in re.findall(r"\d+", "/".join(Path(path).parts[-2:])))


def trial_files(folder: str | Path) -> list[Path]:
    """Return the trials in a run's folder in numerical order (in alphabetical order, 100 would come before 11)."""
    return sorted(Path(folder).glob("session_[0-9]*/trial_[0-9]*.npz"), key=trial_place)


def _timing(path: Path) -> dict[str, Any]:
    """Return the real times beside a trial; none if they are lost, since the trial does not need them."""
    try:
        timing = read_json(path)
        computations = [Computation(**c) for c in timing["computations"]]
        numbers = {key: float(timing[key]) for key in ("wall_s", "machine_speed")}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {"computations": computations, **numbers}


def _note(value: Any, kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Return a value of a header if it is a dict with these keys and types; raise TypeError otherwise."""
    if not isinstance(value, dict) or not all(isinstance(value.get(key, ...), kind) for key, kind in kinds.items()):
        raise TypeError
    return value


def _notes(values: Any, kinds: Mapping[str, Any]) -> Notes:
    """Return a list of such dicts."""
    if not isinstance(values, list):
        raise TypeError
    return [_note(value, kinds) for value in values]


def _check(trial: Trial, path: Path) -> None:
    """Raise BadFile if the arrays of a trial cannot be what their names say."""
    known = "measured" if trial.on_robot else "true"
    for arm in trial.scenery.arms:
        if f"{known}_{arm}" not in trial.arrays:
            raise BadFile(path, f"is damaged: it lacks '{known}_{arm}'")
    rows = len(trial.times_s)
    for name, array in trial.arrays.items():
        sampled = name.startswith(("desired_", "commanded_", "measured_", "true_", "body_"))
        if sampled and array.shape != (rows, 7):
            raise BadFile(path, f"is damaged: {name!r} has shape {array.shape}, not ({rows}, 7)")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise BadFile(path, f"is damaged: {name!r} is not finite")
