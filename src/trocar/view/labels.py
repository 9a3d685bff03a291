"""Names of the arms in a viser scene, with what each is doing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.paths import filled

if TYPE_CHECKING:
    from viser import SceneApi

STEP_M = 1e-3  # a label stays in place while its arm moves less than this


class ArmLabels:
    """A label over each arm's tip."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, above_m: float) -> None:
        """Add the labels.

        Args:
            scene: the viser scene.
            replay: with the arms.
            film: with the frames.
            above_m: height over the tips.
        """
        paths = {arm: filled(path.p_world_driven_m) for arm, path in replay.tools.items()}
        self._places = {arm: p[film.ticks] + [0.0, 0.0, above_m] for arm, p in paths.items() if p is not None}
        self._texts = {arm: captions(replay, film, arm) for arm in replay.tools}
        self._labels = {
            arm: scene.add_label(
                f"/arms/{arm}", arm, position=tuple(places[0].tolist()), anchor="bottom-center", font_screen_scale=1.2
            )
            for arm, places in self._places.items()
        }
        self.show(0)

    def show(self, frame: int) -> None:
        """Put the labels over the tips at a frame, with what the arms are doing."""
        for arm, label in self._labels.items():
            place = self._places[arm][frame]
            if np.linalg.norm(place - label.position) > STEP_M:
                label.position = place
            label.text = self._texts[arm][frame]


def captions(replay: Replay, film: Film, arm: str) -> list[str]:
    """Return for each frame the arm's name and what it is doing: the name of its shortest span about that time."""
    texts = [arm] * len(film.times_s)
    spans = [span for span in replay.spans if span[0] == arm]
    for _, name, start_s, end_s in sorted(spans, key=lambda span: span[2] - span[3]):  # the longest first
        first, last = np.searchsorted(film.times_s, [start_s, end_s])
        texts[first:last] = [f"{arm}: {name}"] * (last - first)
    return texts
