"""Position coder: the position packets of a frame, byte for byte.

Places, times and sizes are series of small numbers. The payloads are mostly zeros and a sentence of NMEA that changes
once a second: one zstd frame has them all, as they are or as differences to the packet before, whatever is smaller.
The format is docs/wire-format-sections.md, section "position".

>>> from lidarcodec.side import Position
>>> sentence = bytes(206) + b"$GPRMC,220632,A,3707.8324,N,12139.2864,W,000.0,144.7,111212,013.8,E,D*09"
>>> sent = tuple(Position(14 * k, 4_032_000 * k, sentence) for k in range(25))
>>> data = encode_positions(sent)
>>> len(data), decode_positions(data, packets=348) == sent
(109, True)
"""

from __future__ import annotations

import numpy as np
import zstandard

from lidarcodec.entropy import fast
from lidarcodec.entropy.number_series import MOST_LEVEL, MOST_RATE, Form, Line, Series, differences, series, sums
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.side import Position, check_positions
from lidarcodec.units import MAX_POSITION_BYTES, MAX_POSITIONS, MAX_POSITIONS_BYTES

_AS_THEY_ARE, _DIFFERENCES = 0, 1
_LONGEST_STEP_NS = 1_000_000_000
_WIDEST_NS = 1 << 62
_LEVEL = 9
_WINDOW_BYTES = 1 << 20


def encode_positions(positions: tuple[Position, ...], *, host_step_ns: int = 1000) -> bytes:
    """Bytes of one position packet or more; 0.6 ms for 37.

    host_step_ns: host times are rounded to multiples of it, all else is exact.

    Raises SectionError for no packet, too many, or host times more than 146 years from the frame's.
    """
    if not positions or not 1 <= host_step_ns <= _LONGEST_STEP_NS:
        raise SectionError(f"{len(positions)} position packets with times in steps of {host_step_ns} ns")
    check_positions(positions, positions[-1].place)
    offsets = [one.offset_ns for one in positions]
    if not -_WIDEST_NS < min(offsets) <= max(offsets) < _WIDEST_NS:
        raise SectionError("a position packet more than 146 years from its frame")
    times = np.array([(offset + host_step_ns // 2) // host_step_ns for offset in offsets], np.int64)
    fit = fast.best_form(times)
    numbers = fast.encode_signed(
        (
            differences(_numbers([one.place for one in positions]), 1),
            differences(_numbers([len(one.payload) for one in positions]), 1),
            fit.left,
        )
    )
    payloads = b"".join(one.payload for one in positions)
    kind, packed = _AS_THEY_ARE, _packed(payloads)
    sizes = {len(one.payload) for one in positions}
    if len(sizes) == 1 and sizes != {0}:
        steps = _packed(_differences(payloads, len(positions)))
        kind, packed = min((kind, packed), (_DIFFERENCES, steps), key=lambda one: len(one[1]))
    out = bytearray([kind])
    put_varint(out, len(positions))
    put_varint(out, host_step_ns)
    out.append(fit.form)
    put_signed(out, fit.line.level)
    put_signed(out, fit.line.rate)
    put_varint(out, len(numbers))
    return bytes(out) + numbers + packed


def decode_positions(data: bytes, packets: int) -> tuple[Position, ...]:
    """Position packets of a frame of `packets` data packets; 0.5 ms for 37.

    Raises SectionError or TruncatedError; takes no more than 1 MiB for payloads.
    """
    reader = VarintReader(data)
    try:
        if (kind := reader.byte()) not in (_AS_THEY_ARE, _DIFFERENCES):
            raise SectionError(f"a position section of kind {kind}: this build reads kinds 0 and 1")
        count = reader.varint(MAX_POSITIONS, least=1)
        host_step_ns = reader.varint(_LONGEST_STEP_NS, least=1)
        if (form := reader.byte()) > max(Form):
            raise SectionError(f"a position section with times of form {form}")
        line = Line(reader.signed(MOST_LEVEL), reader.signed(MOST_RATE))
        numbers = reader.take(reader.varint(len(data)))
    except TruncatedError:
        raise TruncatedError("a position section ends within its head", reader.offset) from None
    places, sizes, left = fast.decode_signed(numbers, [count] * 3)
    places, sizes = sums(places, 1), sums(sizes, 1)
    times = series(left, Form(form), line)
    most = _WIDEST_NS // host_step_ns
    if int(sizes.min()) < 0 or int(sizes.max()) > MAX_POSITION_BYTES or int(sizes.sum()) > MAX_POSITIONS_BYTES:
        raise SectionError("a position section with packets of impossible sizes")
    if int(times.min()) < -most or int(times.max()) > most:
        raise SectionError("a position packet more than 146 years from its frame")
    total, start = int(sizes.sum()), reader.offset
    packed = reader.rest(total)
    payloads = packed if len(packed) == total else _unpacked(packed, total, start)
    if kind == _DIFFERENCES:
        if total == 0 or int(sizes.min()) != int(sizes.max()):
            raise SectionError("differences of position packets that are not of one size", start)
        payloads = _sums(payloads, count)
    ends = np.cumsum(sizes).tolist()
    positions = tuple(
        Position(place, time * host_step_ns, payloads[end - size : end])
        for place, time, size, end in zip(places.tolist(), times.tolist(), sizes.tolist(), ends, strict=True)
    )
    check_positions(positions, packets)
    return positions


def _numbers(values: list[int]) -> Series:
    return np.array(values, np.int64)


def _differences(payloads: bytes, count: int) -> bytes:
    """Each byte of `count` payloads of one size less that of the payload before; byte 0 of all, then byte 1, ..."""
    rows = np.frombuffer(payloads, np.uint8).reshape(count, -1)
    steps = rows.copy()
    steps[1:] -= rows[:-1]
    return steps.T.tobytes()


def _sums(steps: bytes, count: int) -> bytes:
    """Undoes `_differences`."""
    columns = np.frombuffer(steps, np.uint8).reshape(-1, count)
    return np.cumsum(columns, axis=1, dtype=np.uint8).T.tobytes()


def _packed(payloads: bytes) -> bytes:
    """Payloads through zstd where that is smaller."""
    packed = zstandard.ZstdCompressor(level=_LEVEL).compress(payloads)
    return packed if len(packed) < len(payloads) else payloads  # of the same size they would be read as they are


def _unpacked(packed: bytes, size: int, offset: int) -> bytes:
    """Bytes of one zstd frame that must say beforehand that it holds `size` of them."""
    try:
        if zstandard.frame_content_size(packed) != size:
            raise SectionError(f"position packets that are not {size} bytes", offset)
        return zstandard.ZstdDecompressor(max_window_size=_WINDOW_BYTES).decompress(packed, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise SectionError(f"position packets that cannot be decompressed ({error})", offset) from None
