"""A decoder of planes in pure Python, after docs/wire-format-planes.md: for reading and for tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tests.reference.plane_cells import ATTRIBUTE, CONSTANT, SPARSE, Form, Ints, PlaneDecoder
from tests.reference.plane_following import NOTHING, FollowingDecoder, Trace
from tests.reference.plane_motion import Moved, View
from tests.reference.plane_rows import read_varint
from tests.reference.wide_coder import WideReader

__all__ = ["Form", "Head", "Memory", "decode", "decode_next", "read_heads"]


class Head(NamedTuple):
    """How a plane is coded."""

    way: int
    unit: int
    constant: int
    mate: int
    size: int


def read_heads(data: bytes, forms: list[Form], at: int = 1) -> tuple[list[Head], int]:
    """The heads, and where the streams begin."""

    def varint() -> int:
        nonlocal at
        value, at = read_varint(data, at)
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


class Memory:
    """What goes on from frame to frame in the following kind."""

    def __init__(self) -> None:
        self.of: tuple[int, list[Form]] | None = None
        self.planes: list[FollowingDecoder] = []
        self.traces: list[list[list[Trace]]] = []
        self.view = View()


def decode_next(
    memory: Memory, data: bytes, shape: tuple[int, int], forms: list[Form], shift: Ints, step: int
) -> list[npt.NDArray[np.int64]]:
    """The planes of sound bytes of the following kind."""
    if memory.of != (shape[0], forms):
        memory.__init__()  # type: ignore[misc]
    memory.of = (shape[0], forms)
    count, at = read_varint(data, 1)
    places: Ints = []
    for _ in range(count):
        columns, at = read_varint(data, at)
        first, at = read_varint(data, at)
        places += [(first + i) % len(memory.traces[0][0]) for i in range(columns)]
    at = memory.view.read(data, at, *shape)
    moved: dict[int, dict[tuple[int, int], Moved]] = {}
    for number, form in enumerate(forms) if memory.view.motion else ():
        if form.role != ATTRIBUTE:
            means = [[trace.mean for trace in row] for row in memory.traces[number]]
            moved[number] = memory.view.moved(means, 8 * ((1 << form.bits) - 1))
    heads, at = read_heads(data, forms, at)
    planes = []
    for number, (form, head) in enumerate(zip(forms, heads, strict=True)):
        learned = memory.planes[number] if memory.planes else None
        most = most_of(form, head, step)
        planes.append(FollowingDecoder(form, shape[1], head.way, head.constant, most, learned))
        if head.way != CONSTANT:
            planes[-1].begin(WideReader(data[at : at + head.size]))
        at += head.size
        kin = [of for of, one in enumerate(forms[:number]) if one.role == ATTRIBUTE and one.of == form.of]
        kin = [head.mate] if head.mate != 255 else [of for of in kin if heads[of].way != CONSTANT]
        planes[-1].kin = planes[kin[0]] if kin else None
    assert at == len(data)
    images = [np.zeros(shape, np.int64) for _ in forms]
    traces = [[[Trace()] * shape[1] for _ in range(shape[0])] for _ in forms]
    for row in range(shape[0]):
        for number, (form, plane, head) in enumerate(zip(forms, planes, heads, strict=True)):
            plane.start_row(row)
            for x in range(shape[1]) if places else ():
                column = (x - shift[row]) % shape[1]
                trace = memory.traces[number][row][places[column]]
                of = moved.get(number if form.role != ATTRIBUTE else form.of, {}).get((row, column))
                if of is not None:
                    trace = memory.traces[number][of.source[0]][of.source[1]]
                    trace = trace._replace(mean=of.mean) if form.role != ATTRIBUTE else trace
                expected = number_of(form, head, step, (trace.mean + 4) // 8)
                plane.traces[x] = trace
                plane.was[x] = NOTHING if form.role != ATTRIBUTE and trace.mean == 0 else expected
            like = planes[form.like] if form.like != number else None
            mate = planes[head.mate] if head.mate != 255 else None
            for x in range(shape[1]):
                n = plane.cell(x, planes[form.of], like, mate)
                column, value = (x - shift[row]) % shape[1], value_of(form, head, step, n)
                images[number][row, column] = value
                traces[number][row][column] = plane.taken(x, n, value)
    for plane in planes:
        if plane.way != CONSTANT:
            plane.stream.finish()
    memory.planes, memory.traces = planes, traces
    return images


def most_of(form: Form, head: Head, step: int) -> int:
    """M."""
    largest = (1 << form.bits) - 1
    if form.role == ATTRIBUTE:
        return largest // head.unit
    return largest if step == 1 else 1 + (largest + (step - 1) // 2) // step


def value_of(form: Form, head: Head, step: int, n: int) -> int:
    """The value of a number."""
    if form.role == ATTRIBUTE:
        return n * head.unit
    if step == 1 or n == 0:
        return n
    return ((step - 1) // 2 + 1) // 2 if n == 1 else min((n - 1) * step, (1 << form.bits) - 1)


def number_of(form: Form, head: Head, step: int, value: int) -> int:
    """The number of a value."""
    if form.role == ATTRIBUTE:
        return value // head.unit
    return value if step == 1 or value == 0 else 1 + (value + (step - 1) // 2) // step


def decode(
    data: bytes, shape: tuple[int, int], forms: list[Form], shift: Ints, step: int
) -> list[npt.NDArray[np.int64]]:
    """The planes of sound bytes."""
    heads, at = read_heads(data, forms)
    planes = []
    for form, head in zip(forms, heads, strict=True):
        most = most_of(form, head, step)
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
                images[number][row, (x - shift[row]) % shape[1]] = value_of(form, head, step, n)
    for plane in planes:
        if plane.way != CONSTANT:
            plane.stream.finish()
    return images
