"""HDL-64E payloads: 1206 bytes <-> flags, azimuths, distances, intensities, time stamp, status. All numbers as sent.

    bytes 0-1199     12 blocks of 100: flag u2, azimuth u2 (0.01 degree), 32 x (distance u2, 2 mm; intensity u1)
    bytes 1200-1203  time stamp u4, microseconds since the top of the hour
    bytes 1204-1205  status type and value (`lidarcodec.sensors.status`)

Everything is little endian. S1, S2, S2.1 and S3 share this layout and differ in the order of the blocks:

* **Single return, S2, S2.1, S3**: six firings, each an upper block (0xEEFF, lasers 0-31) and then a lower one (0xDDFF,
  lasers 32-63) with the same azimuth.
* **Older firmware** (S1, and the real capture in the test data): one lower block and then three upper ones, all with
  azimuths of their own, because the upper lasers fire three times as often. Its last six bytes are text ("DegC",
  "v25c"), neither a time stamp nor a status.
* **Dual return, S2.1 and S3**: three firings, each of four blocks with one azimuth: upper and lower with the strongest
  return, then upper and lower with the last one (the second strongest, where the last is the strongest). VeloView and
  velodyne-decoder both read it so: rotation of block 2 = rotation of block 0, block i + 2 is the second return of block
  i. The flags alternate as in single return, so only the azimuths, or the parameter set in the status bytes, show it.

HDL-64E S3 user manual rev. K, appendix E; S2 manual rev. D, appendix E.

>>> import numpy as np
>>> packets = parse([bytes(1206)])
>>> packets.flags.shape, packets.distances.shape, packets.status.shape
((1, 12), (1, 12, 32), (1, 2))
>>> build(packets) == [bytes(1206)]
True
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import PacketError
from lidarcodec.units import (
    BLOCK_BYTES,
    BLOCKS_PER_PACKET,
    LASERS_PER_BLOCK,
    LOWER_FLAG,
    PACKET_BYTES,
    UPPER_FLAG,
)


class BlockFlag(IntEnum):
    """The two flags of an HDL-64E block. Other values have no meaning and are kept."""

    UPPER = UPPER_FLAG
    """Lasers 0-31."""
    LOWER = LOWER_FLAG
    """Lasers 32-63."""


RETURN_DTYPE = np.dtype([("distance", "<u2"), ("intensity", "u1")])
"""3 bytes: distance in 2 mm steps (0 = no return), intensity."""
BLOCK_DTYPE = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", RETURN_DTYPE, (LASERS_PER_BLOCK,))])
"""100 bytes: 32 lasers at one azimuth."""
PACKET_DTYPE = np.dtype(
    [
        ("blocks", BLOCK_DTYPE, (BLOCKS_PER_PACKET,)),
        ("gps_us", "<u4"),
        ("status_type", "u1"),
        ("status_value", "u1"),
    ]
)
"""1206 bytes: a whole payload."""
assert (BLOCK_DTYPE.itemsize, PACKET_DTYPE.itemsize) == (BLOCK_BYTES, PACKET_BYTES)


class PacketArrays(NamedTuple):
    """Columns of P packets. Those of `parse` are read-only views into the payloads.

    flags (P, 12) u2, azimuth (P, 12) u2 in 0.01 degree, distances (P, 12, 32) u2 in 2 mm steps, intensities (P, 12, 32)
    u1, gps_us (P,) u4, status (P, 2) u1: type and value
    """

    flags: npt.NDArray[np.uint16]
    azimuth: npt.NDArray[np.uint16]
    distances: npt.NDArray[np.uint16]
    intensities: npt.NDArray[np.uint8]
    gps_us: npt.NDArray[np.uint32]
    status: npt.NDArray[np.uint8]


def checked(payload: bytes) -> bytes:
    """The payload itself, if it has 1206 bytes.

    Raises PacketError otherwise.
    """
    if len(payload) != PACKET_BYTES:
        raise PacketError(f"a sensor packet has {PACKET_BYTES} bytes, this one {len(payload)}", len(payload))
    return payload


def records(payloads: Sequence[bytes]) -> npt.NDArray[np.void]:
    """(P,) array of PACKET_DTYPE over a copy of the payloads; read-only.

    Raises PacketError if one of them has not 1206 bytes.
    """
    return np.frombuffer(b"".join([checked(payload) for payload in payloads]), PACKET_DTYPE)


def parse(payloads: Sequence[bytes]) -> PacketArrays:
    """Columns of the payloads, as sent.

    Raises PacketError if one of them has not 1206 bytes. Cost: one copy of the bytes.
    """
    packets = records(payloads)
    blocks = packets["blocks"]
    status = packets.view(np.uint8).reshape(len(packets), PACKET_BYTES)[:, -2:]
    returns = blocks["returns"]
    return PacketArrays(
        blocks["flag"], blocks["azimuth"], returns["distance"], returns["intensity"], packets["gps_us"], status
    )


def build(packets: PacketArrays) -> list[bytes]:
    """Payloads of these columns, the inverse of `parse`.

    Raises PacketError if the arrays do not fit together or a value does not fit its field.
    """
    count = len(packets.gps_us)
    out = np.zeros(count, PACKET_DTYPE)
    fields = (
        (packets.flags, out["blocks"]["flag"]),
        (packets.azimuth, out["blocks"]["azimuth"]),
        (packets.distances, out["blocks"]["returns"]["distance"]),
        (packets.intensities, out["blocks"]["returns"]["intensity"]),
        (packets.gps_us, out["gps_us"]),
        (packets.status, out.view(np.uint8).reshape(count, PACKET_BYTES)[:, -2:]),
    )
    for name, (given, target) in zip(packets._fields, fields, strict=True):
        values = np.asarray(given)
        if values.shape != target.shape or values.dtype.kind not in "iu":
            found = f"{values.dtype}{values.shape}"
            raise PacketError(f"{name} of {count} packets is integers of {target.shape}, not {found}")
        top = np.iinfo(target.dtype).max
        if values.size and not (int(values.min()) >= 0 and int(values.max()) <= top):
            raise PacketError(f"{name} holds a value outside 0..{top}")
        target[...] = values
    data = out.tobytes()
    return [data[start : start + PACKET_BYTES] for start in range(0, len(data), PACKET_BYTES)]
