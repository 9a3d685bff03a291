"""A task on a served cell's table, and its referee: whatever a client does to the objects is scored and saved."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trocar.errors import BadFile, InvalidValue
from trocar.eval.config import SESSION, RunConfig
from trocar.eval.folder import open_folder
from trocar.eval.method import CLIENT, NoSettings, methods_of, pick_method
from trocar.eval.prepare import Prepared
from trocar.eval.staged import End, Files, StagedTrial
from trocar.eval.task import Task
from trocar.eval.trial import trial_file
from trocar.lab.session import draw_session


@dataclass(frozen=True, eq=False)
class ServedRun(RunConfig):
    """Configuration of trials that other programs play; sessions and scenes follow from the seed."""

    def about(self) -> dict[str, Any]:
        """Return what distinguishes this run from others; the program that plays it is unknown."""
        unknown = {"method": CLIENT, "planner": "", "perception": "", "set": []}
        return {**super().about(), **unknown, "model": None, "calibration": None, "prior": None}


class Referee:
    """One trial of a task in a served cell.

    Args:
        task: the task.
        station: name or file; empty: the task's own.
        seed: of the run.
        session: number of the session, as in ``trocar run`` with this seed.
        trial: number of the trial in it.
        out: folder of the run, which may contain trials of other numbers.

    Attributes:
        path: of the trial's file.
        staged: the trial before it is played.

    Raises:
        InvalidInput: the task cannot be done there, or the folder has this trial already, or is of another run.
    """

    def __init__(self, task: Task, station: str, seed: int, session: int, trial: int, out: str | Path):
        for name, value in (("--session", session), ("--trial", trial)):
            if value < 0:
                raise InvalidValue(name, value, "give 0 or more")
        kind = type(task)
        known = {name: pick_method(kind, name) for name in methods_of(kind)}
        plain = [name for name, one in known.items() if not (one.calibrated or one.learns)]
        method, sessions, trials = (plain or list(known))[0], session + 1, trial + 1
        config = ServedRun(task, method=method, station=station, seed=seed, sessions=sessions, trials=trials)
        self.path = trial_file(out, session, trial)
        if (session, trial) not in open_folder(config, out):
            raise BadFile(self.path, "is there already", "give another --trial or --session, or another --out")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        drawn = draw_session(config.laboratory, config.rng(session, SESSION))
        self.staged = StagedTrial(config, Prepared(session, drawn, {}), trial)
        self._began_s = time.perf_counter()

    def save(self, end: End, images: Files) -> Path:
        """Score and save the trial; return the path of its file."""
        wall_s = time.perf_counter() - self._began_s
        return self.staged.finished(end, wall_s, NoSettings(), images).save(self.path)
