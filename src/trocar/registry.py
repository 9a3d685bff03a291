"""Tables of things that can be chosen by name: built in, from other packages, or from a user's file."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from trocar.errors import BadFile, InvalidInput, TrocarError, UnknownName

T = TypeVar("T")


@dataclass(frozen=True)
class Lazy:
    """Something that is imported when it is first used: ``package.module:name``."""

    where: str

    def load(self) -> Any:
        """Return it."""
        module, _, name = self.where.partition(":")
        return getattr(import_module(module), name)


def loaded(thing: Any) -> Any:
    """Return a thing, imported now if it is :class:`Lazy`."""
    return thing.load() if isinstance(thing, Lazy) else thing


class Registry(Mapping[str, T], Generic[T]):
    """All named things of one kind.

    Names come from three places: the table given here, the entry points of installed packages (group ``group`` in
    their ``pyproject.toml``), and calls of :meth:`register`, such as in a file given with ``--plugin``.

    Args:
        what: the kind in words, for error messages: ``"planner"``.
        group: name of the entry points' group.
        builtin: name to thing, or :class:`Lazy` where importing it is expensive.
        check: called with name and value when one is registered or lazily loaded; raises if it cannot be used.

    Attributes:
        listeners: called with each name that is registered later.
    """

    def __init__(
        self,
        what: str,
        group: str,
        builtin: Mapping[str, T | Lazy] | None = None,
        *,
        check: Callable[[str, Any], None] | None = None,
    ):
        self.what, self.group, self._check = what, group, check
        self._known: dict[str, Any] = dict(builtin or {})
        self.listeners: list[Callable[[str], object]] = []

    @cached_property
    def _installed(self) -> dict[str, Any]:
        return {point.name: Lazy(point.value) for point in entry_points(group=self.group)}

    def __getitem__(self, name: str) -> T:
        table = self._known if name in self._known else self._installed
        if isinstance(table[name], Lazy):
            found = table[name].load()
            if self._check is not None:
                self._check(name, found)
            table[name] = found
        return table[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self._known, **self._installed})

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._installed

    def pick(self, name: str) -> T:
        """Return the thing of this name.

        Raises:
            TrocarError: there is none; the message lists the available names.
        """
        if name not in self:
            raise UnknownName(self.what, name, self)
        return self[name]

    def register(self, name: str, thing: T) -> T:
        """Add your own thing under a name that is still free, and return it."""
        if not (isinstance(name, str) and name):
            raise InvalidInput(f"a {self.what}", f"is registered as {name!r}", "give it a name")
        if name in self:
            raise InvalidInput(f"{self.what} {name!r}", "is already registered", "register yours under another name")
        if self._check is not None and not isinstance(thing, Lazy):
            self._check(name, thing)
        self._known[name] = thing
        for listener in self.listeners:
            listener(name)
        return thing

    def forget(self, name: str) -> None:
        """Remove a name that :meth:`register` added (for tests)."""
        self._known.pop(name)


PLUGIN_MODULE = "trocar_plugin_"
"""Prefix of the module name of a file given with ``--plugin``."""

_LOADED: dict[str, str] = {}


def _line_of(error: BaseException, file: Path) -> str:
    """Return in words on which line of a file an error arose; empty if unknown."""
    if isinstance(error, SyntaxError):
        return ""  # its message names the line
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    return f", line {lines[-1]}" if lines and lines[-1] else ""


def load_plugin(path: str | Path) -> str:
    """Run a Python file that registers things, once, and return the SHA-256 of its text.

    Raises:
        TrocarError: there is no such file, or it raises an error.
    """
    file = Path(path).resolve()
    if not file.is_file() or file.suffix != ".py":
        raise BadFile(path, "is not a Python file", "give one that registers what it adds", kind="plugin")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    if _LOADED.get(str(file)) == digest:
        return digest
    load_file(path, f"{PLUGIN_MODULE}{file.stem}_{digest[:8]}", kind="plugin")  # others may have the same file name
    _LOADED[str(file)] = digest
    return digest


def load_file(path: str | Path, name: str, *, kind: str) -> ModuleType:
    """Run a Python file as the module of this name, and return it.

    Raises:
        BadFile: it cannot be read, or raises an error.
    """
    file = Path(path).resolve()
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None  # it is a .py file
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickle look their module up
    try:
        spec.loader.exec_module(module)
    except TrocarError as error:
        raise BadFile(path, f"is refused{_line_of(error, file)}: {error}", kind=kind) from error
    except (Exception, SystemExit) as error:
        problem = f"cannot be loaded{_line_of(error, file)}: {type(error).__name__}: {error}"
        raise BadFile(path, problem, kind=kind) from error
    return module
