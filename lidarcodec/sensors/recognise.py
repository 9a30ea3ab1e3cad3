"""The sensor that sent a stream, by its first packets.

Other Velodyne sensors send 1206 bytes as an HDL-64E does, with return mode and model in the last two. An HDL-64E sends
a status type and value there, and type '7' is the same byte as the return mode "strongest" (0x37): the end of one
packet in sixteen may look like that of another sensor. So the flags of the blocks decide first: only the HDL-64E sends
0xDDFF without 0xCCFF and 0xBBFF, and it never sends 0xEEFF in all twelve blocks. A payload of 1206 bytes with unknown
flags counts as HDL-64E, because the codecs carry any 1206 bytes exactly.

HDL-32E, VLP-16, VLP-32C and VLS-128 user manuals, section "factory bytes".

>>> recognised([bytes(1206)]).model
'hdl64e'
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np

from lidarcodec.errors import PacketError
from lidarcodec.sensor_model import HDL64E, POINTCLOUD2
from lidarcodec.sensors.clouds.sensor import is_cloud
from lidarcodec.sensors.hdl64 import PACKET_DTYPE
from lidarcodec.sensors.models.ouster.sensor import bare_sensor_of
from lidarcodec.sensors.models.table import OUSTERS, PACKETS, Detected, detect, sensor_named
from lidarcodec.units import PACKET_BYTES, POSITION_BYTES, UPPER_FLAG

logger = logging.getLogger(__name__)

HDL64 = "HDL-64E"
RETURN_MODES = frozenset({0x37, 0x38, 0x39})
"""Return modes: strongest, last, dual."""
UNKNOWN: dict[int, str] = {0x23: "VLP-32A or VLP-32B", 0x31: "Velarray"}
"""Model byte -> name of Velodyne sensors whose packets are not known here."""
STREAM_PACKETS = 64
"""Packets that are looked at: four rounds of an HDL-64E's sixteen status types."""
REMEDY = "to take packets of any sensor, add --model packets"


def recognised(payloads: Sequence[bytes]) -> Detected | None:
    """The model that sent these payloads, and the evidence; None if it is no known one."""
    first = payloads[:STREAM_PACKETS]
    found = detect(first)
    if found is not None:
        return found
    right = [payload for payload in first if len(payload) == PACKET_BYTES]
    named = {_unknown_sensor(payload) for payload in right}
    if 2 * len(right) <= len(first) or (len(named) == 1 and None not in named):
        return None
    flags = Counter(np.frombuffer(b"".join(right), PACKET_DTYPE)["blocks"]["flag"].ravel().tolist())
    common = ", ".join(f"{flag:#06x}" for flag, _ in flags.most_common(2))
    return Detected(HDL64E, f"{PACKET_BYTES} bytes, blocks of {common}: {HDL64}")


def check_recognised(payloads: Sequence[bytes]) -> Detected:
    """The same, of at least one payload.

    Raises PacketError that says what the packets are instead.
    """
    found = recognised(payloads)
    if found is not None:
        return found
    sizes = Counter(len(payload) for payload in payloads)
    size = sizes.most_common(1)[0][0] if sizes else 0
    name = next((name for payload in payloads if (name := _unknown_sensor(payload)) is not None), None)
    if size == PACKET_BYTES and name is not None:
        raise PacketError(f"these packets come from a Velodyne {name}, which is not supported: {REMEDY}")
    if size == POSITION_BYTES:
        raise PacketError("these are Velodyne position packets (512 bytes, port 8308), which hold no ranges")
    raise PacketError(f"packets of {size} bytes do not belong to a known sensor: {REMEDY}")


def another_than(model: str, payloads: Sequence[bytes]) -> str | None:
    """What shows that these payloads are of another model than the one that was named; None if nothing does.

    Raises UnknownNameError.
    """
    if model in (PACKETS, POINTCLOUD2) or (model in OUSTERS and takes(model, payloads)):
        return None
    found = recognised(payloads)
    if found is None:
        return None if takes(model, payloads) else "no packet fits"
    return None if found.model == model else found.evidence


def warn_if_another(model: str, payloads: Sequence[bytes], label: str) -> None:
    """Log what shows that these payloads are of another model than the one that was named.

    Raises UnknownNameError.
    """
    evidence = another_than(model, payloads)
    if evidence is not None:
        logger.warning(
            "%s: --model says %s, but these are packets of another sensor (%s): points may be wrong or missing; "
            "leave --model out, and the sensor is recognised",
            label,
            model,
            evidence,
        )


def takes(model: str, payloads: Sequence[bytes]) -> bool:
    """Whether some of these payloads are packets of that model.

    Raises UnknownNameError.
    """
    if model == PACKETS:
        return bool(payloads)
    if model == POINTCLOUD2:
        return any(map(is_cloud, payloads[:STREAM_PACKETS]))
    if model == HDL64E:
        return any(len(payload) == PACKET_BYTES for payload in payloads)
    if model in OUSTERS:
        bare = (bare_sensor_of(payload) for payload in payloads[:STREAM_PACKETS])
        return any(sensor is not None and model.endswith(f"-{sensor.layout.rows}") for sensor in bare)
    sensor = sensor_named(model)
    return any(sensor.layout_of(payload) is not None for payload in payloads[:STREAM_PACKETS])


def _unknown_sensor(payload: bytes) -> str | None:
    """Name of the Velodyne sensor whose packets are not known here; None if it is none of them."""
    if len(payload) != PACKET_BYTES or payload[-2] not in RETURN_MODES or payload[-1] not in UNKNOWN:
        return None
    flags = set(np.frombuffer(payload, PACKET_DTYPE)["blocks"]["flag"][0].tolist())
    return UNKNOWN[payload[-1]] if flags == {UPPER_FLAG} else None
