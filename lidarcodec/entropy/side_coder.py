"""Side coder: what byte-exact packets need beside the images, predicted.

Time stamps are a straight line and what is left over; the host's follow the sensor's own. Status types repeat with a
period, a status value is predicted by the last of its type. Blocks that no image holds go through zstd. The format is
docs/wire-format-sections.md, section "side".

>>> from lidarcodec.side import SideInfo
>>> side = SideInfo.regular(packets=348)
>>> data = encode_side(side)
>>> len(data), decode_side(data, packets=348).columns
(16, 2088)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import zstandard

from lidarcodec.entropy import fast
from lidarcodec.entropy.number_series import (
    MOST_LEVEL,
    MOST_RATE,
    Form,
    Line,
    Series,
    centred,
    differences,
    series,
    sums,
)
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.entropy.zstd_memory import memory_told
from lidarcodec.errors import SectionError
from lidarcodec.side import REGULAR_LAYOUT, Role, SideInfo
from lidarcodec.units import BLOCK_BYTES, BLOCKS_PER_PACKET, HOUR_US, LASERS_PER_BLOCK, MAX_PACKETS

_REGULAR, _HOURLY, _BY_GPS = 1, 2, 4
_GPS_FORM_SHIFT, _HOST_FORM_SHIFT = 3, 5
_LONGEST_PERIOD = 32
_LONGEST_STEP_NS = 1_000_000_000
_WIDEST_NS = 1 << 60
_SECOND_BYTES = LASERS_PER_BLOCK * 3


def encode_side(side: SideInfo, *, host_step_ns: int = 1000) -> bytes:
    """Bytes of side information; 0.2 ms for 348 packets.

    host_step_ns: host times are rounded to multiples of it, all else is exact.

    Raises SectionError if there are more blocks than twelve a packet, more layouts than packets, or host times more
    than 36 years apart.
    """
    packets = side.packets
    if not 1 <= host_step_ns <= _LONGEST_STEP_NS:
        raise SectionError(f"host times in steps of {host_step_ns} ns: the limits are 1 and {_LONGEST_STEP_NS}")
    if len(side.layouts) > packets + 1 or len(side.irregular) + len(side.second) > BLOCKS_PER_PACKET * packets:
        raise SectionError(f"side information of {packets} packets with too many layouts or blocks")
    if packets and not -_WIDEST_NS < int(side.packet_ns.min()) <= int(side.packet_ns.max()) < _WIDEST_NS:
        raise SectionError("host times of a frame's packets more than 36 years apart")

    gps = side.gps_us.astype(np.int64)
    modulus = HOUR_US if packets == 0 or int(gps.max()) < HOUR_US else 1 << 32
    gps_fit = fast.best_form(gps, modulus)
    host = (side.packet_ns + host_step_ns // 2) // host_step_ns
    alone, by_gps = fast.best_form(host), fast.best_form(host - _host_by_gps(gps, modulus, host_step_ns))
    follows = by_gps.cost < alone.cost
    host_fit = by_gps if follows else alone
    types = side.status[:, 0].astype(np.int64)
    period = fast.best_period(np.ascontiguousarray(side.status[:, 0]), _LONGEST_PERIOD)
    regular = len(side.layouts) == 1 and bool((side.layouts[0] == REGULAR_LAYOUT).all())
    layouts = np.zeros(0, np.int64) if regular else side.layouts.astype(np.int64).ravel()
    type_left = centred(differences(types, period), 256)
    streams = (
        centred(differences(layouts, BLOCKS_PER_PACKET), 256),
        np.zeros(0, np.int64) if len(side.layouts) == 1 else differences(side.layout.astype(np.int64), 1),
        gps_fit.left,
        host_fit.left,
        type_left[:period],
        type_left[period:],
        centred(differences(side.status[_by_type(types), 1].astype(np.int64), 1), 256),
    )
    numbers = fast.encode_signed(streams)

    flags = regular * _REGULAR | (modulus == HOUR_US) * _HOURLY | follows * _BY_GPS
    out = bytearray([flags | gps_fit.form << _GPS_FORM_SHIFT | host_fit.form << _HOST_FORM_SHIFT])
    put_signed(out, gps_fit.line.level)
    put_signed(out, gps_fit.line.rate)
    put_varint(out, host_step_ns)
    put_signed(out, host_fit.line.level)
    put_signed(out, host_fit.line.rate)
    put_varint(out, period)
    if not regular:
        put_varint(out, len(side.layouts))
    put_varint(out, len(numbers))
    out += numbers
    irregular, second = _blocks_of(side.layouts, side.layout)
    put_signed(out, len(side.irregular) - irregular)
    put_signed(out, len(side.second) - second)
    return bytes(out) + _pack_blocks(side.irregular, side.second)


def decode_side(data: bytes, packets: int) -> SideInfo:
    """Side information of `packets` packets; 0.2 ms for 348.

    Raises SectionError or TruncatedError; takes no more memory than `packets` allows (1200 bytes a packet).
    """
    if not 0 <= packets <= MAX_PACKETS:
        raise SectionError(f"side information of {packets} packets: the limit is {MAX_PACKETS}")
    reader = VarintReader(data)
    flags = reader.byte()
    if flags >= 1 << (_HOST_FORM_SHIFT + 2):
        raise SectionError("side information with unknown flags")
    gps_form, host_form = Form(flags >> _GPS_FORM_SHIFT & 3), Form(flags >> _HOST_FORM_SHIFT & 3)
    modulus = HOUR_US if flags & _HOURLY else 1 << 32
    gps_line = Line(reader.signed(MOST_LEVEL), reader.signed(MOST_RATE))
    host_step_ns = reader.varint(_LONGEST_STEP_NS, least=1)
    host_line = Line(reader.signed(MOST_LEVEL), reader.signed(MOST_RATE))
    period = reader.varint(_LONGEST_PERIOD, least=1)
    regular = bool(flags & _REGULAR)
    layout_count = 1 if regular else reader.varint(packets + 1)
    head = min(period, packets)
    layout_numbers = 0 if regular else BLOCKS_PER_PACKET * layout_count
    counts = [layout_numbers, 0 if layout_count == 1 else packets, packets, packets, head, packets - head, packets]
    numbers = fast.decode_signed(reader.take(reader.varint(len(data))), counts)
    layouts_left, layout_left, gps_left, host_left, head_left, tail_left, value_left = numbers

    layouts = sums(layouts_left, BLOCKS_PER_PACKET).astype(np.uint8).reshape(-1, BLOCKS_PER_PACKET)
    layout = sums(layout_left, 1) if layout_count != 1 else np.zeros(packets, np.int64)
    if packets and not 0 <= int(layout.min()) <= int(layout.max()) < layout_count:
        raise SectionError("side information names a packet layout that it does not hold")
    gps = series(gps_left, gps_form, gps_line) % modulus
    host = series(host_left, host_form, host_line)
    if flags & _BY_GPS:
        host = host + _host_by_gps(gps, modulus, host_step_ns)
    types = sums(np.concatenate([head_left, tail_left]), period)
    status = np.empty((packets, 2), np.uint8)
    status[:, 0] = types.astype(np.uint8)
    status[_by_type(status[:, 0]), 1] = sums(value_left, 1).astype(np.uint8)
    if regular:
        layouts = REGULAR_LAYOUT[None].copy()
    irregular, second = _unpack_blocks(reader, layouts, layout, packets)
    reader.end()
    return SideInfo(
        packet_ns=host * np.int64(host_step_ns),
        gps_us=gps.astype(np.uint32),
        status=status,
        layouts=layouts,
        layout=layout.astype(np.uint16),
        irregular=irregular,
        second=second,
    )


def _host_by_gps(gps: Series, modulus: int, host_step_ns: int) -> Series:
    """(P,) int64 host steps since the first packet, if the host's clock ran like the sensor's."""
    elapsed_us = sums(centred(differences(gps, 1), modulus), 1)
    since_first: Series = (elapsed_us - elapsed_us[:1]) * 1000 // host_step_ns
    return since_first


def _by_type(types: npt.NDArray[np.integer]) -> npt.NDArray[np.intp]:
    """(P,) order of packets by status type, then as they came."""
    return np.argsort(types, kind="stable")


def _blocks_of(layouts: npt.NDArray[np.uint8], layout: npt.NDArray[np.integer]) -> tuple[int, int]:
    """How many irregular and second-return blocks the layouts announce."""
    times = np.bincount(layout, minlength=len(layouts))[:, None]
    return int(((layouts == Role.IRREGULAR) * times).sum()), int(((layouts >= Role.UPPER_SECOND) * times).sum())


def _pack_blocks(irregular: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8]) -> bytes:
    """Irregular blocks as they are; of second returns distances less those of two blocks before (upper and lower blocks
    alternate), as three planes by laser. Through zstd where that is smaller."""
    if not len(irregular) and not len(second):
        return b""
    returns = second.reshape(-1, LASERS_PER_BLOCK, 3)
    distance = np.ascontiguousarray(returns[..., :2]).view("<u2")[..., 0]
    steps = distance.copy()
    steps[2:] -= distance[:-2]
    planes = (steps & 0xFF).astype(np.uint8), (steps >> 8).astype(np.uint8), returns[..., 2]
    raw = irregular.tobytes() + b"".join(plane.T.tobytes() for plane in planes)
    with memory_told():
        packed = zstandard.ZstdCompressor(level=3).compress(raw)
    return packed if len(packed) < len(raw) else raw  # of the same size it would be read as blocks as they are


def _unpack_blocks(
    reader: VarintReader, layouts: npt.NDArray[np.uint8], layout: npt.NDArray[np.int64], packets: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Undoes `_pack_blocks`: (K, 100) irregular and (S, 96) second-return blocks."""
    most = BLOCKS_PER_PACKET * packets
    announced = _blocks_of(layouts, layout)
    irregular, second = (count + reader.signed(most) for count in announced)
    if min(irregular, second) < 0 or irregular + second > most:
        raise SectionError(f"side information of {packets} packets with too many blocks", reader.offset)
    if irregular + second == 0:
        return np.zeros((0, BLOCK_BYTES), np.uint8), np.zeros((0, _SECOND_BYTES), np.uint8)
    size, start = irregular * BLOCK_BYTES + second * _SECOND_BYTES, reader.offset
    packed = reader.rest(size)
    raw = np.frombuffer(packed if len(packed) == size else _decompress(packed, size, start), np.uint8)
    steps, planes = irregular * BLOCK_BYTES, raw[irregular * BLOCK_BYTES :].reshape(3, LASERS_PER_BLOCK, second)
    distance = planes[0].T.astype(np.uint16) | planes[1].T.astype(np.uint16) << 8
    for first in range(2):
        distance[first::2] = np.cumsum(distance[first::2], axis=0, dtype=np.uint16)
    returns = np.empty((second, LASERS_PER_BLOCK, 3), np.uint8)
    returns[..., 0], returns[..., 1], returns[..., 2] = distance & 0xFF, distance >> 8, planes[2].T
    return raw[:steps].reshape(irregular, BLOCK_BYTES).copy(), returns.reshape(second, _SECOND_BYTES)


def _decompress(packed: bytes, size: int, offset: int) -> bytes:
    """Bytes of one zstd frame that must say beforehand that it holds `size` of them."""
    try:
        if zstandard.frame_content_size(packed) != size:
            raise SectionError(f"side information: blocks that are not {size} bytes", offset)
        with memory_told():
            return zstandard.ZstdDecompressor(max_window_size=1 << 23).decompress(packed, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise SectionError(f"side information: blocks that cannot be decompressed ({error})", offset) from None
