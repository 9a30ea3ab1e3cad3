"""Damage of stored messages that copying would hand on: a message whose checksum or sizes are wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from lidarcodec import layers, wire
from lidarcodec.errors import DecodeError, UnsupportedVersionError
from lidarcodec.recording.layout import MESSAGE_ENCODING, PACKET_ENCODING, REFINE_ENCODING, unpack_batch
from lidarcodec.recording.records import Channel, Stored

_READ: Final[Mapping[str, Callable[[bytes], Any]]] = {
    MESSAGE_ENCODING: wire.unpack,
    REFINE_ENCODING: layers.unpack,
    PACKET_ENCODING: unpack_batch,
}


def is_damaged(channel: Channel, stored: Stored) -> bool:
    """Whether a message, a refinement or a batch of packets is damaged; one of a newer version is not."""
    read = _READ.get(channel.encoding)
    try:
        if read is not None:
            read(stored.data())
    except UnsupportedVersionError:
        return False
    except DecodeError:
        return True
    return False
