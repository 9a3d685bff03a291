"""The command line: parse, call, print."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import suppress
from io import TextIOWrapper
from typing import Annotated, Any, NoReturn

import typer

from trocar import __version__
from trocar.cli.commands import COMMANDS
from trocar.cli.group import Group
from trocar.cli.options import Quiet
from trocar.cli.terminal import be_quiet
from trocar.errors import TrocarError
from trocar.files.output import NO_NAME

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before NumPy is imported: its threads slow these small problems down

MIN_COLUMNS, MAX_COLUMNS = 20, 1000
"""Plausible widths of a terminal; a value outside them counts as not given, as with COLUMNS=0."""


class _Trocar(Group):
    def __init__(self, **given: Any) -> None:
        about = "Autonomous surgical sub-tasks on cable-driven robots: see, calibrate, plan, act, score."
        super().__init__(**{**given, "name": "trocar", "about": about, "members": COMMANDS, "help": about})


app = typer.Typer(
    cls=_Trocar,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    """Print the version and exit, before other options are parsed."""
    if wanted:
        typer.echo(f"trocar {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
    quiet: Quiet = False,
) -> None:
    del version, quiet


def main() -> None:
    """Run the command line. An error is one sentence on stderr, and the exit code tells its cause.

    2: bad input, 3: trouble with the machine, 130: stopped by Ctrl-C. Anything else is a bug in Trocar or in a plugin:
    70, the only case in which a traceback is shown.
    """
    prepare_streams()
    if "" in sys.argv[1:] or any(word.startswith("--") and word.endswith("=") for word in sys.argv[1:]):
        _end(2, "a word of the command is empty, as where a shell's variable has no value; fill it in or leave it out")
    be_quiet(False)
    try:
        app()
    except TrocarError as error:
        _end(error.exit_code, str(error))
    except MemoryError:
        _end(3, "there is not enough memory for this; ask for less at once, or close other programs")
    except OSError as error:
        what = f"{error.filename!r}: {error.strerror}" if error.filename else error.strerror or str(error)
        if error.errno in NO_NAME:
            _end(2, f"no file can have that name ({what}); give another")
        _end(3, f"the machine is in trouble ({what}); see to it and give the same command again")
    except KeyboardInterrupt as error:
        _end(130, str(error) or "stopped")
    except Exception:
        traceback.print_exc()
        _end(70, "that was a mistake in Trocar or in a plugin, not in what you typed; the lines above say where")


def prepare_streams() -> None:
    """Make any text printable anywhere: characters that an encoding lacks are written as escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns and not (columns.isascii() and columns.isdigit() and MIN_COLUMNS <= int(columns[:9]) <= MAX_COLUMNS):
        del os.environ["COLUMNS"]


def _end(code: int, sentence: str) -> NoReturn:
    """Print a sentence and end; if the output is no longer read, as after ``| head``, only end."""
    with suppress(OSError):
        sys.stderr.write(f"trocar: {sentence}\n")
    raise SystemExit(code) from None
