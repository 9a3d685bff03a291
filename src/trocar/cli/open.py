"""``trocar open``: all runs below some folders, on pages in the browser."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from trocar.cli.group import Result
from trocar.cli.options import JsonFlag, OpenBrowser, Port
from trocar.cli.progress import progress
from trocar.counting import counted
from trocar.errors import InvalidInput


def open_runs(
    folders: Annotated[list[Path], Argument(metavar="DIR...", help="Folders in and below which runs lie.")],
    *,
    port: Port = 8000,
    open_browser: OpenBrowser = True,
    as_json: JsonFlag = False,
) -> None:
    """Show all runs below some folders in the browser: a table, the failures of each, two side by side, replays.

    A click on a failure plays its trial in 3D from there (needs viser). Runs that are broken or unfinished are listed
    with what is wrong. Trials are read where they are, and nothing is written there. New ones appear when the page is
    loaded again. Only this machine can open it; Ctrl-C ends.
    """
    from trocar.report.browse import BrowseServer, Shelf  # SciPy only when needed

    shelf = Shelf(folders)
    with progress() as tick:
        runs = shelf.runs(tick)
    if as_json:
        Result({"runs": [run.row() for run in runs]}).show(as_json)
        return
    if not runs:
        where = " or ".join(repr(str(folder)) for folder in folders)
        raise InvalidInput("there", f"is no run in or below {where}", "make one with `trocar run`")
    with BrowseServer(shelf, port) as server, suppress(KeyboardInterrupt):
        typer.echo(f"{counted(len(runs), 'run')}: {server.address} in a browser; Ctrl-C ends", err=True)
        if open_browser:
            webbrowser.open(server.address)
        server.wait()
