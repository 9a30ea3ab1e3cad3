"""The paper's two ways to code residuals: sparse with arithmetic coding, and varints with LZMA.

Residuals are whole numbers of steps, in raster order, one for each valid cell. Sparse: how many zeros stand before each
residual that is none, and those residuals; both go through an adaptive arithmetic coder. Varints: 7 bits a byte, small
numbers of either sign first (0, -1, 1, -2 ...), and LZMA over all of it.

>>> residuals = np.array([0, 0, -1, 0, 300, 0], np.int64)
>>> decode_sparse(encode_sparse(residuals), 6).tolist() == decode_varint(encode_varint(residuals), 6).tolist()
True
"""

from __future__ import annotations

import lzma
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import fast
from lidarcodec.entropy.number_series import unzigzag, zigzag
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.errors import SectionError

Residuals = npt.NDArray[np.int64]

MOST: Final = 1 << 20
"""Residuals lie within this; a range image has 2^16 steps."""
_MOST_BYTES: Final = 3
"""Of a varint of a residual."""
_LZMA: Final = [
    {"id": lzma.FILTER_LZMA1, "preset": 9 | lzma.PRESET_EXTREME, "dict_size": 1 << 20, "lc": 3, "lp": 0, "pb": 0}
]
"""A frame's varints are 0.2 MB: a larger dictionary only takes time to set up."""


def encode_sparse(residuals: Residuals) -> bytes:
    """Bytes of residuals (N,) int64, zeros cheap: the number that are none, then both streams.

    Raises SectionError beyond the limits.
    """
    _check(residuals)
    places = np.flatnonzero(residuals)
    runs = np.diff(places, prepend=-1) - 1
    values = zigzag(residuals[places]) - np.uint64(1)
    out = bytearray()
    put_varint(out, len(places))
    return bytes(out) + fast.encode_numbers([runs.astype(np.uint64), values])


def decode_sparse(data: bytes, count: int) -> Residuals:
    """(count,) int64 residuals. Raises SectionError or TruncatedError."""
    reader = VarintReader(data)
    held = reader.varint(count)
    runs, values = fast.decode_numbers(data[reader.offset :], [held, held])
    if held and (int(runs.max()) >= count or int(values.max()) >= 2 * MOST):
        raise SectionError("residuals beyond their limits")
    places = np.cumsum(runs.astype(np.int64) + 1) - 1
    if held and int(places[-1]) >= count:
        raise SectionError(f"residuals for {int(places[-1]) + 1} returns, not {count}")
    residuals = np.zeros(count, np.int64)
    residuals[places] = unzigzag(values + np.uint64(1))
    return residuals


def encode_varint(residuals: Residuals) -> bytes:
    """Bytes of residuals (N,) int64: LZMA over varints. Raises SectionError beyond the limits."""
    _check(residuals)
    numbers = zigzag(residuals).astype(np.uint32)
    parts = np.stack([numbers >> shift & 0x7F for shift in range(0, 7 * _MOST_BYTES, 7)], axis=1).astype(np.uint8)
    length = 1 + (numbers >= 1 << 7) + (numbers >= 1 << 14)
    place = np.arange(_MOST_BYTES)
    parts |= np.where(place < length[:, None] - 1, 0x80, 0).astype(np.uint8)
    return lzma.compress(parts[place < length[:, None]].tobytes(), lzma.FORMAT_RAW, filters=_LZMA)


def decode_varint(data: bytes, count: int) -> Residuals:
    """(count,) int64 residuals. Raises SectionError."""
    try:
        decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_LZMA)
        plain = decoder.decompress(data, max_length=count * _MOST_BYTES + 1)
    except lzma.LZMAError:
        raise SectionError("residuals that are no LZMA stream") from None
    parts = np.frombuffer(plain, np.uint8)
    ends = np.flatnonzero(parts < 0x80)
    if len(ends) != count or (count and int(ends[-1]) != len(parts) - 1) or (not count and len(parts)):
        raise SectionError(f"varints of {len(ends)} residuals, not {count}")
    starts = np.concatenate([[0], ends[:-1] + 1]) if count else ends
    if count and int((ends - starts).max()) >= _MOST_BYTES:
        raise SectionError("a varint that is too long")
    numbers = np.zeros(count, np.uint64)
    for place in range(_MOST_BYTES):
        held = starts + place <= ends
        numbers[held] |= (parts[starts[held] + place] & 0x7F).astype(np.uint64) << np.uint64(7 * place)
    if count and int(numbers.max()) >= 2 * MOST:
        raise SectionError("residuals beyond their limits")
    return unzigzag(numbers)


def entropy_bits(residuals: Residuals) -> float:
    """Bits of residuals (N,) in a code that knows how often each value comes in them, and nothing else."""
    if not len(residuals):
        return 0.0
    _, counts = np.unique(residuals, return_counts=True)
    return float(-(counts * np.log2(counts / len(residuals))).sum())


def _check(residuals: Residuals) -> None:
    if residuals.ndim != 1 or residuals.dtype != np.int64:
        raise SectionError(f"residuals are {residuals.dtype}{residuals.shape}, not int64(N,)")
    if len(residuals) and int(np.abs(residuals).max()) >= MOST:
        raise SectionError(f"a residual of {int(np.abs(residuals).max())} steps: the limit is {MOST - 1}")
