"""``trocar view``: a saved trial in the browser, in 3D."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from trocar.cli.extras import need
from trocar.errors import TrocarError


def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    *,
    session: Annotated[int, typer.Option(metavar="S", help="Session, as in the name of its folder.")] = 0,
    trial: Annotated[int, typer.Option(metavar="K", help="Trial, as in the name of its file.")] = 0,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; if it is taken, the next free one.")
    ] = 8080,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open a browser.")] = True,
) -> None:
    """Show a saved trial in 3D in the browser: where arms and objects were, what the scripts did, what cameras saw.

    The page shows planned and driven paths of the tips and the contacts, and beside them the scripts' time line, the
    last camera image, and asked, commanded, measured and true joints. Only this machine can open it; Ctrl-C ends.
    """
    need("view", "viser")
    from trocar.eval.trial import Trial  # SciPy only when needed

    replay = Trial.load(trial_in(folder, session, trial)).replay()
    from trocar.view.trial_view import show_replay  # viser is heavy

    shown = show_replay(replay, port, block=False)
    address = f"http://127.0.0.1:{shown.port}"
    typer.echo(f"{replay.title}: {address} in a browser; Ctrl-C ends", err=True)
    if open_browser:
        webbrowser.open(address)
    with suppress(KeyboardInterrupt):
        shown.play()
    shown.close()


def trial_in(folder: Path, session: int, number: int) -> Path:
    """Return the file of a trial.

    Raises:
        TrocarError: the folder holds no trials, or not this one.
    """
    from trocar.eval.trial import trial_file, trial_files

    wanted = trial_file(folder, session, number)
    if wanted.is_file():
        return wanted
    found = [f"--session {int(p.parent.name[8:])} --trial {int(p.stem[6:])}" for p in trial_files(folder)]
    if not found:
        what = "is a file" if folder.is_file() else "holds no trial"
        raise TrocarError(f"{str(folder)!r} {what}; give the folder of a run")
    shown = ", ".join(found[:8]) + (" ..." if len(found) > 8 else "")
    raise TrocarError(f"there is no trial {number} of session {session} in {str(folder)!r}; choose one of {shown}")
