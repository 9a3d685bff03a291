"""Files that hold a header, arrays and images: one zip, whose header can be read alone, with everything checked."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import BadFile, InvalidInput
from trocar.files.output import jsonable, mark_zip, writing
from trocar.files.reading import MAX_BYTES, UNREADABLE, array_of, parsed_json, require_short_list

HEADER = "header.json"
BLOBS = "files/"
DATE = (1980, 1, 1, 0, 0, 0)
"""Date of every member, fixed so that the same content gives the same bytes."""
MAX_HEADER_BYTES = 32 << 20
KINDS = "biuf"
"""Kinds of numbers that an array may hold."""


@dataclass(frozen=True, eq=False)
class Archive:
    """The content of an archive.

    Attributes:
        header: JSON values; ``format`` and ``version`` tell what it is.
        arrays: by name.
        blobs: bytes of other files in it, such as images, by name.
    """

    header: dict[str, Any]
    arrays: Mapping[str, NDArray] = field(default_factory=dict)
    blobs: Mapping[str, bytes] = field(default_factory=dict)

    def save(self, path: str | Path) -> Path:
        """Write the file and return its path; the same content gives the same bytes.

        Raises:
            TrocarError: something else is already there.
            MachineError: it cannot be written.
        """
        path, kind = Path(path), str(self.header["format"])
        with writing(path, kind) as draft:
            with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as file:
                text = json.dumps(self.header, sort_keys=True, allow_nan=False, default=jsonable).encode()
                file.writestr(_member(HEADER), text)
                for name, array in sorted(self.arrays.items()):
                    buffer = BytesIO()
                    # column by column: constant columns then compress to almost nothing
                    np.save(buffer, np.asarray(array, order="F"), allow_pickle=False)
                    file.writestr(_member(f"{name}.npy"), buffer.getvalue())
                for name, blob in sorted(self.blobs.items()):
                    file.writestr(_member(BLOBS + name, zipfile.ZIP_STORED), blob)
            mark_zip(draft, kind)
        return path


def read_header(path: str | Path, kind: str, version: int) -> dict[str, Any]:
    """Return an archive's header, without its arrays.

    Raises:
        TrocarError: there is no such file, or it is not of this kind and version.
    """
    with _opened(path, kind) as file:
        return _header(file, path, kind, version)


def read_archive(path: str | Path, kind: str, version: int) -> Archive:
    """Return the whole content of an archive.

    Raises:
        TrocarError: there is no such file, it is not of this kind and version, or it is damaged.
    """
    with _opened(path, kind) as file:
        header = _header(file, path, kind, version)
        if sum(member.file_size for member in file.infolist()) > MAX_BYTES:
            raise BadFile(path, f"claims to unpack to more than {MAX_BYTES >> 20} MB", f"it is not a {kind}")
        arrays: dict[str, NDArray] = {}
        blobs: dict[str, bytes] = {}
        for member in file.infolist():
            name = member.filename
            try:
                if name.startswith(BLOBS):
                    blobs[name.removeprefix(BLOBS)] = file.read(member)
                elif name.endswith(".npy"):
                    array = array_of(file.read(member))
                    if array.dtype.kind not in KINDS:
                        raise ValueError("an .npy that holds no numbers")
                    arrays[name.removesuffix(".npy")] = array
            except UNREADABLE:
                raise BadFile(path, f"is damaged at {name!r}", "make it again") from None
    return Archive(header, arrays, blobs)


@contextmanager
def _opened(path: str | Path, kind: str) -> Iterator[zipfile.ZipFile]:
    """Yield an open zip; raise InvalidInput if it cannot be opened."""
    path = Path(path)
    if path.is_dir():
        raise InvalidInput(f"{str(path)!r}", "is a folder", f"give a file, a {kind}")
    if not path.is_file():
        raise InvalidInput(f"{kind} {str(path)!r}", "does not exist", "give another")
    require_short_list(path)
    try:
        file = zipfile.ZipFile(path)
    except UNREADABLE:
        problem = f"is not a readable {kind}"
        raise InvalidInput(f"{str(path)!r}", problem, "move it away and make it again") from None
    with file:
        yield file


def _header(file: zipfile.ZipFile, path: str | Path, kind: str, version: int) -> dict[str, Any]:
    if HEADER not in file.namelist():
        held = ", ".join(repr(name.removesuffix(".npy"))[1:-1] for name in file.namelist()[:8]) or "nothing"
        raise BadFile(path, f"is not a {kind}, it holds {held}", "give another file")
    try:
        if file.getinfo(HEADER).file_size > MAX_HEADER_BYTES:
            raise ValueError
        header = parsed_json(file.read(HEADER))
        found = header["format"], header["version"]
    except UNREADABLE:
        raise BadFile(path, f"is not a readable {kind}", "move it away and make it again") from None
    if found != (kind, version):
        problem = f"is a {str(found[0])[:40]!r} of version {str(found[1])[:10]}, not a {kind!r} of version {version}"
        raise BadFile(path, problem, "give another file")
    return header


def _member(name: str, compression: int = zipfile.ZIP_DEFLATED) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, DATE)
    info.compress_type = compression
    info.external_attr = 0o644 << 16
    return info
