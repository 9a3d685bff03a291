"""Reading of JSON and NumPy files: nothing that a file claims is trusted before it is checked."""

from __future__ import annotations

import json
import math
import struct
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import BadFile, TrocarError

MAX_BYTES = 1 << 30
"""Maximum size of a file's unpacked content; a file that claims more is refused before anything is allocated."""

END_BYTES = 22 + 65535
"""Maximum size of a zip's last record, with the longest comment; it states how long the list of members is."""
MAX_LIST_BYTES = 8 << 20
"""Maximum size of a zip's list of members: images with depth for hours; a longer one could take forever to read."""

UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, RecursionError, NotImplementedError, RuntimeError),
    *(SyntaxError, TokenError, zipfile.BadZipFile, zlib.error),
)
"""Errors that zip, JSON and NumPy raise on files that are damaged or not ours."""


def parsed_json(text: str | bytes) -> Any:
    """Return the values of a JSON text.

    Raises:
        ValueError: it is not JSON, or nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("JSON is nested too deep") from None


def read_json(path: str | Path) -> Any:
    """Return the values in a JSON file; raises OSError, or ValueError if it is not JSON."""
    return parsed_json(Path(path).read_bytes())


def require_short_list(path: str | Path) -> None:
    """Raise TrocarError if a zip claims more members than any file of numbers has, before the list is read."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - END_BYTES))
            end = file.read()
    except OSError:
        return  # the reader of the file gives a better message
    place = end.rfind(b"PK\5\6")
    if place < 0 or len(end) < place + 22:
        return
    members, list_bytes = struct.unpack_from("<HL", end, place + 10)
    if list_bytes > MAX_LIST_BYTES:
        raise BadFile(
            path,
            f"is a zip whose list of members alone is {list_bytes >> 20} MB long ({members} or more)",
            "it is no file of numbers",
        )


def read_arrays(path: str | Path) -> dict[str, NDArray[Any]]:
    """Return the arrays in an ``.npz`` by name, or the one in an ``.npy`` under the empty name.

    Raises:
        OSError: it cannot be read.
        ValueError: it is neither, it is damaged, an array is not what its header claims, or holds Python objects.
        TrocarError: it is larger, or a zip of more members, than any file of numbers.
    """
    path = Path(path)
    require_short_list(path)
    if path.stat().st_size > MAX_BYTES:
        raise _too_large(path)
    if not zipfile.is_zipfile(path):
        return {"": array_of(path.read_bytes())}
    try:
        with zipfile.ZipFile(path) as file:
            members = [member for member in file.infolist() if member.filename.endswith(".npy")]
            if sum(member.file_size for member in members) > MAX_BYTES:
                raise _too_large(path)
            return {member.filename.removesuffix(".npy"): array_of(file.read(member)) for member in members}
    except (OSError, TrocarError):
        raise
    except UNREADABLE as error:
        raise ValueError(str(error)) from None


def _too_large(path: Path) -> TrocarError:
    return BadFile(path, f"holds more than {MAX_BYTES >> 20} MB", "give a part of it", kind="file")


def read_numbers(path: str | Path, what: str, name: str = "") -> NDArray[np.float64]:
    """Return the numbers in an ``.npy``, or in an ``.npz``'s array of this name; errors call them ``what``.

    Raises:
        BadFile: there is no such file, or it holds no such numbers.
    """
    path, remedy = Path(path), f"give a .npy {'or .npz' if name else 'file'} with {what}"
    if not path.is_file():
        raise BadFile(path, "is a folder" if path.is_dir() else "does not exist", remedy, kind="file")
    try:
        arrays = read_arrays(path)
        if not arrays.keys() & {"", name}:
            raise BadFile(path, f"holds {sorted(arrays)} but no array {name!r}", remedy, kind="file")
        return arrays["" if "" in arrays else name].astype(np.float64, casting="same_kind")
    except TrocarError:
        raise
    except (OSError, ValueError, TypeError):
        raise BadFile(path, "cannot be read as numbers", remedy, kind="file") from None


def array_of(data: bytes) -> NDArray[Any]:
    """Return the array in the bytes of an ``.npy``, after a check of its header against the number of bytes.

    Raises:
        ValueError: it is not an .npy, is not what its header claims, or holds Python objects.
    """
    buffer = BytesIO(data)
    try:
        version = np.lib.format.read_magic(buffer)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(buffer)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(buffer)
        else:
            raise ValueError("an .npy of another version")
    except UNREADABLE as error:
        raise ValueError(str(error)) from None
    claimed = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or any(length < 0 for length in shape) or claimed != len(data) - buffer.tell():
        raise ValueError("an .npy that is not what it claims")
    if not dtype.itemsize:
        return np.zeros(shape, dtype)
    flat = np.frombuffer(data, dtype, offset=buffer.tell())
    return flat.reshape(shape, order="F" if fortran else "C").copy()
