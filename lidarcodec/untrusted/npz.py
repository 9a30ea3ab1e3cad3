"""The one reader of NumPy's files, `.npz` and `.npy`, that come from elsewhere.

It takes what `numpy.savez` and `savez_compressed` write. What an array declares is compared with its budget and with
what is there before any memory is taken for it; nothing is unpickled.

>>> import io
>>> file = io.BytesIO()
>>> np.savez(file, stamps=np.arange(3))
>>> read_npz(file, ("stamps",), most_bytes=1000)["stamps"]
array([0, 1, 2])
"""

from __future__ import annotations

import math
import warnings
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import largest
from lidarcodec.files.regular import open_regular

MAX_DIRECTORY: Final = 1 << 18
"""Bytes of the list of what a file holds: some 3,000 arrays."""
_PLAIN: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_END, _END_64, _LOCATOR_64 = b"PK\5\6", 22, 20
_COMMENT: Final = 1 << 16
_LONG_END: Final = 56

Arrays = dict[str, npt.NDArray[Any]]


class ArraysRefusedError(ValueError):
    """No file of arrays, or one beyond its budget; the text completes "cannot read FILE: ..."."""


def read_npz(file: Path | IO[bytes], wanted: Collection[str] | None = None, *, most_bytes: int) -> Arrays:
    """The arrays of a file by name, those that are `wanted` and there, or all; together at most `most_bytes`.

    Raises OSError, ArraysRefusedError.
    """
    if isinstance(file, Path):
        with open_regular(file) as opened:
            return read_npz(opened, wanted, most_bytes=most_bytes)
    try:
        with check_archive(file, most_bytes) as archive:
            names = {name: name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")}
            chosen = [name for name, array in names.items() if wanted is None or array in wanted]
            sizes = {name: archive.getinfo(name).file_size for name in chosen}
            _check_fits("arrays", sum(sizes.values()), most_bytes)
            found: Arrays = {}
            for name, size in sizes.items():
                with archive.open(name) as member:
                    found[names[name]] = _array(member, size)
            return found
    except ArraysRefusedError:
        raise
    except (ValueError, LookupError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, OverflowError) as error:
        raise ArraysRefusedError(f"it is not a file of arrays: {_first_line(error)}") from None
    except NotImplementedError:  # a compression that is none of ours
        raise ArraysRefusedError("its compression method is not supported") from None


def read_npy(path: Path, kind: str = "arrays") -> npt.NDArray[Any]:
    """The array of a `.npy` file. Raises OSError, ArraysRefusedError."""
    most = largest(kind) or 0
    with open_regular(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        _check_fits("file", size, most)
        try:
            return _array(file, size)
        except (ValueError, EOFError, OverflowError) as error:
            raise ArraysRefusedError(f"it is not an array: {_first_line(error)}") from None


def check_archive(file: IO[bytes], most_bytes: int, *, stored: bool = False) -> zipfile.ZipFile:
    """An archive whose list of members is short, and that is not larger than `most_bytes`.

    Members may expand unless they must be `stored`: who reads one compares its size before.
    Raises ArraysRefusedError, zipfile.BadZipFile.
    """
    size = file.seek(0, 2)
    _check_fits("file", size, most_bytes)
    begin = max(0, size - _COMMENT - _END_64 - _LOCATOR_64 - _LONG_END)
    file.seek(begin)
    tail = file.read()
    end = tail.rfind(_END)
    if end < 0 or end + _END_64 > len(tail):
        raise ArraysRefusedError("it is not an archive, or its end is missing")
    listed = int.from_bytes(tail[end + 12 : end + 16], "little")
    if b"PK\6\7" in tail[max(0, end - _LOCATOR_64) : end]:  # a longer form of the end lies before, and counts
        long = tail[max(0, end - _LOCATOR_64 - _LONG_END) : end - _LOCATOR_64]
        listed = int.from_bytes(long[40:48], "little") if long[:4] == b"PK\6\6" else MAX_DIRECTORY + 1
    if listed > MAX_DIRECTORY:
        raise ArraysRefusedError("it lists more members than a file of arrays can have")
    archive = zipfile.ZipFile(file)
    plain = _PLAIN[:1] if stored else _PLAIN
    if any(one.compress_type not in plain or one.flag_bits & 1 for one in archive.infolist()):
        raise ArraysRefusedError("it is encrypted, or its compression method is not supported")
    if len(set(archive.namelist())) != len(archive.namelist()):
        raise ArraysRefusedError("two of its members have the same name")
    return archive


def _check_fits(what: str, size: int, most: int) -> None:
    if size > most:
        raise ArraysRefusedError(f"the {what} would take {size:,} bytes of memory; at most {most:,} are allowed")


def _array(file: IO[bytes], size: int) -> npt.NDArray[Any]:
    """size: bytes that the file has, with its head"""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of texts that Python's parser warns of
        major, _ = np.lib.format.read_magic(file)
        if major not in (1, 2):
            raise ArraysRefusedError("an array has an unknown format version")
        read: Any = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
        shape, by_columns, dtype = read(file)
    if dtype.hasobject or dtype.itemsize == 0:
        raise ArraysRefusedError("an array is empty or holds Python objects, which are never read")
    declared = math.prod(shape) * dtype.itemsize
    if any(side < 0 for side in shape) or declared != size - file.tell():
        raise ArraysRefusedError(f"an array announces {shape} of {dtype}, which does not match its size")
    data = bytearray(declared)
    view, at = memoryview(data), 0
    while at < declared:
        part = file.read(min(declared - at, 1 << 20))
        if not part:
            raise ArraysRefusedError("an array is shorter than announced")
        view[at : at + len(part)] = part
        at += len(part)
    found = np.frombuffer(data, dtype)
    return found.reshape(shape[::-1]).T if by_columns else found.reshape(shape)


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
