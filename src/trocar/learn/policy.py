"""Policies from outside: a function in a module or a file, a folder, a server; each answers in time or is refused."""

from __future__ import annotations

import base64
import hashlib
import json
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from trocar.errors import BadFile, InvalidInput, TrocarError
from trocar.registry import load_file

Policy = Callable[[Mapping[str, Any]], Any]
"""A function that returns the action for an observation; None: the policy is done."""
SERVER = "tcp://"
MOST_BYTES = 1 << 20
"""Largest answer of a server (one action)."""
IN_FOLDER = "policy.py"
WHAT = "give a folder with a policy.py, FILE.py:function, module:function, or tcp://HOST:PORT"


def policy_digest(policy: str) -> str:
    """Return a digest of a policy's files; empty for a module or a server.

    Raises:
        BadFile: the file does not exist, or the folder has no ``policy.py``.
        InvalidInput: ``policy`` has none of the forms that ``load_policy`` takes.
    """
    path = Path(policy) if Path(policy).is_dir() else Path(policy.rpartition(":")[0] or policy)
    if policy.startswith(SERVER) or not (path.suffix == ".py" or Path(policy).exists()):
        _parts(policy)
        return ""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    if not files or (path.is_dir() and path / IN_FOLDER not in files):
        raise BadFile(path, f"has no {IN_FOLDER}" if path.is_dir() else "does not exist", WHAT, kind="policy")
    if path.is_file():
        _parts(policy)
    digest = hashlib.sha256()
    for file in files:
        if "__pycache__" not in file.parts:
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def load_policy(policy: str, digest: str = "", timeout_s: float = 10.0) -> Iterator[Policy]:
    """Yield a policy that is ready for one trial.

    Args:
        policy: ``DIR`` with a ``policy.py`` whose ``make(folder)`` returns the policy; ``FILE.py:name`` or
            ``module:name`` of a function of an observation, or of a class whose instances are such functions; or
            ``tcp://HOST:PORT`` of a server (``tcp://[::1]:PORT`` by IPv6). The server reads one JSON object per line,
            ``{"observation": {name: numbers}}`` (images as ``{"shape": [...], "data": base64}``), and answers
            ``{"action": [...]}``, or ``{"action": null}`` when done. ``{"reset": true}`` begins a trial; it does not
            answer that.
        digest: required digest of its files; empty: any.
        timeout_s: limit for loading it, and for each answer.

    Raises:
        InvalidInput: there is no such policy, or it has changed; when called: it raised an error or did not answer in
            time.
    """
    if digest and policy_digest(policy) != digest:
        raise InvalidInput(f"policy {policy!r}", "has changed since this run began", "choose another --out")
    if policy.startswith(SERVER):
        with _served(policy, timeout_s) as ask:
            yield ask
        return
    worker = _Worker(f"policy {policy!r}", timeout_s)
    found = worker.ask(lambda _: _loaded(policy), {}, "cannot be loaded:")
    try:
        yield lambda seen: worker.ask(found, seen, "raised")
    finally:
        worker.stop()


def _parts(policy: str) -> tuple[str, str]:
    where, colon, name = policy.rpartition(":")
    if not (colon and where and name):
        problem = "names no function" if Path(policy).is_file() else "does not exist"
        raise InvalidInput(f"policy {policy!r}", problem, WHAT)
    return where, name


def _loaded(policy: str) -> Policy:
    """Return a policy from a folder, a file or a module."""
    if Path(policy).is_dir():
        found = _member(_file(Path(policy) / IN_FOLDER), "make", policy)(Path(policy))
    else:
        where, name = _parts(policy)
        module = _file(Path(where)) if where.endswith(".py") else import_module(where)
        found = _member(module, name, policy)
        found = found() if isinstance(found, type) else found
    if not callable(found):
        raise InvalidInput(f"policy {policy!r}", f"is {found!r:.60}", "give a function of an observation")
    return found


def _file(path: Path) -> Any:
    return load_file(path, f"trocar_policy_{path.stem}", kind="policy")


def _member(module: Any, name: str, policy: str) -> Any:
    if not hasattr(module, name):
        raise InvalidInput(f"policy {policy!r}", f"has no {name}", "give it a function of this name")
    return getattr(module, name)


class _Worker:
    """A thread that calls a policy, so that a policy that hangs does not hang the trial."""

    def __init__(self, item: str, timeout_s: float):
        self._item, self._timeout_s = item, timeout_s
        self._work: queue.SimpleQueue[tuple[Policy, Any] | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                self._done.put((work[0](work[1]), None))
            except BaseException as error:
                self._done.put((None, error))

    def ask(self, function: Policy, seen: Any, failed: str) -> Any:
        """Return a function's answer."""
        self._work.put((function, seen))
        try:
            found, error = self._done.get(timeout=self._timeout_s)
        except queue.Empty:
            problem = f"has not answered within {self._timeout_s:g} s"
            raise InvalidInput(self._item, problem, "make it faster, or give it more with --set timeout_s=S") from None
        if isinstance(error, TrocarError):
            raise error
        if error is not None:
            raise InvalidInput(self._item, f"{failed} {type(error).__name__}: {error}", "correct it") from error
        return found

    def stop(self) -> None:
        """End the thread after its current call."""
        self._work.put(None)


@contextmanager
def _served(policy: str, timeout_s: float) -> Iterator[Policy]:
    """Connect to a policy's server."""
    host, port = _address(policy)
    try:
        link = socket.create_connection((host, port), timeout_s)
    except (OSError, UnicodeError) as error:
        raise InvalidInput(f"policy {policy!r}", f"does not answer: {error}", "start its server") from None
    unread = b""
    with link:

        def say(what: Mapping[str, Any]) -> None:
            link.settimeout(timeout_s)
            link.sendall(json.dumps(what).encode() + b"\n")

        def answer() -> bytes:
            """Return the next line; all of it must arrive in time."""
            nonlocal unread
            end_s = time.monotonic() + timeout_s
            while b"\n" not in unread:
                link.settimeout(max(1e-3, end_s - time.monotonic()))
                come = link.recv(MOST_BYTES)
                unread += come
                if not come or len(unread) > MOST_BYTES:
                    break
                if time.monotonic() > end_s:
                    raise TimeoutError
            line, _, unread = unread.partition(b"\n")
            return line

        @contextmanager
        def naming_faults() -> Iterator[None]:
            try:
                yield
            except TimeoutError:
                problem = f"has not answered within {timeout_s:g} s"
                raise InvalidInput(f"policy {policy!r}", problem, "give it more with --set timeout_s=S") from None
            except OSError as error:
                raise InvalidInput(f"policy {policy!r}", f"is gone: {error}", "start its server again") from None

        def ask(seen: Mapping[str, Any]) -> Any:
            with naming_faults():
                say({"observation": {name: _plain(value) for name, value in seen.items()}})
                line = answer()
            try:
                return json.loads(line)["action"]
            except (ValueError, KeyError, TypeError):
                said = line[:60].decode(errors="replace").strip() or "nothing: it has hung up"
                raise InvalidInput(f"policy {policy!r}", f"said {said!r}", 'answer {"action": [...]}') from None

        with naming_faults():
            say({"reset": True})
        yield ask


def _address(policy: str) -> tuple[str, int]:
    """Return host and port of a policy's server; an address of IPv6 is in brackets."""
    with suppress(ValueError):  # no port, or no closing bracket
        parts = urlsplit(policy)
        if parts.hostname and parts.port and parts.netloc == policy.removeprefix(SERVER):
            return parts.hostname, parts.port
    raise InvalidInput(f"policy {policy!r}", "is no address", "give tcp://HOST:PORT, with a port of 1 to 65535")


def _plain(value: np.ndarray) -> Any:
    """Return an array as JSON: vectors as lists, images in base64."""
    if value.ndim == 1:
        return value.tolist()
    return {"shape": list(value.shape), "data": base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()}
