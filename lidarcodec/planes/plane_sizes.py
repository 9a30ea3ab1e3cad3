"""How many bytes of a PLANES section each plane takes.

>>> import numpy as np
>>> from lidarcodec.planes.plane_section import PlaneKind, encode_plane_section
>>> from lidarcodec.sensors.images import Plane
>>> forms = (Plane("range", 16, "range"), Plane("intensity", 8, "attribute", "range"))
>>> planes = {"range": np.ones((2, 5), np.uint16), "intensity": np.ones((2, 5), np.uint8)}
>>> section = encode_plane_section(PlaneKind.PLAIN, forms, planes, np.zeros(2, np.int32), 1)
>>> plane_sizes(section, 5)
{'range': 20, 'intensity': 10}
"""

from __future__ import annotations

from typing import Final

from lidarcodec.entropy.plane_coder import form_table, in_order
from lidarcodec.entropy.varint import VarintReader
from lidarcodec.planes.plane_section import PlaneKind, read_head
from lidarcodec.planes.value_tables import coded_forms

_ATTRIBUTE: Final = 2
_CONSTANT, _SPARSE = 0, 3
_BEAMS, _COLUMNS, _MOTION = 1, 2, 4
"""Marks of a view."""
_ANY: Final = (1 << 32) - 1


def plane_sizes(section: bytes, columns: int) -> dict[str, int] | None:
    """Bytes of each plane's own numbers, without heads; None if all planes are in one stream.

    columns: of the planes. Raises SectionError or TruncatedError for a section that is damaged.
    """
    head = read_head(section)
    forms = coded_forms(head.forms, head.tables)
    if head.kind == PlaneKind.PLAIN:
        return {form.name: head.rows * columns * form.dtype.itemsize for form in forms}
    if head.kind == PlaneKind.ZSTD:
        return None
    reader = VarintReader(section[head.size :])
    reader.byte()
    if head.kind == PlaneKind.FOLLOWING:
        for _ in range(2 * reader.varint(columns)):
            reader.varint(_ANY)
        _pass_view(reader, head.rows, columns)
    ordered = in_order(forms)
    sizes = {}
    for number, (form, (role, _, _, like)) in enumerate(zip(ordered, form_table(ordered).tolist(), strict=True)):
        sizes[form.name] = _size(reader, attribute=role == _ATTRIBUTE, like_another=like != number)
    return sizes


def _pass_view(reader: VarintReader, rows: int, columns: int) -> None:
    """Read over the view: docs/wire-format-planes.md, "Motion"."""
    marks = reader.byte()
    if marks & _BEAMS:
        for _ in range(2 * rows):
            reader.varint(_ANY)
    if marks & _COLUMNS:
        reader.varint(_ANY)
        for _ in range(2 * reader.varint(columns)):
            reader.varint(_ANY)
    if marks & _MOTION:
        for _ in range(6):
            reader.varint(_ANY)


def _size(reader: VarintReader, *, attribute: bool, like_another: bool) -> int:
    """Bytes of a plane's stream, from its head: docs/wire-format-planes.md, "Bytes"."""
    way = reader.byte()
    if attribute and not like_another:
        reader.varint(_ANY)  # the unit
    if way in (_CONSTANT, _SPARSE):
        reader.varint(_ANY)  # the usual number
    if way == _CONSTANT:
        return 0
    if attribute:
        reader.byte()  # the plane that it is in proportion to
    return reader.varint(_ANY)
