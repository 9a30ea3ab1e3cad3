"""Value tables: attributes of few values are sent as places in a table, one of up to 256 values for one or more planes.

A plane with a table holds places in cells whose range plane has a return, and 0 in all others; their value is 0. The
format is docs/wire-format-other-sensors.md, section "PLANES".

>>> table = np.array([3, 90, 700], np.uint16)
>>> places_of(np.array([[0, 90, 700, 3]], np.uint16), table, np.array([[False, True, True, True]])).tolist()
[[0, 1, 2, 0]]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import Plane, Unsigned

MOST_VALUES: Final = 256
_BITS: Final = 8

Mask = npt.NDArray[np.bool_]


def places_of(image: Unsigned, table: Unsigned, returns: Mask) -> npt.NDArray[np.uint8]:
    """(H, W) uint8, places in a table; 0 without a return. image: (H, W), of values of the table; table: ascending."""
    return np.where(returns, np.searchsorted(table, image), 0).astype(np.uint8)


def with_places(
    forms: Sequence[Plane], planes: Mapping[str, Unsigned], tables: Mapping[str, Unsigned]
) -> tuple[list[Plane], dict[str, Unsigned]]:
    """Forms and planes as they are coded: planes with a table are places, of 8 bits. tables: by name of the plane."""
    images = {
        form.name: places_of(planes[form.name], tables[form.name], planes[form.of] > 0)
        if form.name in tables
        else planes[form.name]
        for form in forms
    }
    return coded_forms(forms, tables), images


def coded_forms(forms: Sequence[Plane], tables: Mapping[str, Unsigned]) -> list[Plane]:
    """The forms with which planes are coded."""
    return [form._replace(bits=_BITS) if form.name in tables else form for form in forms]


def put_tables(out: bytearray, forms: Sequence[Plane], tables: Mapping[str, Unsigned]) -> None:
    """Write which planes have which table; planes with equal values share one."""
    numbers: dict[bytes, int] = {}
    kept: list[Unsigned] = []
    of_plane = []
    for form in forms:
        table = tables.get(form.name)
        if table is None:
            of_plane.append(0)
            continue
        key = table.astype("<u4").tobytes()
        if key not in numbers:
            kept.append(table)
            numbers[key] = len(kept)
        of_plane.append(numbers[key])
    put_varint(out, len(kept))
    for table in kept:
        put_varint(out, len(table))
        for difference in np.diff(table.astype(np.int64), prepend=0).tolist():
            put_varint(out, difference)
    out += bytes(of_plane)


def read_tables(reader: VarintReader, forms: Sequence[Plane]) -> dict[str, Unsigned]:
    """The tables by name of the plane: (N,) values each, ascending.

    Raises SectionError or TruncatedError.
    """
    count = reader.varint(len(forms), least=1)
    tables = []
    for _ in range(count):
        size = reader.varint(MOST_VALUES, least=1)
        table = np.cumsum([reader.varint(1 << 20) for _ in range(size)])
        if np.any(np.diff(table) < 1):
            raise SectionError("a table of values that do not ascend")
        tables.append(table)
    found: dict[str, Unsigned] = {}
    for form in forms:
        number = reader.byte()
        if not number:
            continue
        if number > count or form.role != "attribute":
            raise SectionError(f"plane {form.name} with table {number} of {count}, or not an attribute")
        values = tables[number - 1]
        if int(values[-1]) >= 1 << form.bits:
            raise SectionError(f"plane {form.name} has {form.bits} bits, but its table holds {int(values[-1])}")
        found[form.name] = values.astype(form.dtype)
    return found
