"""A decoder of planes in pure Python, after docs/wire-format-planes.md: for reading and for tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tests.reference.intensity import WideReader
from tests.reference.plane_cells import ATTRIBUTE, CONSTANT, SPARSE, Form, Ints, PlaneDecoder

__all__ = ["Form", "Head", "decode", "read_heads"]


class Head(NamedTuple):
    """How a plane is coded."""

    way: int
    unit: int
    constant: int
    mate: int
    size: int


def read_heads(data: bytes, forms: list[Form]) -> tuple[list[Head], int]:
    """The heads, and where the streams begin."""
    at = 1

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte, at = data[at], at + 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    heads: list[Head] = []
    for number, form in enumerate(forms):
        way, unit, constant, mate, size = data[at], 1, 0, 255, 0
        at += 1
        if form.role == ATTRIBUTE:
            unit = varint() if form.like == number else heads[form.like].unit
        if way in (CONSTANT, SPARSE):
            constant = varint()
        if way != CONSTANT and form.role == ATTRIBUTE:
            mate, at = data[at], at + 1
        if way != CONSTANT:
            size = varint()
        heads.append(Head(way, unit, constant, mate, size))
    return heads, at


def decode(
    data: bytes, shape: tuple[int, int], forms: list[Form], shift: Ints, step: int
) -> list[npt.NDArray[np.int64]]:
    """The planes of sound bytes."""
    half, (heads, at) = (step - 1) // 2, read_heads(data, forms)
    planes = []
    for form, head in zip(forms, heads, strict=True):
        largest = (1 << form.bits) - 1
        most = largest if step == 1 else 1 + (largest + half) // step
        most = largest // head.unit if form.role == ATTRIBUTE else most
        planes.append(PlaneDecoder(form, shape[1], head.way, head.constant, most, quick=data[0] == 2))
        if head.way != CONSTANT:
            planes[-1].begin(WideReader(data[at : at + head.size]))
        at += head.size
    assert at == len(data)
    images = [np.zeros(shape, np.int64) for _ in forms]
    for row in range(shape[0]):
        for number, (form, plane, head) in enumerate(zip(forms, planes, heads, strict=True)):
            plane.start_row(row)
            like = planes[form.like] if form.like != number else None
            mate = planes[head.mate] if head.mate != 255 else None
            for x in range(shape[1]):
                n = plane.cell(x, planes[form.of], like, mate)
                if form.role == ATTRIBUTE:
                    n *= head.unit
                elif step > 1 and n > 0:
                    n = (half + 1) // 2 if n == 1 else min((n - 1) * step, (1 << form.bits) - 1)
                images[number][row, (x - shift[row]) % shape[1]] = n
    for plane in planes:
        if plane.way != CONSTANT:
            plane.stream.finish()
    return images
