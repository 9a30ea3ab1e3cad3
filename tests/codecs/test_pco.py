"""The native core's own reader of pco, against the library pcodec: the same numbers, and the same damage refused."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from pcodec import ChunkConfig, DeltaSpec, ModeSpec, PagingSpec, wrapped

from lidarcodec._native import decode_pco_groups, read_pco_chunk
from lidarcodec.codecs.pcodec import compress_groups
from lidarcodec.errors import DecodeError, SectionError
from tests.sweeps import examples

Numbers = npt.NDArray[np.int16]

SIZES = (1, 2, 3, 4, 5, 255, 256, 257, 1000, 4097, 50_000)
LEVELS = tuple(range(1, 13))
CONTENTS: dict[str, Callable[[np.random.Generator, int], npt.NDArray[np.floating]]] = {
    "constant": lambda _, size: np.full(size, -77.0),
    "uniform": lambda rng, size: rng.integers(-32768, 32768, size).astype(np.float64),
    "narrow": lambda rng, size: rng.laplace(0, 8, size),
    "wide": lambda rng, size: 5 * rng.standard_cauchy(size),
    "few": lambda rng, size: 1000.0 * rng.integers(0, 3, size),
}


def numbers_of(content: str, rng: np.random.Generator, size: int) -> Numbers:
    return np.rint(CONTENTS[content](rng, size)).clip(-32768, 32767).astype(np.int16)


def coded(numbers: Numbers, level: int, mode: ModeSpec | None = None, delta: DeltaSpec | None = None) -> bytes:
    """Header, chunk metadata and page as the library writes them."""
    pco = wrapped.FileCompressor()
    chunk = pco.chunk_compressor(
        numbers,
        ChunkConfig(
            level,
            mode_spec=mode or ModeSpec.classic(),
            delta_spec=delta or DeltaSpec.no_op(),
            paging_spec=PagingSpec.exact_page_sizes([len(numbers)]),
        ),
    )
    return bytes(pco.write_header() + chunk.write_meta() + chunk.write_page(0))


def by_library(data: bytes, count: int) -> tuple[Numbers, int] | None:
    """What the library reads, and how many bytes; None if it refuses them."""
    numbers = np.zeros(count, np.int16)
    try:
        pco, at = wrapped.FileDecompressor.new(data)
        chunk, read = pco.chunk_decompressor(data[at:], "i16")
        at += read
        _, read = chunk.read_page_into(data[at:], count, numbers)
    except BaseException as error:  # a panic of the library is no Exception
        if isinstance(error, KeyboardInterrupt | MemoryError):
            raise
        return None
    return numbers, at + read


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("level", LEVELS)
def test_numbers_come_back(content: str, level: int) -> None:
    rng = np.random.default_rng(level)
    for size in SIZES:
        numbers = numbers_of(content, rng, size)
        data = coded(numbers, level)
        found, read = read_pco_chunk(data + b"what follows", size)
        np.testing.assert_array_equal(found, numbers)
        assert read == len(data)


@pytest.mark.parametrize("content", CONTENTS)
def test_many_numbers_come_back(content: str) -> None:
    numbers = numbers_of(content, np.random.default_rng(3), 600_000)
    np.testing.assert_array_equal(read_pco_chunk(coded(numbers, 8), len(numbers))[0], numbers)


@pytest.mark.drawn
def test_damage_is_read_or_refused_as_by_the_library() -> None:
    """Bits turned over anywhere behind the version; but of modes and deltas that no message has, refused by name."""
    rng = np.random.default_rng(11)
    seen = {True: 0, False: 0}
    for _ in range(examples(4000)):
        numbers = numbers_of(str(rng.choice(list(CONTENTS))), rng, int(rng.integers(1, 1500)))
        data = bytearray(coded(numbers, int(rng.integers(1, 13))))
        head = min(len(data), 50)
        for _ in range(int(rng.integers(1, 3))):
            at = int(rng.integers(2, head if rng.random() < 0.7 else len(data)))
            data[at] ^= 1 << int(rng.integers(8))
        wanted = by_library(bytes(data), len(numbers)) if data[2] == 0 else None
        try:
            found, read = read_pco_chunk(bytes(data), len(numbers))
        except DecodeError:
            assert wanted is None
            seen[False] += 1
        else:
            assert wanted is not None
            np.testing.assert_array_equal(found, wanted[0])
            assert read == wanted[1]
            seen[True] += 1
    assert min(seen.values()) > examples(4000) / 8


@pytest.mark.parametrize(
    ("mode", "delta", "name"),
    [
        (ModeSpec.try_int_mult(10), None, "mode IntMult"),
        (None, DeltaSpec.try_consecutive(1), "delta encoding Consecutive"),
        (None, DeltaSpec.try_lookback(), "delta encoding Lookback"),
    ],
)
def test_what_no_message_has_is_refused_by_name(mode: ModeSpec | None, delta: DeltaSpec | None, name: str) -> None:
    numbers = (10 * np.random.default_rng(5).integers(0, 300, 5000)).astype(np.int16)
    with pytest.raises(SectionError, match=name):
        read_pco_chunk(coded(numbers, 8, mode, delta), len(numbers))


def test_another_version_is_refused_by_name() -> None:
    with pytest.raises(SectionError, match="version 3"):
        read_pco_chunk(b"\x03" + coded(np.arange(9, dtype=np.int16), 8)[1:], 9)


def test_every_cut_is_refused() -> None:
    values = np.random.default_rng(1).integers(5000, 5200, 700).astype(np.uint16)
    data = compress_groups(values, 8)
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            decode_pco_groups(data[:size], len(values))


def test_groups_that_do_not_belong_together_are_refused() -> None:
    """Starts that do not rise, returns that do not add up, and a group that runs out of differences."""
    rng = np.random.default_rng(2)
    calm, lively = rng.integers(5000, 5002, 6000), rng.integers(1, 60000, 6000)
    values = np.concatenate([calm, lively]).astype(np.uint16)
    data = bytearray(compress_groups(values, 8))
    count = data[0]
    assert count > 1
    for at, value in ((0, 0), (0, 20), (1, 1), (6, 0), (6, 19), (2, data[2] ^ 1)):
        damaged = data.copy()
        damaged[at] = value
        with pytest.raises(DecodeError):
            decode_pco_groups(bytes(damaged), len(values))
    table = [struct.unpack_from("<BI", data, 1 + 5 * group) for group in range(count)]
    moved = [(start if group == 0 else start + 1, returns) for group, (start, returns) in enumerate(table)]
    if moved[-1][0] < 19:
        packed = bytes([count]) + b"".join(struct.pack("<BI", *entry) for entry in moved)
        with pytest.raises(SectionError):
            decode_pco_groups(packed + bytes(data[len(packed) :]), len(values))
