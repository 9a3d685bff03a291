"""Prepare a session for its trials: draw it, and calibrate its arms if the method needs it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import trocar
from trocar.calibration.evaluation import refit_offset
from trocar.calibration.excitation import SAMPLES, WIDE_ROWS
from trocar.calibration.fleet import FleetPrior, expected, fit_from_prior, load_prior
from trocar.calibration.models import MODELS, CableModel, load_model, save_model
from trocar.calibration.recording import Recording
from trocar.collect.collection import Collection
from trocar.errors import TrocarError
from trocar.eval.config import CALIBRATION, IMAGES, NO_PRIOR, REFIT, REMOUNT, SESSION, RunConfig, fingerprint
from trocar.eval.trial import session_folder
from trocar.lab import SensorFlaws
from trocar.lab.session import Session, draw_session
from trocar.sim.calibration_cells import record_motion

IMAGES_ROWS, EVERY = 650, 2
"""Number of images of an arm in a run, and of commands per image: about the paper's motion, with half the images.
Neighbouring rows show much the same. So a model is as good as with an image of each row, and better than with the same
number of images of half the motion (`benchmarks/bench_fiducials.py`)."""

REFIT_SAMPLES, REFIT_IMAGES = 30, 45
"""Samples for a quick refit of the cables' offsets before the trials; more for images, because some show too few
spheres."""


NO_MATTER = {"variant", "options", "arms", "method", "planner", "perception", "set", "new_session", "refit_offsets"}
NO_MATTER |= {"command_noise", "observations"}
"""Keys of a run's configuration that do not affect its fitted cable models."""

NO_PART = {"bags", "cli", "console", "crtk", "learn", "report", "tasks", "testing", "view"}
"""Packages above those that calibrate: nothing there is imported by them, so calibrations outlast changes to them."""

CACHE = "TROCAR_CACHE"
"""Environment variable that names the folder of the cache."""

Listener = Callable[[str, int, int], None]
"""Called with the name of the arm that is calibrated, the number of rows done, and of all rows."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A session that is ready for its trials.

    Attributes:
        number: the session's number in its run.
        session: the session; simulator truth.
        models: cable model of each working arm, if the method compensates.
        priors: prior from which each model starts, if the robot learns.
    """

    number: int
    session: Session
    models: Mapping[str, CableModel]
    priors: Mapping[str, FleetPrior] = field(default_factory=dict)


def prepare(config: RunConfig, number: int, folder: str | Path, *, listener: Listener | None = None) -> Prepared:
    """Return one session of a run, calibrated if the method needs it.

    A calibration depends only on the session and a few settings, so it is saved in the cache (:func:`cache_folder`) for
    other runs, and in the session's folder for an interrupted run. The model is always read back from a file, so that a
    resumed run computes the same as an uninterrupted one.

    Args:
        config: the run's configuration.
        number: the session's number.
        folder: the run's folder.
        listener: called after each row of a calibration.
    """
    folder = Path(folder)
    session = draw_session(config.laboratory, config.rng(number, SESSION))
    session_folder(folder, number).mkdir(parents=True, exist_ok=True)
    models: dict[str, CableModel] = {}
    priors = {arm: _prior(config, arm) for arm in config.arms} if config.chosen_method.learns else {}
    for arm, prior in priors.items():
        models[arm] = expected(prior, config.task.calibration(config.laboratory, arm))
    if config.chosen_method.calibrated:
        models |= {arm: _calibrated(config, session, number, arm, folder, listener) for arm in config.arms}
    if config.new_session:
        session = session.remounted(config.rng(number, REMOUNT))
    if config.refit_offsets:
        for place, (arm, model) in enumerate(models.items()):
            rows = REFIT_IMAGES if config.calibration == IMAGES else REFIT_SAMPLES
            recording = _recording(config, session, arm, (number, REFIT, place), rows)
            models[arm] = refit_offset(model, recording)
    return Prepared(number, session, models, priors)


def _calibrated(
    config: RunConfig, session: Session, number: int, arm: str, folder: Path, listener: Listener | None
) -> CableModel:
    """Return the model of an arm's cables: from the run's folder, else from the cache, else fitted now."""
    path = cable_file(folder, number, arm)
    if path.is_file():
        return load_model(path, config.fingerprint)
    key = calibration_key(config, number, arm)
    known = cache_folder() / f"{config.task.name}_{config.seed}_{number:02d}_{arm}_{key}.npz"
    model = None
    with suppress(TrocarError):  # a damaged file is fitted again
        model = load_model(known, key) if known.is_file() else None
    if model is None:
        wide = config.prior != NO_PRIOR
        every = EVERY if config.calibration == IMAGES and not wide else 1
        rows = WIDE_ROWS if wide else every * IMAGES_ROWS if config.calibration == IMAGES else SAMPLES
        stream = (number, CALIBRATION, config.arms.index(arm))
        images = session_folder(folder, number) / f"spheres_{arm}.npz"
        recording = _recording(config, session, arm, stream, rows, images, listener, every=every, wide=wide)
        if wide:
            model = fit_from_prior(recording, _prior(config, arm))
        else:
            model = MODELS.pick(config.model).fit(recording, config.rng(*stream))
        with suppress(OSError, TrocarError):  # without the cache, other runs fit the model again
            known.parent.mkdir(parents=True, exist_ok=True)
            save_model(model, known, key)
    save_model(model, path, config.fingerprint)
    return load_model(path, config.fingerprint)


def cache_folder() -> Path:
    """Return the folder of fitted cable models: ``$TROCAR_CACHE``, or ``trocar`` in the user's cache folder."""
    named = os.environ.get(CACHE)
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trocar"


def cached_calibrations() -> list[Path]:
    """Return the files in the cache, the oldest first."""
    return sorted(cache_folder().glob("*_*_*_*_????????????????.npz"), key=lambda path: path.stat().st_mtime)


def _prior(config: RunConfig, arm: str) -> FleetPrior:
    """Return the prior for an arm's cables, without recordings of the instrument from which they were identified."""
    return load_prior(config.prior).without(config.laboratory.arm(arm).transmission_name)


def _recording(
    config: RunConfig,
    session: Session,
    arm: str,
    stream: tuple[int, ...],
    rows: int,
    path: Path | None = None,
    listener: Listener | None = None,
    *,
    every: int = 1,
    wide: bool = False,
) -> Recording:
    """Return a recording of an arm in this session, from images or with drawn noise, as configured."""
    box = config.task.calibration(config.laboratory, arm)
    if config.calibration != IMAGES:
        return record_motion(session, arm, config.rng(*stream), box, rows, wide=wide)
    flaws = SensorFlaws.none() if config.flawless_camera else None
    collection = Collection(session, arm, box, config.seeds(*stream), rows, every=every, wide=wide, flaws=flaws)
    heard = None if listener is None else lambda done, total: listener(arm, done, total)
    return collection.recording(collection.measured(collection.run(path, heard)))


def cable_file(folder: str | Path, number: int, arm: str) -> Path:
    """Return the path of an arm's cable model in a session of a run."""
    return session_folder(folder, number) / f"cables_{arm}.npz"


def calibration_key(config: RunConfig, session: int, arm: str) -> str:
    """Return a digest of everything on which an arm's fitted model depends; runs with the same digest share a model."""
    about = {key: value for key, value in config.about().items() if key not in NO_MATTER}
    station = config.laboratory
    return fingerprint(
        {
            **about,
            "session": session,
            "arm": arm,
            "place": config.arms.index(arm),
            "motion": repr(config.task.calibration(station, arm)),
            "bases": {name: there.T_world_base.matrix.tolist() for name, there in station.arms.items()},
            "fixtures": {name: T.matrix.tolist() for name, T in station.T_world_fixture.items()},
            "source": _source_digest(),
        }
    )


@cache
def _source_digest() -> str:
    """Return the digest of the source that a calibration runs, so that none is used that older code has fitted."""
    digest, root = hashlib.sha256(), Path(trocar.__file__).parent
    for file in sorted(root.rglob("*.py")):
        if file.relative_to(root).parts[0] not in NO_PART:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
