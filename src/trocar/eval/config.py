"""The configuration of a run."""

from __future__ import annotations

import hashlib
import json
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from trocar.calibration.excitation import WIDE_ROWS
from trocar.errors import BadFile, InvalidInput, InvalidValue, UnknownName
from trocar.eval.method import Method, methods_of, pick_method, pick_perception
from trocar.eval.task import TASKS, Task, flag_of, option
from trocar.files.output import jsonable
from trocar.lab import Station, load_station
from trocar.lab.flaws import DEFAULT, Difficulty
from trocar.lab.station_file import station_digest
from trocar.motion import PLANNERS
from trocar.registry import load_plugin

PACKAGES = ("trocar", "numpy", "scipy", "mujoco", "trio", "opencv-python-headless", "piqp")
"""Packages on which a trial's numbers depend."""

NO_PRIOR, BUILT_IN_PRIOR = "none", "fleet"
USUAL_MODEL = "play"
IMAGES, JOINTS = "images", "joints"
"""Sources of a calibration recording: spheres seen by the station's camera, or joints with drawn noise."""
FITTED_ON = "cable models are fitted on"
"""Key, in a summary, of the source of cable models."""

OF_SIMULATION = ("station", "model", "calibration", "sessions", "new_session", "refit_offsets", "flawless_camera")
OF_SIMULATION += ("difficulty", "flaws", "command_noise")
"""Options of simulated sessions, which do not apply to a robot."""

FOLLOWS = ("options", "variant", "goal_noun", "station_digest", "arms", "flaws", "versions", "robot", "observations")
"""Properties of a run that follow from its other options."""

MAX_NOISE_MM = 20.0
"""Largest push of motions; larger ones would leave the free space above the table."""

MAX_TRIALS = 100_000
"""Maximum number of trials of a run: weeks of work on all cores of a large machine."""

SESSION, CALIBRATION, REMOUNT, REFIT, TRIALS = range(5)
"""Random streams of one session under a run's seed; a change in one does not affect the others."""


@dataclass(frozen=True, eq=False)
class RunConfig:
    """The configuration of a run of a task; the same configuration writes the same trials.

    Its fields are the options of ``trocar run``, with their help. An empty value means the default of the task or of
    the method, which is then filled in.

    Attributes:
        chosen_method: the method.
        laboratory: the station as the task needs it.
        arms: names of the arms that work.
    """

    task: Task
    method: str = option("", "Which method does the task.", shown="the first")
    model: str = option(
        "", "Cable model of methods that compensate: play, lstm (the paper's), ridge, offset.", shown="play"
    )
    calibration: str = option(
        "",
        "What cable models are fitted on: images (of spheres on the arm) or joints (with drawn noise; fast).",
        shown="images if the station's cameras allow it",
    )
    prior: str = option(
        NO_PRIOR, "Fit on a minute of wide swings and what other instruments have in common.", metavar="fleet|none|FILE"
    )
    planner: str = option("", "How motions are planned.", shown="the method's")
    perception: str = option("", "What turns images into poses.", shown="the method's")
    settings: tuple[str, ...] = option(
        (),
        "Give a setting of the method another value; `trocar methods TASK` lists them; may be repeated.",
        flag="set",
        metavar="NAME=VALUE",
    )
    station: str = option("", "Name of a station, or a TOML file.", metavar="STATION", shown="the task's")
    sessions: int = option(1, "How many days are drawn, each registered and calibrated.")
    trials: int = option(1, "How many trials in each session.")
    seed: int = option(0, "Seed of everything random; the same seed gives the same trials.")
    new_session: bool = option(False, "Remount the instruments between calibration and trials.")
    refit_offsets: bool = option(False, "Refit the model's offsets from 30 samples before the trials.")
    flawless_camera: bool = option(False, "Switch off the sensors' flaws; the run states this.")
    difficulty: str = option(
        DEFAULT, "How far the laboratory departs from what is known about it: mild, recorded, harsh."
    )
    flaws: tuple[str, ...] = option(
        (), "Give a flaw another size, as registration=1.0mm; may be repeated.", flag="flaw", metavar="NAME=SIZE"
    )
    command_noise: float = option(
        0.0,
        "Push each motion off its path by about this much half-way (DART); what was asked for is recorded without it.",
        metavar="MM",
    )
    robot: str = option(
        "",
        "Drive real arms instead; nothing moves without --enable-motion.",
        metavar="KIND:STATION.toml",
        shown="none: the simulated cell",
    )
    cables: tuple[str, ...] = option(
        (), "Cable model of a real arm, for methods that compensate; may be repeated.", metavar="ARM=FILE.npz"
    )
    plugins: tuple[str, ...] = ()
    observations: bool = False  # note beside it what a policy would observe: joints as estimated, objects as seen
    chosen_method: Method = field(init=False, repr=False)
    laboratory: Station = field(init=False, repr=False)
    arms: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        kind = type(self.task)
        method = pick_method(kind, self.method)
        self._set(chosen_method=method)
        if self.robot:
            from trocar.hardware.kinds import robot_of  # trio only when needed

            self._refuse_simulated()
            self._set(station=robot_of(self.robot)[1])
        elif self.cables:
            remedy = "a simulated session fits its own; or name arms with --robot"
            raise InvalidInput(f"--cables {self.cables[0]}", "is of a real arm, and --robot names none", remedy)
        usual = {
            "station": self.task.usual_station,
            "method": next(iter(kind.methods)),
            "planner": method.planner,
            "perception": method.perception,
        }
        self._set(**{name: value for name, value in usual.items() if not getattr(self, name)})
        for name in ("sessions", "trials"):
            if getattr(self, name) < 1:
                raise InvalidValue(f"the number of {name}", getattr(self, name), f"give 1 or more with --{name}")
        if self.sessions * self.trials > MAX_TRIALS:
            many, remedy = f"{self.sessions} sessions of {self.trials} trials", "give fewer with --sessions or --trials"
            raise InvalidInput(many, f"are more than {MAX_TRIALS} trials", remedy)
        if not 0 <= self.command_noise <= MAX_NOISE_MM:
            raise InvalidValue("--command-noise", self.command_noise, f"give 0 to {MAX_NOISE_MM:g} mm")
        if self.seed < 0:
            raise InvalidValue("the seed", self.seed, "give 0 or more with --seed")
        if self.settings:
            method.make_settings(self.settings)
        if not self.robot:
            self._choose_model(method)
        PLANNERS.pick(self.planner)
        if self.perception:
            pick_perception(kind, self.perception)
        difficulty = Difficulty.of(self.difficulty, self.flaws)
        station = replace(load_station(self.station), difficulty=difficulty)
        self._set(task=self.task.done_at(station))
        station = self.task.at(station).require_relevant(kind.name)
        self._set(laboratory=station, arms=self.task.working_arms(station))
        if self.robot:
            self._choose_cables(method)
        else:
            self._choose_calibration(method)
        self._start_from_prior(method)

    def _refuse_simulated(self) -> None:
        for field_ in fields(self):
            if field_.name in OF_SIMULATION and getattr(self, field_.name) != field_.default:
                problem = f"is for simulated sessions, and --robot {self.robot} drives real arms"
                raise InvalidInput(flag_of(field_), problem, "drop one of them")

    def _choose_cables(self, method: Method) -> None:
        """Check that each working arm has the cable model that the method needs, and that no model is superfluous."""
        files = self.cable_files()
        if method.learns:
            self._set(model=USUAL_MODEL)
        if files and not method.calibrated:
            problem = f"has no effect with --method {self.method}, which takes no model"
            raise InvalidInput(f"--cables {self.cables[0]}", problem, "drop it")
        for arm in files:
            if arm not in self.arms:
                raise UnknownName("--cables: arm", arm, self.arms)
        missing = [arm for arm in self.arms if arm not in files] if method.calibrated else []
        if missing:
            kind = type(self.task)
            other = next((name for name in methods_of(kind) if not pick_method(kind, name).calibrated), "")
            problem = f"compensates the cables of {', '.join(missing)}, and no model of them is named"
            remedy = f"give --cables {missing[0]}=FILE.npz (trocar calibrate)"
            remedy += f", or --method {other}" if other else ""
            raise InvalidInput(f"--method {self.method}", problem, remedy)

    def cable_files(self) -> dict[str, Path]:
        """Return the files of cable models that ``cables`` names, by arm."""
        files = {}
        for text in self.cables:
            arm, equals, path = text.partition("=")
            if not (arm and equals and path):
                raise InvalidInput(f"--cables {text}", "is not ARM=FILE.npz", "give it as psm1=cables_psm1.npz")
            if not Path(path).is_file():
                raise BadFile(path, "does not exist", "make one with `trocar calibrate`", kind="cable model")
            files[arm] = Path(path)
        return files

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _choose_model(self, method: Method) -> None:
        """Choose the cable model if there is one to fit; otherwise refuse options that would have no effect."""
        if self.model:
            from trocar.calibration.models import MODELS  # SciPy only when needed

            MODELS.pick(self.model)
        if not method.calibrated:
            who = f"--method {self.method}"
            for name, value in {"calibration": self.calibration, "model": "" if method.learns else self.model}.items():
                if value:
                    why = f"has no effect with {who}, which makes no calibration"
                    raise InvalidInput(f"--{name} {value}", why, f"drop --{name}")
            if self.new_session:
                why = f"mounts the instruments again after a calibration, and {who} makes none"
                raise InvalidInput("--new-session", why, "drop --new-session")
            if self.refit_offsets:
                raise InvalidInput("--refit-offsets", f"has no model to refit with {who}", "drop --refit-offsets")
        if method.calibrated or method.learns:
            self._set(model=self.model or USUAL_MODEL)

    def _choose_calibration(self, method: Method) -> None:
        """Choose what cable models are fitted on; refuse what is not possible before anything is written."""
        if self.calibration not in ("", IMAGES, JOINTS):
            raise UnknownName("calibration", self.calibration, (IMAGES, JOINTS))
        if not method.calibrated:
            return
        from trocar.collect.motion import why_no_images  # SciPy only when needed

        place, task = self.laboratory, self.task
        missing = [why for arm in self.arms if (why := why_no_images(place, arm, task.calibration(place, arm)))]
        if missing and self.calibration == IMAGES:
            problem = f"is not possible: {missing[0]}"
            raise InvalidInput(f"--calibration {IMAGES}", problem, f"or give --calibration {JOINTS}")
        self._set(calibration=self.calibration or (JOINTS if missing else IMAGES))

    def _start_from_prior(self, method: Method) -> None:
        """Choose the built-in prior for a method that learns; check that a prior has an effect and can be read."""
        if method.learns and self.model != USUAL_MODEL:
            raise InvalidInput(f"--method {self.method}", f"learns model 'play', not {self.model!r}", "drop --model")
        if method.learns and self.prior == NO_PRIOR:
            self._set(prior=BUILT_IN_PRIOR)
        if self.prior == NO_PRIOR:
            return
        if not (method.calibrated or method.learns) or self.model != USUAL_MODEL:
            raise InvalidInput(f"--prior {self.prior}", "has no play model that could start from it", "drop --prior")
        from trocar.calibration.fleet import load_prior  # SciPy only when needed

        load_prior(self.prior)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to recreate this configuration in another process, after loading the same plugins."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.init and f.name != "task"}
        values |= {"station": ""} if self.robot else {}
        options = {f.name: getattr(self.task, f.name) for f in fields(self.task)}  # type: ignore[arg-type]
        return _made_again, (self.task.name, options, values)

    def about(self) -> dict[str, Any]:
        """Return JSON values that distinguish this run from others: all but the numbers of sessions and trials."""
        more: dict[str, Any] = {}
        if self.robot:  # nothing was drawn, and a robot's flaws are its own
            more = {"robot": self.robot.partition(":")[0], "difficulty": [], "calibration": None, "model": None}
            more["cables"] = {arm: _digest(path) for arm, path in self.cable_files().items()}
        if self.prior not in (NO_PRIOR, BUILT_IN_PRIOR):
            more["prior_digest"] = _digest(Path(self.prior))
        return {
            "task": self.task.name,
            "variant": self.task.variant,
            "options": self.task.options(),
            "goal_noun": self.task.goal_noun,
            "station": self.laboratory.name,
            "station_digest": station_digest(self.station),
            "arms": list(self.arms),
            "method": self.method,
            "model": self.model if self.chosen_method.calibrated else None,
            "calibration": self.calibration if self.chosen_method.calibrated else None,
            "prior": self.prior if self.chosen_method.calibrated or self.chosen_method.learns else None,
            "planner": self.planner,
            "perception": self.perception,
            "set": list(self.settings),
            "seed": self.seed,
            "new_session": self.new_session,
            "refit_offsets": self.refit_offsets,
            "flawless_camera": self.flawless_camera,
            "command_noise": self.command_noise,
            "observations": self.observations,
            "difficulty": self.how_difficult,
            "plugins": [load_plugin(path) for path in self.plugins],
            "flaws": self._flaws(),
            "versions": versions(),
            **more,
        }

    @property
    def how_difficult(self) -> list[str]:
        """Return the laboratory's difficulty and the flaws with a size of their own."""
        return [self.difficulty, *self.laboratory.difficulty.named]

    def _flaws(self) -> dict[str, str]:
        if self.robot:
            return {f"cables of {arm}": f"corrected by {path.name}" for arm, path in self.cable_files().items()}
        flaws = self.laboratory.flaws(type(self.task).name, self.flawless_camera)
        if self.chosen_method.calibrated:
            how = "spheres seen in images" if self.calibration == IMAGES else "joints with drawn noise"
            flaws[FITTED_ON] = how
            if self.prior != NO_PRIOR:
                minute = f"{how}, {WIDE_ROWS} samples; they start from prior {self.prior!r}, from which recordings of "
                flaws[FITTED_ON] = minute + "the instrument itself are left out"
        if self.chosen_method.learns:
            seen = f"what the camera sees of the wrist in each trial; they start from prior {self.prior!r}, from which "
            flaws[FITTED_ON] = seen + "recordings of the instrument itself are left out"
        return flaws

    @property
    def unusual(self) -> dict[str, Any]:
        """Return the options that differ from the defaults for this task and method; the seed is not one of them."""
        kind = type(self.task)
        required = {f.name: getattr(self.task, f.name) for f in fields(kind) if f.default is MISSING}  # type: ignore[arg-type]
        where: dict[str, Any] = (
            {"robot": self.robot, "cables": self.cables} if self.robot else {"station": self.station}
        )
        usual = RunConfig(kind(**required), method=self.method, seed=self.seed, **where)
        found = {**self._chosen(), "station": self.station, "plugins": self.plugins}
        ordinary = {**usual._chosen(), "station": self.task.usual_station, "plugins": ()} | dict.fromkeys(required)
        return {name: value for name, value in found.items() if value != ordinary[name]}

    def _chosen(self) -> dict[str, Any]:
        """Return the options of the run and of the task, without what follows from them."""
        return {name: value for name, value in self.about().items() if name not in FOLLOWS} | self.task.options()

    @property
    def fingerprint(self) -> str:
        """Return the digest of :meth:`about`, which every file of this run carries."""
        return fingerprint(self.about())

    def rng(self, session: int, *stream: int) -> np.random.Generator:
        """Return the random generator of one of a session's streams."""
        return np.random.default_rng(self.seeds(session, *stream))

    def seeds(self, session: int, *stream: int) -> np.random.SeedSequence:
        """Return the seeds of one of a session's streams."""
        return np.random.SeedSequence([self.seed, session, *stream])


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _made_again(task: str, options: dict[str, Any], values: dict[str, Any]) -> RunConfig:
    for plugin in values["plugins"]:
        load_plugin(plugin)
    return RunConfig(task=TASKS.pick(task)(**options), **values)


def fingerprint(about: dict[str, Any]) -> str:
    """Return the digest of the values that distinguish a run from others."""
    text = json.dumps(about, sort_keys=True, allow_nan=False, default=jsonable)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages on which a trial's numbers depend."""
    return {name: version(name) for name in PACKAGES}
