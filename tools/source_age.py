"""Whether the sources of a figure have changed since it was measured; git names the files if it can."""

from __future__ import annotations

import ast
import hashlib
import io
import shutil
import subprocess
import tokenize
from collections.abc import Sequence
from pathlib import Path

from declared_figures import Measurement, Record
from trocar.errors import TrocarError

SHOWN = 3
"""Number of changed files that are named."""


def digest_of(root: Path, sources: Sequence[str]) -> str:
    """Return a digest of all source files; comments and docstrings of programs do not count.

    Raises:
        TrocarError: there is no file under one of the names.
    """
    left_out = [root / name.removeprefix("!") for name in sources if name.startswith("!")]
    found: set[Path] = set()
    for name in sources:
        path = root / name
        if not name.startswith("!"):
            files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
            if not files:
                raise TrocarError(f"source {name!r} does not exist; mend docs/figures/*.toml")
            found.update(file for file in files if "__pycache__" not in file.parts)
    whole = hashlib.sha256()
    for file in sorted(found):
        if not any(file.is_relative_to(other) for other in left_out):
            whole.update(f"{file.relative_to(root).as_posix()}\0".encode())
            content = _program(file.read_text(encoding="utf-8")).encode() if file.suffix == ".py" else file.read_bytes()
            whole.update(hashlib.sha256(content).digest())
    return whole.hexdigest()[:16]


def commit_of(root: Path, sources: Sequence[str]) -> str:
    """Return the present commit, which contains the sources as they are.

    Raises:
        TrocarError: they are not committed.
    """
    changed = _git(root, "status", "--porcelain", "--", *_pathspecs(sources))
    commit = _git(root, "rev-parse", "--short", "HEAD")
    if changed is None or not commit:
        raise TrocarError("figures are measured in a git checkout, so that everybody can find the code; clone it")
    if changed:
        names = ", ".join(line[3:] for line in changed.splitlines()[:SHOWN])
        raise TrocarError(f"{names} is not committed, so that nobody could tell what was measured; commit first")
    return commit.strip()


def unpack(root: Path, commit: str, folder: Path) -> bool:
    """Write the files of a commit into a folder, unless it is there; return whether git has the commit."""
    if folder.is_dir():
        return True
    folder.parent.mkdir(parents=True, exist_ok=True)
    archive, part = folder.with_suffix(".tar"), folder.with_suffix(".part")
    if _git(root, "archive", f"--output={archive}", commit) is None:
        return False
    shutil.rmtree(part, ignore_errors=True)
    shutil.unpack_archive(archive, part, filter="data")
    archive.unlink()
    part.rename(folder)  # only once it is whole: what was interrupted is written anew
    return True


def why_older(root: Path, measurement: Measurement, record: Record) -> str:
    """Return which sources have changed since a measurement; empty if none."""
    if record.digest == digest_of(root, measurement.sources):
        return ""
    measured = f"measured on {record.date} at {record.commit}"
    changed = _git(root, "diff", "--name-only", record.commit, "--", *_pathspecs(measurement.sources))
    if changed is None:
        return f"{measured}, which this clone does not have, from other sources"
    names = changed.split()
    more = " and more" if len(names) > SHOWN else ""
    return f"{measured}; since then have changed: {', '.join(names[:SHOWN])}{more}"


def _program(text: str) -> str:
    """Return a program without docstrings, comments and empty lines; other text unchanged.

    They are cut out of the text. Text written anew from the syntax tree would depend on the version of Python.
    """
    try:
        tree = ast.parse(text)
        tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    except (SyntaxError, tokenize.TokenError):
        return text
    lines = text.split("\n")
    for token in tokens:
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and _is_text(node) and node.end_lineno:
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip())


def _is_text(node: ast.stmt) -> bool:
    """Return whether a statement is only a string: a docstring, also of a constant."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _pathspecs(sources: Sequence[str]) -> list[str]:
    return [f":(exclude){name[1:]}" if name.startswith("!") else name for name in sources]


def _git(root: Path, *words: str) -> str | None:
    """Return git's output; None if there is no git, no checkout, or no such commit."""
    try:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout if done.returncode == 0 else None
