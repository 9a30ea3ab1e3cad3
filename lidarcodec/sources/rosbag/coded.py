"""Coded messages in a bag: frames and packets of a topic of `point_cloud_interfaces/CompressedPointCloud2`."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from lidarcodec.assembly import packets_of
from lidarcodec.errors import DecodeError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.recording.refinements import Refinements
from lidarcodec.sources.posed import CarriedPoses

logger = logging.getLogger(__name__)


class CodedMessages:
    """Decodes messages of a bag, with a limit of work in proportion to the size of its files.

    size: bytes of the files;  refinements: none, because bags have no topic for them
    carried: the poses in the messages
    Counts, as of a recording: `undecoded messages`, `missing references`, `frames without packets`, `damaged`
    """

    def __init__(
        self, path: Path, files: Iterable[Path], counts: Counter[str], carried: CarriedPoses, *, warn: bool
    ) -> None:
        self.size = sum(file.stat().st_size for file in files)
        self.refinements = Refinements()
        self.carried = carried
        self._path, self._counts, self._warn = path, counts, warn

    def leave_out_rest(self, why: str) -> None:
        """Count and log that the rest is not read. why: the reason"""
        self._counts["damaged"] += 1
        if self._warn:
            logger.warning("%s is damaged: %s. The rest was not read", self._path, why)

    def frames(self, messages: Iterable[bytes]) -> Iterator[Frame]:
        """The frames that can be decoded."""
        decoder = StreamDecoder()
        for _, frames in decoded(self, ((0, data) for data in messages), decoder.decode, self._fail):
            yield from frames
        yield from decoder.flush()

    def packets(self, messages: Iterable[bytes]) -> Iterator[Packet]:
        """The packets of those frames."""
        for frame in self.carried.taken(self.frames(messages)):
            try:
                yield from packets_of(frame)
            except DecodeError:
                self._counts["frames without packets"] += 1

    def _fail(self, error: DecodeError) -> None:
        missing = isinstance(error, MissingReferenceError)
        self._counts["missing references" if missing else "undecoded messages"] += 1
