"""Prepares a session for its trials: draws it, and calibrates its arms if the method needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trocar.calibration.excitation import SAMPLES, WIDE_ROWS
from trocar.calibration.fitting import refit_offset
from trocar.calibration.fleet import FleetPrior, expected, fit_from_prior, load_prior
from trocar.calibration.models import MODELS, CableModel, load_model, save_model
from trocar.calibration.recording import Recording
from trocar.collect.collection import Collection, Listener
from trocar.eval.config import CALIBRATION, IMAGES, NO_PRIOR, REFIT, REMOUNT, SESSION, RunConfig, fingerprint
from trocar.eval.trial import session_folder
from trocar.lab import SensorFlaws
from trocar.lab.session import Session, draw_session
from trocar.sim.recording import record_motion

IMAGES_ROWS = 650
"""Number of images of an arm in a run: half of the paper's rows. The wrist's RMSE of `play` against the cables alone is
then .0062 rad or less, with all 1355 .0054 or less (`benchmarks/bench_fiducials.py`), at half the time."""

REFIT_SAMPLES, REFIT_IMAGES = 30, 45
"""Samples for a quick refit of the cables' offsets after instruments were remounted; more for images, because some show
too few spheres."""


NO_MATTER = {"variant", "options", "arms", "method", "planner", "perception", "new_session", "refit_offsets"}
"""Keys of a run's configuration that do not affect its fitted cable models."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A session that is ready for its trials.

    Attributes:
        number: of the session in its run.
        session: the session; simulator truth.
        models: the cable model of each working arm, if the method compensates.
        priors: those from which these models start, if the robot learns.
    """

    number: int
    session: Session
    models: Mapping[str, CableModel]
    priors: Mapping[str, FleetPrior] = field(default_factory=dict)


def prepare(
    config: RunConfig,
    number: int,
    folder: str | Path,
    *,
    spheres: str | Path | None = None,
    listener: Listener | None = None,
) -> Prepared:
    """Return one session of a run, calibrated if the method needs it.

    A fitted model is stored in the session's folder, so that an interrupted run does not fit it again; the model is
    always read back from that file, so that a resumed run computes the same as an uninterrupted one.

    Args:
        config: of the run.
        number: of the session.
        folder: of the run.
        spheres: folder for what was found in a calibration's images, which runs of the same session may share; None:
            the session's own.
        listener: called after each image of a calibration.
    """
    folder = Path(folder)
    session = draw_session(config.laboratory, config.rng(number, SESSION))
    home = session_folder(folder, number)
    home.mkdir(parents=True, exist_ok=True)
    models: dict[str, CableModel] = {}
    priors = {arm: _prior(config, arm) for arm in config.arms} if config.chosen_method.learns else {}
    for arm, prior in priors.items():
        models[arm] = expected(prior, config.task.calibration(config.laboratory, arm))
    if config.chosen_method.calibrated:
        for place, arm in enumerate(config.arms):
            path = cable_file(folder, number, arm)
            if not path.is_file():
                kept = Path(spheres or home) / f"spheres_{arm}.npz"
                wide = config.prior != NO_PRIOR
                rows = WIDE_ROWS if wide else IMAGES_ROWS if config.calibration == IMAGES else SAMPLES
                stream = (number, CALIBRATION, place)
                recording = _recording(config, session, arm, stream, rows, kept, listener, wide=wide)
                save_model(_fitted(config, arm, recording, config.rng(*stream)), path, config.fingerprint)
            models[arm] = load_model(path, config.fingerprint)
    if config.new_session:
        session = session.remounted(config.rng(number, REMOUNT))
    if config.refit_offsets:
        for place, (arm, model) in enumerate(models.items()):
            rows = REFIT_IMAGES if config.calibration == IMAGES else REFIT_SAMPLES
            recording = _recording(config, session, arm, (number, REFIT, place), rows)
            models[arm] = refit_offset(model, recording)
    return Prepared(number, session, models, priors)


def _fitted(config: RunConfig, arm: str, recording: Recording, rng: np.random.Generator) -> CableModel:
    """Return the model of an arm's cables."""
    if config.prior == NO_PRIOR:
        return MODELS.pick(config.model).fit(recording, rng)
    return fit_from_prior(recording, _prior(config, arm))


def _prior(config: RunConfig, arm: str) -> FleetPrior:
    """Return the prior for an arm's cables, which must not have seen the instrument that these were identified from."""
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
    wide: bool = False,
) -> Recording:
    """Return a recording of an arm in this session, from images or with drawn noise, as configured."""
    box = config.task.calibration(config.laboratory, arm)
    if config.calibration != IMAGES:
        return record_motion(session, arm, config.rng(*stream), box, rows, wide=wide)
    flaws = SensorFlaws.none() if config.flawless_camera else None
    collection = Collection(session, arm, box, config.seeds(*stream), rows, wide=wide, flaws=flaws)
    return collection.recording(collection.measured(collection.run(path, listener)))


def cable_file(folder: str | Path, number: int, arm: str) -> Path:
    """Return the path of an arm's cable model in a session of a run."""
    return session_folder(folder, number) / f"cables_{arm}.npz"


def calibration_key(config: RunConfig, arm: str) -> str:
    """Return a digest of everything on which an arm's fitted model depends; runs with the same digest can share it."""
    about = {key: value for key, value in config.about().items() if key not in NO_MATTER}
    box = config.task.calibration(config.laboratory, arm)
    return fingerprint({**about, "arm": arm, "place": config.arms.index(arm), "motion": repr(box)})
