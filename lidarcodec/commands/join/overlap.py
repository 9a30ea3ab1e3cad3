"""What two parts both have: a part of `cut` begins with frames of the part before it, because its own need them."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b

from lidarcodec.recording.records import Channel, Stored

Copied = tuple[Channel, Stored]


def digest_of(channel: Channel, stored: Stored) -> bytes:
    """Tells a message of a file from all others: its topic, time and bytes."""
    return blake2b(b"%b\0%d\0%b" % (channel.topic.encode(), stored.log_time, stored.data()), digest_size=16).digest()


def digests_of(everything: Iterable[Copied]) -> set[bytes]:
    """Of every message."""
    return {digest_of(channel, stored) for channel, stored in everything}
