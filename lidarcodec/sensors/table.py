"""The sensor that sent a payload. Payloads of other known sensors are refused by name, unknown ones are accepted.

Other Velodyne sensors send 1206 bytes too, with return mode and model in the last two. An HDL-64E sends a status type
and value there, and type '7' is the same byte as the return mode "strongest" (0x37): the end of one packet in sixteen
may look like that of another sensor. So the flags of the blocks decide first: only the HDL-64E sends 0xDDFF without
0xCCFF and 0xBBFF, and it never sends 0xEEFF in all twelve blocks. A payload with unknown flags counts as HDL-64E,
because the codec can carry any 1206 bytes exactly.

HDL-32E, VLP-16, VLP-32C and VLS-128 user manuals, section "factory bytes".

>>> identify(bytes(1206))
'HDL-64E'
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lidarcodec.errors import PacketError
from lidarcodec.sensors.hdl64 import PACKET_DTYPE
from lidarcodec.units import LOWER_FLAG, PACKET_BYTES, POSITION_BYTES, UPPER_FLAG

HDL64 = "HDL-64E"
ETHERNET_BYTES = 42
RETURN_MODES = frozenset({0x37, 0x38, 0x39})
"""Return modes: strongest, last, dual."""
MODELS: dict[int, str] = {
    0x21: "HDL-32E",
    0x22: "VLP-16",
    0x23: "VLP-32A or VLP-32B",
    0x24: "Puck Hi-Res",
    0x28: "VLP-32C",
    0x31: "Velarray",
    0xA1: "VLS-128",
}
"""Model byte -> name of other Velodyne sensors."""
VLS_FLAGS = frozenset({UPPER_FLAG, LOWER_FLAG, 0xCCFF, 0xBBFF})
STREAM_PACKETS = 64
"""Packets that `identify_stream` looks at: four rounds of an HDL-64E's sixteen status types."""
SUPPORTED = "only the HDL-64E is supported"


def identify(payload: bytes) -> str:
    """Name of the sensor, HDL-64E, from one payload. With several payloads `identify_stream` is more reliable.

    Raises PacketError naming the sensor if it is positively another one, or the length if it is not 1206 bytes.
    """
    other = _other_sensor(_of_right_length(payload))
    if other is not None:
        raise PacketError(f"this packet comes from a Velodyne {other}: {SUPPORTED}", PACKET_BYTES - 1)
    return HDL64


def identify_stream(payloads: Sequence[bytes]) -> str:
    """Name of the sensor, HDL-64E, from the first payloads of a stream: 64 of 1206 bytes, others are skipped.

    One packet that only an HDL-64E sends decides. Another sensor is refused if every packet names the same one.
    Raises PacketError naming the other sensor, or the length, when there are payloads but none of 1206 bytes.
    """
    data = [payload for payload in payloads if len(payload) == PACKET_BYTES][:STREAM_PACKETS]
    if not data and payloads:
        _of_right_length(payloads[0])
    named = {_other_sensor(payload) for payload in data}
    if len(named) == 1 and None not in named:
        raise PacketError(f"these packets come from a Velodyne {named.pop()}: {SUPPORTED}", PACKET_BYTES - 1)
    return HDL64


def _of_right_length(payload: bytes) -> bytes:
    size = len(payload)
    if size == PACKET_BYTES:
        return payload
    if size == POSITION_BYTES:
        what = "is a Velodyne position packet (512 bytes, port 8308), which holds no ranges"
    elif size == PACKET_BYTES + ETHERNET_BYTES:
        what = f"has {size} bytes: is it a packet of {PACKET_BYTES} bytes with Ethernet, IP and UDP headers before it?"
    else:
        what = f"has {size} bytes: a packet of an HDL-64E has {PACKET_BYTES}"
    raise PacketError(f"this payload {what}", min(size, PACKET_BYTES))


def _other_sensor(payload: bytes) -> str | None:
    """Name of the sensor if it cannot be an HDL-64E; None otherwise."""
    mode, model = payload[-2], payload[-1]
    if mode not in RETURN_MODES or model not in MODELS:
        return None
    flags = set(np.frombuffer(payload, PACKET_DTYPE)["blocks"]["flag"][0].tolist())
    if MODELS[model] == "VLS-128":
        # Three firings of four banks; in dual return eight blocks, and the last four are empty (0xFFFF).
        return "VLS-128" if VLS_FLAGS <= flags <= VLS_FLAGS | {0xFFFF, 0} else None
    return MODELS[model] if flags == {UPPER_FLAG} else None
