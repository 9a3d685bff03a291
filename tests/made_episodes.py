"""Short made-up trials with images, for tests of data sets."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import numpy as np
from PIL import Image

from synthetic import config, synthetic_trial
from trocar.eval.trial import Trial

RUN = config()
TICKS = 301
COLOURS = ((200, 30, 30), (30, 200, 30))
TAKEN_S = (0.5, 1.5)


def picture(colour: tuple[int, int, int], width: int = 64) -> bytes:
    """Return a picture of one colour as the bytes of a file."""
    file = BytesIO()
    Image.fromarray(np.full((48, width, 3), colour, np.uint8)).save(file, "webp", lossless=True)
    return file.getvalue()


def short(index: int = 0, *, success: bool = True, images: bool = True, session: int = 0, width: int = 64) -> Trial:
    """Return the first 3 s of a trial, in which one goal ends; commanded joints differ from desired ones."""
    trial = synthetic_trial(RUN, index, {} if success else {0: "DROPPED"}, session=session)
    arrays = {k: v[:TICKS] if len(v) > TICKS else v for k, v in trial.arrays.items()}
    arrays["commanded_psm1"] = arrays["commanded_psm1"] + np.float32(0.003)
    scores = [{**trial.scores[0], "end_s": 2.0}]
    events = [{"name": "transfer", "time_s": 2.0, "goal": 0, "arm": "psm1", "start_s": 0.5}]
    blobs = {f"overhead_{k:03d}.webp": picture(colour, width) for k, colour in enumerate(COLOURS)}
    cameras = {"overhead": list(zip(TAKEN_S, blobs, strict=True))} if images else {}
    scenery = replace(trial.scenery, cameras=cameras)
    return replace(trial, arrays=arrays, scores=scores, events=events, scenery=scenery, images=blobs if images else {})
