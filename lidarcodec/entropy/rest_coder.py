"""Rest coder: what byte-exact packets of any sensor need beside the planes of a frame.

Series and host times are a straight line and what is left over (number_series.py). Odd packets of one size are written
as they are or as differences to the packet before, whichever zstd makes smaller. The format is
docs/wire-format-other-sensors.md, section "REST".

>>> import numpy as np
>>> rest = PacketRest("single", np.arange(75) * 1_327_000, np.zeros(0, np.uint16), (),
...                   {"time_us": (7 + 1327 * np.arange(75)).astype(np.uint32)})
>>> data = encode_rest(rest)
>>> len(data), decode_rest(data, packets=75).series["time_us"][:3].tolist()
(38, [7, 1334, 2661])
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy import fast
from lidarcodec.entropy.number_series import MOST_LEVEL, MOST_RATE, Form, Line, Series, differences, series
from lidarcodec.entropy.varint import VarintReader, put_signed, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.packet_rest import PacketRest
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS

_DTYPES: Final[tuple[np.dtype[np.unsignedinteger], ...]] = (
    np.dtype(np.uint8),
    np.dtype(np.uint16),
    np.dtype(np.uint32),
    np.dtype(np.uint64),
)
_BY_LINE, _PLAIN = 0, 1
_AS_THEY_ARE, _DIFFERENCES = 0, 1
_HOST_STEP_NS: Final = 1000
_WIDEST: Final = 1 << 60
_MAX_NAME: Final = 32
MAX_SERIES_NUMBERS: Final = 64 * MAX_COLUMNS
"""Most numbers of all series of a frame."""
_LEVEL: Final = 3


def encode_rest(rest: PacketRest, *, host_step_ns: int = _HOST_STEP_NS) -> bytes:
    """Bytes of the rest of a frame's packets, without the position packets, which have a section of their own.

    host_step_ns: host times are rounded to multiples of it, all else is exact.

    Raises SectionError for host times more than 36 years apart, or too many or too long series.
    """
    packets = rest.packets
    if packets and not -_WIDEST < int(rest.packet_ns.min()) <= int(rest.packet_ns.max()) < _WIDEST:
        raise SectionError("host times of a frame's packets more than 36 years apart")
    out = bytearray()
    _put_name(out, rest.layout)
    put_varint(out, host_step_ns)
    put_line(out, (rest.packet_ns + host_step_ns // 2) // host_step_ns)
    put_varint(out, len(rest.series))
    if sum(map(len, rest.series.values())) > MAX_SERIES_NUMBERS:
        raise SectionError(f"series of more than {MAX_SERIES_NUMBERS} numbers in a frame")
    for name, values in rest.series.items():
        _put_name(out, name)
        out.append(_DTYPES.index(values.dtype))
        put_varint(out, len(values))
        _put_series(out, values)
    _put_odd(out, rest)
    return bytes(out)


def decode_rest(data: bytes, packets: int) -> PacketRest:
    """The rest of `packets` packets.

    Raises SectionError or TruncatedError; takes no more memory than the limits of a frame allow.
    """
    if not 0 <= packets <= MAX_PACKETS:
        raise SectionError(f"a frame of {packets} packets: the limit is {MAX_PACKETS}")
    return rest_of(_native.decode_rest(data, packets, decompress))


def rest_of(
    decoded: tuple[str, npt.NDArray[np.int64], npt.NDArray[np.uint16], list[bytes], list[tuple[str, npt.NDArray[Any]]]],
) -> PacketRest:
    """The rest that the native core read: layout, `packet_ns`, `odd`, `odd_packets` and series."""
    layout, packet_ns, odd, odd_packets, found = decoded
    return PacketRest(layout, packet_ns, odd, tuple(odd_packets), dict(found))


def _put_name(out: bytearray, name: str) -> None:
    coded = name.encode()
    if len(coded) > _MAX_NAME:
        raise SectionError(f"a name of {len(coded)} bytes: the limit is {_MAX_NAME}")
    out.append(len(coded))
    out += coded


def put_line(out: bytearray, values: Series) -> None:
    """(N,) int64 as a form, a line and what is left over."""
    fit = fast.best_form(values)
    numbers = fast.encode_signed((fit.left,))
    out.append(fit.form)
    put_signed(out, fit.line.level)
    put_signed(out, fit.line.rate)
    put_varint(out, len(numbers))
    out += numbers


def read_line(reader: VarintReader, count: int) -> Series:
    form = reader.byte()
    if form not in Form._value2member_map_:
        raise SectionError(f"a series of unknown form {form}")
    line = Line(reader.signed(MOST_LEVEL), reader.signed(MOST_RATE))
    (left,) = fast.decode_signed(reader.take(reader.varint(len(reader))), [count])
    return series(left, Form(form), line)


def _put_series(out: bytearray, values: npt.NDArray[np.unsignedinteger]) -> None:
    """Numbers that follow a line, or the plain bytes where those are smaller."""
    plain = values.astype(values.dtype.newbyteorder("<")).tobytes()
    packed = compress(plain, _LEVEL)
    by_line = bytearray()
    if len(values) and int(values.max()) < _WIDEST:
        put_line(by_line, values.astype(np.int64))
    if by_line and len(by_line) <= len(packed):
        out.append(_BY_LINE)
        out += by_line
        return
    out.append(_PLAIN)
    put_varint(out, len(packed))
    out += packed


def _put_odd(out: bytearray, rest: PacketRest) -> None:
    """Places and sizes of odd packets, then their bytes, those of each size together, the smallest size first."""
    put_varint(out, len(rest.odd))
    if not len(rest.odd):
        return
    sizes = np.array([len(one) for one in rest.odd_packets], np.int64)
    numbers = fast.encode_signed((differences(rest.odd.astype(np.int64), 1), differences(sizes, 1)))
    put_varint(out, len(numbers))
    out += numbers
    for size in np.unique(sizes[sizes > 0]).tolist():
        rows = np.frombuffer(b"".join([one for one in rest.odd_packets if len(one) == size]), np.uint8).reshape(
            -1, size
        )
        steps = rows.copy()
        steps[1:] -= rows[:-1]
        kind, packed = min(
            ((_AS_THEY_ARE, compress(rows.tobytes(), _LEVEL)), (_DIFFERENCES, compress(steps.tobytes(), _LEVEL))),
            key=lambda one: len(one[1]),
        )
        out.append(kind)
        put_varint(out, len(packed))
        out += packed
