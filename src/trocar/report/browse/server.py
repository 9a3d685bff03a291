"""Serves the pages to this machine only, and makes replays on demand."""

from __future__ import annotations

import tempfile
import threading
import traceback
from collections.abc import Sequence
from contextlib import suppress
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from trocar.counting import counted
from trocar.errors import InvalidInput, NotInstalled, TrocarError
from trocar.eval.trial import Trial
from trocar.eval.trials import sessions_met
from trocar.report import failures
from trocar.report.browse import addresses
from trocar.report.browse.all_runs import PROPERTIES, all_runs_page
from trocar.report.browse.one_run import one_run_page
from trocar.report.browse.one_trial import one_trial_page
from trocar.report.browse.shelf import Run, Shelf, named
from trocar.report.browse.two_runs import two_runs_page
from trocar.report.files import report_of, shown_replay
from trocar.report.page import POLICY, document, link

LOCAL = "127.0.0.1"
"""Only programs on this machine can reach a server at this address."""


class BrowseServer:
    """Pages of a shelf on a server that only this machine can reach; a context manager.

    Args:
        shelf: the runs.
        port: of the server; if it is taken, the next free one; 0: any free one.

    Raises:
        InvalidInput: no port is free.
    """

    def __init__(self, shelf: Shelf, port: int = 8000):
        self.shelf = shelf
        self._replays = tempfile.TemporaryDirectory(prefix="trocar-replays-")
        self._making = threading.Lock()
        self._server = _bound(port, type("Handler", (_Handler,), {"pages": self}))
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> BrowseServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._replays.cleanup()

    @property
    def address(self) -> str:
        """Return the address of the table of all runs."""
        return f"http://{LOCAL}:{self._server.server_port}/"

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        self._thread.join()

    def page(self, address: str) -> str | Path:
        """Return the page at an address, or the path of its file.

        Raises:
            InvalidInput: there is no such page.
        """
        parts = urlsplit(address)
        asked, runs = parse_qs(parts.query), self.shelf.runs()
        match [unquote(part) for part in parts.path.strip("/").split("/")]:
            case [""]:
                by = asked.get("by", ["run"])[0]
                return all_runs_page(runs, self.shelf.folders, by if by in PROPERTIES else "run", "down" in asked)
            case ["compare"]:
                return two_runs_page(*_pair(runs, asked.get("run", [])))
            case ["runs", name]:
                run = named(runs, name)
                return one_run_page(run, _comparable(run, runs))
            case ["runs", name, (addresses.REPORT | failures.REPLAY) as file]:
                path = named(runs, name).folder / file
                if path.is_file():
                    return path
            case ["runs", name, session, trial, *rest] if rest in ([], [failures.REPLAY]):
                run = named(runs, name)
                path = run.trial(_number(session, "session_"), _number(trial, "trial_"))
                if rest:
                    return self._replay(path)
                return one_trial_page(run, Trial.load(path), {key: values[0] for key, values in asked.items()})
        raise InvalidInput(f"page {address!r}", "does not exist", "begin at the table of all runs")

    def _replay(self, trial: Path) -> Path:
        """Return the replay of a trial; make it unless one was made of the same version of the trial's file."""
        try:
            from trocar.view.replay import write_replay  # an extra
        except ImportError:
            raise NotInstalled("a replay", "viser", "view") from None
        stamp = trial.stat()
        place = "-".join((trial.parent.parent.name, trial.parent.name, trial.stem))
        path = Path(self._replays.name) / f"{place}-{stamp.st_ino}-{stamp.st_mtime_ns}.html"
        with self._making:
            if not path.is_file():
                loaded = Trial.load(trial)
                write_replay(shown_replay(loaded, report_of(loaded)), path)
        return path


def _pair(runs: Sequence[Run], names: Sequence[str]) -> tuple[Run, Run]:
    if len(names) != 2:
        raise InvalidInput(f"a comparison of {counted(len(names), 'run')}", "cannot be shown", "tick two in the table")
    return named(runs, names[0]), named(runs, names[1])


def _comparable(run: Run, runs: Sequence[Run]) -> list[Run]:
    """Return the other runs that met the same sessions."""
    if not run.trials:
        return []
    met = sessions_met(run.trials)
    return [other for other in runs if other.name != run.name and other.trials and sessions_met(other.trials) == met]


def _number(text: str, prefix: str) -> int:
    """Return the number in a folder's or file's name; if there is none, -1, which no trial has."""
    number = text.removeprefix(prefix)
    return int(number) if text.startswith(prefix) and number.isdecimal() else -1


def _bound(port: int, handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    """Return a server at a port, or at the next free one."""
    for tried in [port] if port == 0 else range(port, min(port + 100, 65536)):
        try:
            return ThreadingHTTPServer((LOCAL, tried), handler)
        except OSError:
            continue
    raise InvalidInput("the port", f"is {port}, and none of the next hundred is free", "give another with --port")


class _Handler(BaseHTTPRequestHandler):
    """Answers a browser with pages; an error becomes a sentence on a page."""

    pages: BrowseServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        with suppress(ConnectionError):  # a browser that has gone on to another page
            self._answer(*self._found())

    def _found(self) -> tuple[HTTPStatus, bytes, str]:
        """Return status, page and policy: none for a run's report or a replay, which contain their own."""
        if self.headers.get("Host", "").partition(":")[0] not in (LOCAL, "localhost"):  # another site's name
            return HTTPStatus.FORBIDDEN, _refused("this address belongs to another site"), POLICY
        try:
            found = self.pages.page(self.path)
            if isinstance(found, Path):
                return HTTPStatus.OK, found.read_bytes(), ""
            return HTTPStatus.OK, found.encode(), POLICY
        except (TrocarError, OSError) as error:
            return HTTPStatus.NOT_FOUND, _refused(str(error)), POLICY
        except Exception as error:
            traceback.print_exc()
            problem = f"a mistake in Trocar or in a plugin ({type(error).__name__}: {error}); the terminal says where"
            return HTTPStatus.INTERNAL_SERVER_ERROR, _refused(problem), POLICY

    def _answer(self, status: HTTPStatus, body: bytes, policy: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if policy:
            self.send_header("Content-Security-Policy", policy)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""


def _refused(sentence: str) -> bytes:
    said = f"<p class=warning>{escape(sentence[:1].upper() + sentence[1:])}.</p>"
    return document("Not shown", [], [said, f"<p>{link(addresses.ALL, 'All runs')}</p>"]).encode()
