"""The keys of a page that move an arm in a person's hands, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SO3

WAYS: Mapping[str, tuple[str, tuple[int, int, int]]] = {
    "J": ("left", (-1, 0, 0)),
    "L": ("right", (1, 0, 0)),
    "I": ("away", (0, 1, 0)),
    "K": ("near", (0, -1, 0)),
    "U": ("up", (0, 0, 1)),
    "O": ("down", (0, 0, -1)),
}
"""Keys, and where they move the tip: as seen in the picture, but level or upright. viser's camera has A, D, E, Q, W."""
STEPS_M: Mapping[Any, float] = {None: 1e-3, "shift": 5e-3}
"""Length of a step, by the key that is pressed as well."""
JAWS: Mapping[str, float] = {"close": 0.0, "a third": 1 / 3, "open": 1.0}
"""Shares of the jaws' range."""
JAW_KEYS: Mapping[Any, str] = {"C": "close", "T": "a third", "P": "open"}

CONSOLE_KEYS = """window.trocarKeys ??= (() => {
  window.addEventListener('keydown', e => {
    if (!/^Key[A-Z]$/.test(e.code) || e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.repeat && !/[IJKLOU]$/.test(e.code)) e.stopImmediatePropagation();
    else if (e.target.ariaHasPopup === 'listbox') {
      e.preventDefault();
      e.stopImmediatePropagation();
      e.target.blur();
      document.body.dispatchEvent(new KeyboardEvent('keydown', e));
    }
  }, true);
  document.documentElement.addEventListener('keydown', e => { if (e.code === 'KeyS') e.stopPropagation(); });
  return true;
})()"""
"""What viser lacks: only the keys of ``WAYS`` repeat when held down, since a held yes would be one to the next question
too; a menu that was used, and keeps the focus, takes no keys; and S, which stops, does not move the camera away."""


class ArmKeys:
    """Keys for one of the arms in a person's hands, and a line that tells them.

    A key that is held down repeats, and so do its steps. Keys do nothing while no arm is in the person's hands.

    Args:
        gui: viser's; the line goes where it is.
        arms: names of the arms; a digit chooses one of several.
        may: returns whether the page on which viser's event happened has the controls.
        step: called with the arm, and its tip's displacement (3,) m along the world's axes.
        open_jaws: called with the arm, and the share.
    """

    def __init__(
        self,
        gui: Any,
        arms: Iterable[str],
        may: Callable[[Any], bool],
        step: Callable[[str, NDArray[np.float64]], None],
        open_jaws: Callable[[str, float], None],
    ):
        self._gui, self._may, self._step, self._open_jaws = gui, may, step, open_jaws
        self._held, self._chosen = tuple[str, ...](), ""
        gui.add_html(f'<img src="data:," hidden onerror="{escape(CONSOLE_KEYS)}">')
        self._line = gui.add_html("", visible=False)
        for key, (way, axes) in WAYS.items():
            for modifier, length_m in STEPS_M.items():
                by_m = length_m * np.array(axes)
                self._add(f"Tip {way} by {1e3 * length_m:g} mm", key, partial(self._move, by_m), modifier)
        for key, name in JAW_KEYS.items():
            self._add(f"Jaws: {name}", key, partial(self._open, JAWS[name]))
        self._digits = {arm: str(number) for number, arm in enumerate(arms, 1)}
        for arm, digit in self._digits.items():
            self._add(f"Keys move {arm}", digit, partial(self._choose, arm))
        ways = ", ".join(f"{key} {way}" for key, (way, _) in WAYS.items())
        openings = ", ".join(f"{key} {name}" for key, name in JAW_KEYS.items())
        self._told = f"{ways}; {1e3 * STEPS_M[None]:g} mm, with Shift {1e3 * STEPS_M['shift']:g}. Jaws: {openings}"

    def show(self, held: Iterable[str]) -> None:
        """Note which arms are in the person's hands, and tell which of them the keys move."""
        self._held = tuple(held)
        self._line.visible = bool(self._held)
        if self._held:
            others = [f"{self._digits[arm]} for {arm}" for arm in self._held if arm != self._arm]
            told = ". ".join([f"Keys move <b>{escape(self._arm)}</b>: {self._told}", *map(escape, others)])
            self._line.content = f'<div style="font-size:12px;padding:2px 14px">{told}</div>'

    @property
    def _arm(self) -> str:
        """Return the arm that keys move: of those held, the one chosen, else the first."""
        return self._chosen if self._chosen in self._held else self._held[0]

    def _add(self, label: str, key: Any, do: Callable[[Any], None], modifier: Any = None) -> None:
        async def pressed(event: Any) -> None:  # viser calls it at once, in the order of the keys
            if self._held and self._may(event):
                do(event)

        self._gui.add_command(label, hotkey=key, modifier=modifier).on_trigger(pressed)

    def _move(self, by_m: NDArray[np.float64], event: Any) -> None:
        self._step(self._arm, as_seen(by_m, np.array(event.client.camera.wxyz)))

    def _open(self, share: float, _: Any) -> None:
        self._open_jaws(self._arm, share)

    def _choose(self, arm: str, _: Any) -> None:
        self._chosen = arm
        self.show(self._held)


def as_seen(by_m: NDArray[np.float64], wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a displacement (3,) along the world's axes that goes right, away and up as a camera shows them.

    Args:
        by_m: (3,) to the right and away, both level, and up.
        wxyz: (4,) orientation of the camera in the world; its x axis points to the right in the picture.
    """
    x, y = SO3.from_quaternion(wxyz).matrix[:2, 0]
    return SO3.axis("z", np.arctan2(y, x)).apply(by_m)
