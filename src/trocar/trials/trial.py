"""One trial as it is kept: what was done, what the referee saw, and how to do it again."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.trials.log import Computation, Span

FORMAT = "trocar trial"
VERSION = 1

UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error)
"""What NumPy, zip and JSON raise on files that are damaged or not ours."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A finished trial.

    The ``.npz`` holds nothing that depends on the machine's speed: the same seed writes the same bytes. The real
    times of computations lie beside it, in ``.timing.json``.

    Attributes:
        about: task, variant, method, model, seed, index, settings, versions.
        transfers: one dict a transfer (``TransferScore``).
        spans: of the scripts.
        events: of the scripts.
        collisions: dicts (``Collision``).
        finished: whether the script ended within the task's budget.
        duration_s: on the trial's clock.
        arrays: ``times_s``, ``blocks`` (n, blocks, 4, 4), ``tip_ARM`` (n, 3), ``qpos`` (n, nq) at 20 Hz;
            ``commanded_ARM`` and ``measured_ARM`` (m, 7) at 100 Hz; pictures as PNG bytes ``picture_K``.
        captions: of the pictures.
        computations: real times; not in the ``.npz``.
        wall_s: real time of the whole trial; not in the ``.npz``.
    """

    about: dict[str, object]
    transfers: list[dict[str, object]]
    spans: list[Span]
    events: list[dict[str, object]]
    collisions: list[dict[str, object]]
    finished: bool
    duration_s: float
    arrays: dict[str, NDArray]
    captions: list[str] = field(default_factory=list)
    computations: list[Computation] = field(default_factory=list)
    wall_s: float = 0.0

    def save(self, path: Path) -> None:
        """Write ``path`` and, beside it, the real times; an interrupted write leaves nothing half-done."""
        log = {
            "format": FORMAT,
            "version": VERSION,
            "about": self.about,
            "transfers": self.transfers,
            "spans": [asdict(span) for span in self.spans],
            "events": self.events,
            "collisions": self.collisions,
            "finished": self.finished,
            "duration_s": self.duration_s,
            "captions": self.captions,
        }
        text = np.frombuffer(json.dumps(log, sort_keys=True).encode(), dtype=np.uint8)
        timing = {"wall_s": self.wall_s, "computations": [asdict(c) for c in self.computations]}
        timing_path = timing_file(path)
        try:
            draft = path.with_name(f".{path.name}.{os.getpid()}.part")
            with draft.open("wb") as file:
                np.savez_compressed(file, log=text, **self.arrays)  # type: ignore[arg-type]
            timing_path.write_text(json.dumps(timing))
            draft.replace(path)
        except OSError as error:
            raise TrocarError(
                f"cannot write trial {str(path)!r} ({error.strerror}); choose another folder with --out"
            ) from None

    @staticmethod
    def load(path: Path) -> Trial:
        """Return the trial in a file that :meth:`save` wrote."""
        try:
            with np.load(path, allow_pickle=False) as data:
                arrays = {key: data[key] for key in data.files}
            log = json.loads(arrays.pop("log").tobytes().decode())
            timing = json.loads(timing_file(path).read_text())
            found = log["format"], log["version"]
            if found != (FORMAT, VERSION):
                raise TrocarError(
                    f"{str(path)!r} is a {found[0]!r} of version {found[1]}, not a {FORMAT!r} "
                    f"of version {VERSION}; run the trial again"
                )
            return Trial(
                about=log["about"],
                transfers=log["transfers"],
                spans=[Span(**span) for span in log["spans"]],
                events=log["events"],
                collisions=log["collisions"],
                finished=log["finished"],
                duration_s=log["duration_s"],
                arrays=arrays,
                captions=log["captions"],
                computations=[Computation(**c) for c in timing["computations"]],
                wall_s=timing["wall_s"],
            )
        except FileNotFoundError as error:
            raise TrocarError(f"trial file {error.filename!r} does not exist; run the trial again") from None
        except TrocarError:
            raise
        except UNREADABLE:
            raise TrocarError(f"{str(path)!r} is not a readable trial; delete it and run again") from None


def timing_file(path: Path) -> Path:
    """Return where the real times of a trial lie."""
    return path.with_suffix(".timing.json")


def trial_file(folder: Path, index: int) -> Path:
    """Return where the trial of this number lies."""
    return folder / f"trial_{index:03d}.npz"
