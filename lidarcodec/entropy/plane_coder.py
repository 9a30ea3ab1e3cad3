"""Planes of a frame as bytes: ranges, second ranges and attributes together. docs/wire-format-planes.md has the format.

Works on all cells, with a return or without: sensors send attributes of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec import _native

Unsigned = npt.NDArray[np.unsignedinteger]

_ROLES = ("range", "second range", "attribute")
"""In the order in which planes are coded: each looks at those before it."""


class PlaneForm(Protocol):
    """What is known of a plane before it is decoded: `lidarcodec.sensors.images.Plane` is one."""

    @property
    def name(self) -> str:
        """A plane named `x2` mostly repeats the plane `x`, if that has as many bits."""

    @property
    def bits(self) -> int:
        """Largest width of its values, 1 to 20."""

    @property
    def role(self) -> str:
        """`range`, `second range` or `attribute`."""

    @property
    def of(self) -> str:
        """The range plane whose returns an attribute describes."""


def encode_planes(
    forms: Sequence[PlaneForm],
    planes: Mapping[str, Unsigned],
    shift: npt.NDArray[np.int32],
    step: int = 1,
    *,
    quick: bool = False,
) -> bytes:
    """Bytes of one plane for each form, (H, W) of unsigned integers.

    shift: (H,) columns: cell (row, x) looks in the direction of column x + shift[row]; any numbers give the planes
    back, right ones give fewer bytes. step: odd; ranges come back at most (step - 1) / 2 off, all else as it is.
    quick: two thirds of the time, about 3 % more bytes; `decode_planes` sees which it was.

    Raises SettingsError if shapes, bits and forms do not fit together.
    """
    ordered = in_order(forms)
    images = [np.ascontiguousarray(planes[form.name]) for form in ordered]
    return _native.encode_planes(images, form_table(ordered), np.ascontiguousarray(shift, np.int32), step, quick)


def decode_planes(
    data: bytes, columns: int, forms: Sequence[PlaneForm], shift: npt.NDArray[np.int32], step: int = 1
) -> dict[str, Unsigned]:
    """The planes of `encode_planes`, (H, columns), in the order of forms: uint8, uint16 or uint32, as their bits need.

    Takes memory for H times `columns` cells a plane: check both before. Raises SectionError or TruncatedError if the
    bytes are damaged, SettingsError if the forms do not fit together.
    """
    ordered = in_order(forms)
    images = _native.decode_planes(data, columns, form_table(ordered), np.ascontiguousarray(shift, np.int32), step)
    return _by_name(forms, ordered, images, step)


class SensorView(NamedTuple):
    """Where a sensor looks. beams: (H, 2) int32, from the top down, how far the beam of each row is up from the horizon
    and, clockwise, aside from the direction of its column, in steps of 2^-20 of a turn; azimuth: (W,) uint16, direction
    of each column, 0.01 degree, clockwise; metre: ranges in a metre."""

    beams: npt.NDArray[np.int32]
    azimuth: npt.NDArray[np.uint16]
    metre: float


class PlaneMemory:
    """What a stream of planes remembers from frame to frame: probabilities, and the frame before. An encoder and a
    decoder have one each; they agree after each frame. A call that raises leaves it empty."""

    def __init__(self) -> None:
        self._native = _native.PlaneMemory()

    def forget(self) -> None:
        """Begin from nothing."""
        self._native.forget()

    def encode(
        self,
        forms: Sequence[PlaneForm],
        planes: Mapping[str, Unsigned],
        shift: npt.NDArray[np.int32],
        step: int = 1,
        runs: npt.NDArray[np.uint32] | None = None,
        view: SensorView | None = None,
    ) -> bytes:
        """Bytes of the next frame; all else as of `encode_planes`.

        runs: (N, 2), numbers of neighbouring columns, and their first column in the frame before; together all columns.
        None: the frame before is not looked at. Of no effect where other planes, or rows, begin.
        view: with it the frame before is moved as the sensor moved, where that helps. Beams that do not fall from row
        to row, or are steeper than 68 degrees, are of no effect.

        Raises SettingsError if shapes, bits, forms and runs do not fit together.
        """
        ordered = in_order(forms)
        images = [np.ascontiguousarray(planes[form.name]) for form in ordered]
        given = np.zeros((0, 2), np.uint32) if runs is None else np.ascontiguousarray(runs, np.uint32)
        beams, azimuth, metre = view or _NO_VIEW
        return self._native.encode(
            images,
            form_table(ordered),
            np.ascontiguousarray(shift, np.int32),
            step,
            given,
            np.ascontiguousarray(beams, np.int32),
            np.ascontiguousarray(azimuth, np.uint16),
            metre,
        )

    def decode(
        self, data: bytes, columns: int, forms: Sequence[PlaneForm], shift: npt.NDArray[np.int32], step: int = 1
    ) -> dict[str, Unsigned]:
        """The planes of the next frame, as of `decode_planes`. Raises as that does."""
        ordered = in_order(forms)
        images = self._native.decode(data, columns, form_table(ordered), np.ascontiguousarray(shift, np.int32), step)
        return _by_name(forms, ordered, images, step)


_NO_VIEW = SensorView(np.zeros((0, 2), np.int32), np.zeros(0, np.uint16), 0.0)


def _by_name(
    forms: Sequence[PlaneForm], ordered: Sequence[PlaneForm], images: Sequence[npt.NDArray[np.uint32]], step: int
) -> dict[str, Unsigned]:
    found = {form.name: _fitting(image, form, step) for form, image in zip(ordered, images, strict=True)}
    return {form.name: found[form.name] for form in forms}


def _fitting(image: npt.NDArray[np.uint32], form: PlaneForm, step: int) -> Unsigned:
    """The image in the type of its bits. The middle of the first step of ranges can have more bits than the plane."""
    top = (1 << form.bits) - 1
    if form.role != "attribute" and (step // 2 + 1) // 2 > top:
        image = np.minimum(image, np.uint32(top))
    return image.astype(_dtype(form.bits))


def _dtype(bits: int) -> type[np.unsignedinteger]:
    return np.uint8 if bits <= 8 else np.uint16 if bits <= 16 else np.uint32


def in_order(forms: Sequence[PlaneForm]) -> list[PlaneForm]:
    """Ranges first, then narrow attributes: those that are in proportion to them follow."""
    return sorted(forms, key=lambda form: (_ROLES.index(form.role), form.bits))


def form_table(ordered: Sequence[PlaneForm]) -> npt.NDArray[np.uint8]:
    """(P, 4): role, bits, number of the range plane, number of the plane that it repeats."""
    numbers = {form.name: number for number, form in enumerate(ordered)}
    rows = []
    for number, form in enumerate(ordered):
        attribute = form.role == "attribute"
        like = numbers.get(form.name.removesuffix("2"), number)
        alike = (ordered[like].role == "attribute") == attribute and ordered[like].bits == form.bits and like < number
        rows.append(
            (
                _ROLES.index(form.role),
                form.bits,
                numbers[form.of] if attribute else number,
                like if alike and form.role != "range" else number,
            )
        )
    return np.array(rows, np.uint8).reshape(-1, 4)
