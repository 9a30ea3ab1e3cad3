"""What can go wrong with an archive, for clients. The log has addresses and reasons; clients get one sentence."""

from __future__ import annotations

from lidarcodec.errors import LidarCodecError


class NoSegmentError(LidarCodecError):
    """The archive has no such segment."""


class AwayArchiveError(LidarCodecError):
    """The archive does not answer, or not in time."""


class BusyArchiveError(LidarCodecError):
    """Too many requests wait for the archive."""


class DamagedArchiveError(LidarCodecError):
    """The index, a commit or a recording of the archive is damaged."""


class FullError(LidarCodecError):
    """There is no room for a copy of a segment, or the disk of the server failed."""
