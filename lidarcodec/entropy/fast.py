"""What several coders take of the native core: number streams, forms of series, and networks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.number_series import Form, Line, Series, unzigzag, zigzag

_Number = TypeVar("_Number", np.uint64, np.int64)


def encode_numbers(streams: Sequence[npt.NDArray[np.uint64]]) -> bytes:
    """Bytes of several streams of whole numbers, (N,) uint64 each, small ones cheap; each stream learns by itself."""
    return _encoded(np.concatenate([np.zeros(0, np.uint64), *streams]), map(len, streams))


def encode_signed(streams: Sequence[Series]) -> bytes:
    """The same of numbers with a sign, (N,) int64 each, folded by `zigzag`."""
    return _encoded(zigzag(np.concatenate([np.zeros(0, np.int64), *streams])), map(len, streams))


def _encoded(values: npt.NDArray[np.uint64], counts: Iterable[int]) -> bytes:
    return _native.encode_numbers(values, np.array(list(counts), np.uint64))


def decode_numbers(data: bytes, counts: Sequence[int]) -> list[npt.NDArray[np.uint64]]:
    """Streams of `counts` numbers, (N,) uint64 each.

    Raises SectionError or TruncatedError. Takes 8 bytes a number: check the counts before.
    """
    return _split(_native.decode_numbers(data, np.array(counts, np.uint64)), counts)


def decode_signed(data: bytes, counts: Sequence[int]) -> list[Series]:
    """The same of numbers with a sign, (N,) int64 each."""
    return _split(unzigzag(_native.decode_numbers(data, np.array(counts, np.uint64))), counts)


def _split(values: npt.NDArray[_Number], counts: Sequence[int]) -> list[npt.NDArray[_Number]]:
    ends = accumulate(counts)
    return [values[end - count : end] for end, count in zip(ends, counts, strict=True)]


class Fit(NamedTuple):
    """A form of a series, its line, the (N,) residuals, and about what they cost in 256ths of a bit."""

    form: Form
    line: Line
    left: Series
    cost: int


def best_form(values: Series, modulus: int = 0) -> Fit:
    """Form and line that leave the cheapest residuals of (N,) int64; these are centred if a modulus is given."""
    form, level, rate, left, cost = _native.best_form(values, modulus)
    return Fit(Form(form), Line(level, rate), left, cost)


def best_period(types: npt.NDArray[np.uint8], longest: int) -> int:
    """Period, 1 to `longest`, that predicts most of (N,) types by those one period before; `longest` is at most 32."""
    return _native.best_period(types, longest)


def coding_paths() -> list[str]:
    """How the processor at hand can compute (`plain`, `sse2` or `neon`, `avx2`), the quickest last: the same bytes."""
    return _native.coding_paths()


def net_forms() -> list[str]:
    """How the processor at hand can run networks, the quickest last: the same odds.

    `plain`; on x86-64 `sse2`, `avx2`, `avx512vnni`; on 64-bit ARM `neon`, `dotprod`.
    """
    return _native.net_forms()


GivenLayer = tuple[npt.NDArray[np.int16], npt.NDArray[np.int32], int, npt.NDArray[np.int8]]
"""Weights (out, in), biases (out,), shift."""


class NativeNets:
    """Networks of codec `riddle`: of frames alone, of frames that expect something, or both. form: of `net_forms`."""

    def __init__(self, form: str = "") -> None:
        self.native, self._form = _native.RiddleNets(), form

    def add(self, layers: Sequence[GivenLayer]) -> None:
        """Takes a network of three layers. Raises SectionError."""
        first, second, third = layers
        self.native.set(*first, *second, *third, self._form)

    def run(self, inputs: npt.NDArray[np.int8]) -> npt.NDArray[np.int16]:
        """(n, 32) log odds of (n, 72 or 112) inputs. Raises SectionError."""
        return self.native.run(inputs)
