"""What two parts both have: a part of `cut` begins with frames of the part before it, because its own need them. And
whether a part is what it was when it was checked."""

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


class Content:
    """Tells all messages of a file, and their order, from any others."""

    def __init__(self) -> None:
        self._digest = blake2b(digest_size=16)

    @classmethod
    def of(cls, everything: Iterable[Copied]) -> bytes:
        """That of a file."""
        content = cls()
        for channel, stored in everything:
            content.add(digest_of(channel, stored))
        return content.told()

    def add(self, digest: bytes) -> None:
        """The digest of the next message."""
        self._digest.update(digest)

    def told(self) -> bytes:
        """That of the messages so far."""
        return self._digest.digest()
