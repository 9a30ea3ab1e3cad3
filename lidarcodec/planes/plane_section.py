"""The PLANES section: all images of a frame of another sensor than an HDL-64E. The section describes its planes, so a
reader needs no table of sensors. The format is docs/wire-format-other-sensors.md, section "PLANES".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.plane_coder import PlaneMemory, SensorView, encode_planes
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.planes.value_tables import put_tables, read_tables, with_places
from lidarcodec.sensor_model import MAX_LASERS
from lidarcodec.sensors.images import MAX_CELLS, MAX_PLANES, Plane, PlaneRole, Unsigned
from lidarcodec.units import MAX_COLUMNS

MAX_BITS: Final = 20
MAX_STEP: Final = 40_001
"""Errors of up to 20 m, the largest bound there is, in ranges of 1 mm."""
_ROLES: Final[tuple[PlaneRole, ...]] = ("range", "second range", "attribute")
_MAX_NAME: Final = 16
_LEVEL: Final = 3
_WITH_TABLES: Final = 0x80
_REDUCED: Final = 0x40
"""Bits of the kind."""


class PlaneKind(IntEnum):
    """How a PLANES section is coded."""

    PLAIN = 0
    """Numbers as they are."""
    ZSTD = 1
    """Differences along rows, byte by byte, in a zstd frame."""
    MODELLED = 2
    """By what is learned from the neighbours of each cell (docs/wire-format-planes.md), all contexts."""
    FOLLOWING = 3
    """The same, going on from what frames before taught, with the frame before among the contexts."""
    QUICK = 4
    """As MODELLED with fewer contexts, and of that kind in the bytes."""


class PlaneHead(NamedTuple):
    """What stands in front of the coded planes: kind, rows, step of ranges, what planes there are, `shift` (H,), the
    tables of planes of few values, and whether returns were left out."""

    kind: int
    rows: int
    step: int
    forms: tuple[Plane, ...]
    shift: npt.NDArray[np.int32]
    tables: dict[str, Unsigned]
    reduced: bool
    size: int
    """Bytes of the head."""

    @property
    def exact(self) -> bool:
        """Whether all of the planes are as the sensor sent them, attributes among them."""
        whole = any(form.role == "attribute" for form in self.forms)
        return whole and self.step == 1 and not self.tables and not self.reduced


class Following(NamedTuple):
    """What a frame follows: the memory of its stream, and `runs` and `view` as of `PlaneMemory.encode`."""

    memory: PlaneMemory
    runs: npt.NDArray[np.uint32] | None = None
    view: SensorView | None = None


def encode_plane_section(
    kind: PlaneKind,
    forms: Sequence[Plane],
    planes: Mapping[str, Unsigned],
    shift: npt.NDArray[np.int32],
    step: int,
    tables: Mapping[str, Unsigned] = MappingProxyType({}),
    *,
    reduced: bool = False,
    following: Following | None = None,
) -> bytes:
    """The section. planes: (H, W) each, by name; shift: (H,), as of `encode_planes`; step: odd, quantises the ranges.

    tables: of attributes that have no other values than these where there is a return, (N,) ascending
    reduced: whether returns were left out; following: of kind FOLLOWING; None: the frame begins a stream
    Raises SectionError if the images are larger than a frame may be.
    """
    rows, columns = planes["range"].shape
    _check(rows, columns, len(forms), step)
    marks = _WITH_TABLES * bool(tables) | _REDUCED * reduced
    out = bytearray([(PlaneKind.MODELLED if kind == PlaneKind.QUICK else kind) | marks, rows - 1])
    put_varint(out, step)
    put_varint(out, len(forms))
    names = [form.name for form in forms]
    for form in forms:
        name = form.name.encode()
        out += bytes([_ROLES.index(form.role), form.bits, names.index(form.of), len(name)]) + name
    for number in shift.tolist():
        put_signed(out, number)
    if tables:
        put_tables(out, forms, tables)
        forms, planes = with_places(forms, planes, tables)
    if kind in (PlaneKind.PLAIN, PlaneKind.ZSTD):
        images = [_quantised(planes[form.name], step if form.role != "attribute" else 1) for form in forms]
        parts = [_plain(image, form) if kind == PlaneKind.PLAIN else _rows(image, form)
                 for image, form in zip(images, forms, strict=True)]  # fmt: skip
        data = b"".join(parts)
        return bytes(out) + (data if kind == PlaneKind.PLAIN else compress(data, _LEVEL))
    if kind == PlaneKind.FOLLOWING:
        memory, runs, view = following or Following(PlaneMemory())
        return bytes(out) + memory.encode(forms, planes, shift, step, runs, view)
    return bytes(out) + encode_planes(forms, planes, shift, step, quick=kind == PlaneKind.QUICK)


def read_head(data: bytes) -> PlaneHead:
    """The head of a section.

    Raises SectionError or TruncatedError.
    """
    reader = VarintReader(data)
    marks, rows = reader.byte(), reader.byte() + 1
    kind = marks & ~(_WITH_TABLES | _REDUCED)
    step = reader.varint(MAX_STEP, least=1)
    count = reader.varint(MAX_PLANES, least=1)
    if kind > PlaneKind.FOLLOWING:
        raise SectionError(f"planes of unknown kind {kind}")
    _check(rows, 0, count, step)
    raw = [_raw_form(reader) for _ in range(count)]
    forms = tuple(_form(number, raw) for number in range(count))
    if len({form.name for form in forms}) < count or forms[0].name != "range" or forms[0].role != "range":
        raise SectionError("planes whose names occur twice, or whose first is not the ranges")
    shift = np.array([reader.signed(MAX_COLUMNS) for _ in range(rows)], np.int32)
    tables = read_tables(reader, forms) if marks & _WITH_TABLES else {}
    return PlaneHead(kind, rows, step, forms, shift, tables, bool(marks & _REDUCED), reader.offset)


def decode_plane_section(data: bytes, columns: int) -> dict[str, Unsigned]:
    """The planes of a section that begins a stream, by name: (H, `columns`) each, read-only.

    Raises SectionError or TruncatedError. Takes no more memory than the largest frame needs.
    """
    return dict(_native.decode_plane_section(data, columns, decompress))


def _check(rows: int, columns: int, planes: int, step: int) -> None:
    fits = 1 <= rows <= MAX_LASERS and 0 <= columns <= MAX_COLUMNS and rows * columns * planes <= MAX_CELLS
    if not fits or planes > MAX_PLANES:
        raise SectionError(f"{planes} planes of {rows} x {columns}: the limit is {MAX_CELLS} numbers in a frame")
    if not (1 <= step <= MAX_STEP and step % 2):
        raise SectionError(f"range step {step} is not an odd number from 1 to {MAX_STEP}")


def _raw_form(reader: VarintReader) -> tuple[int, int, int, str]:
    role, bits, of = reader.byte(), reader.byte(), reader.byte()
    name = reader.take(reader.varint(_MAX_NAME, least=1))
    if role >= len(_ROLES) or not 1 <= bits <= MAX_BITS:
        raise SectionError(f"a plane of unknown role {role}, or of {bits} bits")
    if not name.isascii() or not all(chr(byte).isalnum() or byte == ord("_") for byte in name):
        raise SectionError(f"a plane's name that is not of letters, digits and underscores: {name!r:.60}")
    return role, bits, of, name.decode()


def _form(number: int, raw: list[tuple[int, int, int, str]]) -> Plane:
    role, bits, of, name = raw[number]
    if of >= len(raw) or (_ROLES[role] == "attribute" and _ROLES[raw[of][0]] == "attribute"):
        raise SectionError(f"plane {name} belongs to plane {of}, which is not one of ranges")
    return Plane(name, bits, _ROLES[role], raw[of][3])


def _quantised(image: Unsigned, step: int) -> Unsigned:
    """Indices of ranges, one more than in docs/wire-format.md ("Range steps") for returns, 0 for none."""
    if step == 1:
        return image
    indices = (image.astype(np.uint32) + np.uint32(step // 2)) // np.uint32(step) + np.uint32(1)
    return np.where(image > 0, indices, np.uint32(0)).astype(image.dtype)


def _plain(image: Unsigned, form: Plane) -> bytes:
    return image.astype(form.dtype.newbyteorder("<")).tobytes()


def _rows(image: Unsigned, form: Plane) -> bytes:
    """Differences along each row, modulo the type's width, as planes of bytes from the lowest on."""
    steps = image.astype(form.dtype, copy=True)
    steps[:, 1:] -= image[:, :-1].astype(form.dtype, copy=False)
    return steps.astype(form.dtype.newbyteorder("<")).view(np.uint8).reshape(-1, form.dtype.itemsize).T.tobytes()
