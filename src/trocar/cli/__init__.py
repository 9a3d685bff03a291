"""The command line: parse, call, print."""

from __future__ import annotations

import io
import os
import sys
import traceback
from contextlib import suppress
from typing import Annotated, NoReturn

import typer

from trocar import __version__
from trocar.errors import MachineError, TrocarError
from trocar.output import NO_NAME

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before NumPy is imported: its threads cost more than they bring here

MIN_COLUMNS, MAX_COLUMNS = 20, 1000
"""Of a terminal that COLUMNS may claim; narrower tables say nothing."""

app = typer.Typer(
    name="trocar",
    help="Autonomous surgical sub-tasks on cable-driven robots: see, calibrate, plan, act, score.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    """Print the version and end, before anything else is looked at."""
    if wanted:
        typer.echo(f"trocar {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    del version


from trocar.cli import analyse, calibrate, doctor, plan, register, run, station, study, view  # noqa: E402

app.command(epilog="Example: trocar doctor")(doctor.doctor)
app.command(epilog="Example: trocar report out/ten")(run.report)
app.command(epilog="Example: trocar view out/ten --trial 3")(view.view)
app.command(epilog="Example: trocar analyse joints.csv --rate 100 --out out/motion")(analyse.analyse)
app.add_typer(run.app, name="run")
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(plan.app, name="plan")
app.add_typer(register.app, name="register")
app.add_typer(station.app, name="station")
app.add_typer(study.app, name="study")


def main() -> None:
    """Run the command line. What goes wrong is one sentence on stderr, and tells by the exit code whose trouble it is.

    2: the input's, 3: the machine's, 130: stopped by Ctrl-C. Anything else is a mistake in Trocar or in a plugin, the
    only case in which a traceback is shown: 70.
    """
    _fit_terminal()
    if "" in sys.argv[1:] or any(word.startswith("--") and word.endswith("=") for word in sys.argv[1:]):
        _end(2, "a word of the command is empty, as where a shell's variable has no value; fill it in or leave it out")
    try:
        app()
    except MachineError as error:
        _end(3, str(error))
    except TrocarError as error:
        _end(2, str(error))
    except MemoryError:
        _end(3, "there is not enough memory for this; ask for less at once, or close other programs")
    except OSError as error:
        what = f"{error.filename!r}: {error.strerror}" if error.filename else error.strerror or str(error)
        if error.errno in NO_NAME:
            _end(2, f"that can be no file's name ({what}); give another")
        _end(3, f"the machine is in trouble ({what}); see to it and give the same command again")
    except KeyboardInterrupt:
        _end(130, "stopped")
    except Exception:
        traceback.print_exc()
        _end(70, "that was a mistake in Trocar or in a plugin, not in what you typed; the lines above say where")


def _fit_terminal() -> None:
    """Print to whatever is there: no width that is none, and escapes for what cannot be encoded."""
    columns = os.environ.get("COLUMNS", "")
    if not (columns.isascii() and columns.isdigit() and MIN_COLUMNS <= int(columns[:9]) <= MAX_COLUMNS):
        os.environ.pop("COLUMNS", None)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _end(code: int, sentence: str) -> NoReturn:
    """Print a sentence and end; where nobody reads any more, as after ``| head``, end alone."""
    with suppress(OSError):
        sys.stderr.write(f"trocar: {sentence}\n")
    raise SystemExit(code) from None
