"""Contacts in a viser scene: a ball at each touch while it lasts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.replay import Contact, Replay
from trocar.view.film import Film
from trocar.view.palette import CONTACT

if TYPE_CHECKING:
    from viser import SceneApi

MIN_S = 0.5
"""A shorter touch is shown for this long, to be visible at all."""


class Contacts:
    """As many balls as there are simultaneous touches."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film, radius_m: float) -> None:
        """Add the balls, hidden at first.

        Args:
            scene: the viser scene.
            replay: with the contacts.
            film: with the frames.
            radius_m: of a ball.
        """
        self._rows = rows(replay.contacts)
        self._times_s = film.times_s
        self._shown: list[Contact | None] = [None] * len(self._rows)
        self._balls = [
            scene.add_icosphere(
                f"/contacts/{k}", radius_m, color=CONTACT, opacity=0.85, cast_shadow=False, visible=False
            )
            for k in range(len(self._rows))
        ]
        self._labels = [
            scene.add_label(f"/contacts/{k}/label", "", position=(0.0, 0.0, 1.5 * radius_m), anchor="bottom-center")
            for k in range(len(self._rows))
        ]

    def show(self, frame: int) -> None:
        """Show the touches of a frame."""
        time_s = float(self._times_s[frame])
        for k, row in enumerate(self._rows):
            now = next((touch for touch in row if touch.time_s <= time_s < shown_until(touch)), None)
            if now is not self._shown[k]:
                self._shown[k] = now
                if now is not None:
                    self._balls[k].position = now.p_world_m
                    self._labels[k].text = f"{' - '.join(now.between)}, {now.force_n:.1f} N"
                self._balls[k].visible = now is not None


def shown_until(touch: Contact) -> float:
    """Return the time until which a touch is shown."""
    return max(touch.end_s, touch.time_s + MIN_S)


def rows(contacts: tuple[Contact, ...]) -> list[list[Contact]]:
    """Return the contacts in as few rows as possible without simultaneous contacts in a row."""
    found: list[list[Contact]] = []
    for touch in sorted(contacts, key=lambda touch: touch.time_s):
        for row in found:
            if shown_until(row[-1]) <= touch.time_s:
                row.append(touch)
                break
        else:
            found.append([touch])
    return found
