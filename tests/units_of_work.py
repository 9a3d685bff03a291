"""Units of work for other processes, which import this module by name; each notes its start and its end."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def done(unit: tuple[str, int]) -> int:
    """Do a unit and leave a file as its result; return at once if that exists."""
    folder, number = Path(unit[0]), unit[1]
    result = folder / f"done_{number}"
    if result.is_file():
        return number
    with (folder / "began").open("a") as file:
        file.write(f"{number}\n")
    time.sleep(0.02)
    draft = folder / f"draft_{number}_{os.getpid()}"
    draft.write_text(str(os.getpid()))
    draft.replace(result)
    with (folder / "ended").open("a") as file:
        file.write(f"{number}\n")
    return number


def killed_once(unit: tuple[str, int]) -> int:
    """Do a unit, but the process that first comes to number 3 is killed in the middle of it."""
    if unit[1] == 3 and not (Path(unit[0]) / "killed").exists():
        (Path(unit[0]) / "killed").write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)
    return done(unit)


def always_killed(unit: tuple[str, int]) -> int:
    """Kill the process every time."""
    os.kill(os.getpid(), signal.SIGKILL)
    return unit[1]


def refused(unit: tuple[str, int]) -> int:
    """Raise what a user's mistake raises."""
    from trocar.errors import TrocarError

    raise TrocarError(f"unit {unit[1]} is refused; give another")


def long(unit: tuple[str, int]) -> int:
    """Do a unit that takes over a second; leave a file at once to tell that it began."""
    (Path(unit[0]) / f"began_{unit[1]}").touch()
    time.sleep(1.2)
    return done(unit)
