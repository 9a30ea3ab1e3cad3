"""RecordingSource: the packets of a recording, as they were recorded, or decoded from its messages."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO, Final, Literal

from lidarcodec.assembly import packets_of
from lidarcodec.errors import (
    CalibrationError,
    DecodeError,
    MissingReferenceError,
    SettingsError,
    SourceError,
    UnknownNameError,
)
from lidarcodec.files.regular import open_regular
from lidarcodec.frame import Frame
from lidarcodec.layers import RefinedFrame
from lidarcodec.message import Message, SectionType
from lidarcodec.mounting import MOUNT_TEXT, Mounting
from lidarcodec.packet import Packet, data_packets
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.planes.plane_section import read_head
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.recording.layer_counts import LayerCounts
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import check_recognised, find_sensor
from lidarcodec.settings import is_name
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.described import sensor_noted
from lidarcodec.sources.posed import CarriedPoses
from lidarcodec.sources.spec import Spec
from lidarcodec.sources.table_search import SEARCHED_PACKETS

logger = logging.getLogger(__name__)

Channel = Literal["packets", "messages"]
CHANNELS: Final[tuple[Channel, ...]] = ("packets", "messages")
_THINNED: Final = (SectionType.KEEP, SectionType.LATTICE)


def is_thinned(message: Message) -> bool:
    """Whether a message that was decoded says that not all returns of its frame were sent."""
    if any(section.type in _THINNED for section in message.sections):
        return True
    return message.has(SectionType.PLANES) and read_head(message.section(SectionType.PLANES)).reduced


class RecordingSource(PacketSource):
    """Packets of a recording: its raw packets if it has any, otherwise decoded from its messages.

    channel: "packets" or "messages", which of the two is read;  topic: of the MCAP channel, None: the first
    coded_bytes: of the messages and refinements that were read so far
    Counts: `truncated` (1 if the file was cut), `damaged`, `position packets`, `undecoded messages`, `missing
    references`, `frames without packets` (not made from packets), `not refined` (frames of two layers that are not
    refined whole), `thinned frames` (of which not all returns were sent).
    """

    def __init__(
        self, path: Path, calibration: Path | None = None, channel: Channel | None = None, topic: str | None = None
    ) -> None:
        """Reads the beginning.

        channel: "packets" or "messages", for a recording with both;  topic: of the MCAP channel, by default the first
        Raises SourceError if this is no recording or has nothing that can be read, PacketError for packets of another
        sensor, CalibrationError.
        """
        self.path, self.topic = path, topic
        self.coded_bytes = 0
        raw = data_packets(self._raw(Counter(), warn=False))
        first = [] if channel == "messages" else list(islice(raw, SEARCHED_PACKETS))
        self.channel: Channel = "packets" if first else "messages"
        failed: list[DecodeError] = []
        frame = next(self._frames(Counter(), failed, warn=False), None) if channel != "packets" else None
        if not first and frame is None:
            why = f": {failed[0]}" if failed else f" and no {channel}" * bool(channel)
            raise SourceError(f"{path} has no frame that can be decoded{why}")
        super().__init__(self._found_sensor(calibration, [packet.payload for packet in first], frame))
        self.start_ns = first[0].stamp_ns if first else frame.stamp_ns if frame else None
        self.carried = CarriedPoses() if self.channel == "messages" else None
        self.names = self._said_names()
        self.mount = self._said_mount() if frame is None or frame.mount is None else Mounting.of_matrix(frame.mount)
        self.label = f"recording {path.name}, {'raw packets' if first else 'decoded messages'}"

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> RecordingSource:
        """The source for a path with options `?read=packets|messages` and `?topic=`."""
        spec.only("read", "topic")
        text = spec.options.get("read")
        channel = next((c for c in CHANNELS if c == text), None)
        if text is not None and channel is None:
            raise UnknownNameError("part of a recording", text, CHANNELS)
        return cls(spec.path, calibration, channel, spec.options.get("topic"))

    def _found_sensor(self, calibration: Path | None, payloads: list[bytes], frame: Frame | None) -> SensorModel:
        """With raw packets that of the packets, but a frame's sensor is preferred to a generic one. Otherwise that of
        the first frame."""
        if not payloads and frame is not None:
            given = calibration is not None and not frame.sensor.is_cloud
            return find_sensor(None, calibration, [], frame.sensor.model) if given else frame.sensor
        model = check_recognised(payloads).model if frame is None else frame.sensor.model
        sensor = sensor_of_packets(self.path, calibration, payloads, model)
        return frame.sensor if frame is not None and sensor.origin == "generic" else sensor

    def _said_mount(self) -> Mounting | None:
        """The mounting in the texts of a recording of packets; None without one, and for a text that is none."""
        with self.opened() as file:
            text = RecordingReader(file, warn=False).metadata.get(MOUNT_TEXT)
        try:
            return None if text is None else Mounting.parse(text)
        except SettingsError:
            return None

    def _said_names(self) -> tuple[str, str] | None:
        """The names of vehicle and sensor in the texts; None without both."""
        with self.opened() as file:
            about = RecordingReader(file, warn=False).metadata
        vehicle, sensor = about.get("vehicle", ""), about.get("sensor", "")
        return (vehicle, sensor) if is_name(vehicle) and is_name(sensor) else None

    def span(self) -> tuple[int, int]:
        """Stamps in ns of the first and the last message or packet in the recording."""
        with self.opened() as file:
            found = RecordingReader(file, warn=False).span()
        return found or (self.start_ns or 0, self.start_ns or 0)

    def packets(self, start_ns: int | None = None) -> Iterator[Packet]:
        """Packets in the order of the recording, from its beginning at each call, or from the frame at `start_ns`."""
        if self.channel == "packets":
            source = self._raw(self.counts, start_ns=start_ns)
        else:
            frames = self.frames(start_ns) if self.carried is None else self.carried.taken(self.frames(start_ns))
            source = (packet for frame in frames for packet in self._packets_of(frame))
        for packet in source:
            if self.closed:
                return
            if packet.position:
                self.counts["position packets"] += 1
            yield packet

    def frames(self, start_ns: int | None = None) -> Iterator[Frame]:
        """Frames decoded from the messages, from the first one, or the first at or after `start_ns`. Messages that do
        not decode are counted.
        """
        found = self._frames(self.counts, [], start_ns=start_ns)
        return found if start_ns is None else (frame for frame in found if frame.stamp_ns >= start_ns)

    def _packets_of(self, frame: Frame) -> list[Packet]:
        try:
            return packets_of(frame)
        except DecodeError:
            self.counts["frames without packets"] += 1
            return []

    def _raw(self, counts: Counter[str], warn: bool = True, start_ns: int | None = None) -> Iterator[Packet]:
        with self.opened() as file:
            reader = RecordingReader(file, warn)
            yield from reader.packets(start_ns, topic=self.topic)
            _note(reader, counts)

    def _frames(
        self, counts: Counter[str], failed: list[DecodeError], warn: bool = True, start_ns: int | None = None
    ) -> Iterator[Frame]:
        def fail(error: DecodeError) -> None:
            missing = isinstance(error, MissingReferenceError)
            counts["missing references" if missing else "undecoded messages"] += 1
            failed.append(error)
            del failed[1:]

        decoder, layers = StreamDecoder(), LayerCounts()
        refined: list[RefinedFrame] = []
        with self.opened() as file:
            reader = RecordingReader(file, warn)
            messages = self._counted(reader, start_ns)
            for message, frames in decoded(reader, messages, decoder.decode, fail, refined.append):
                if frames:
                    if is_thinned(message):
                        counts["thinned frames"] += len(frames)
                    layers.add(reader, message, refined.pop() if refined else None)
                    if left := layers.unrefined:
                        counts["not refined"] = left
                yield from frames
            yield from decoder.flush()
            _note(reader, counts)

    def _counted(self, reader: RecordingReader, start_ns: int | None) -> Iterator[tuple[int, bytes]]:
        """The messages. Counts their bytes, and those of refinements."""
        size = 0
        for stamp_ns, data in reader.messages(start_ns, topic=self.topic):
            size += len(data)
            self.coded_bytes = size + reader.refinements.came_bytes
            yield stamp_ns, data
        self.coded_bytes = size + reader.refinements.came_bytes

    def opened(self) -> IO[bytes]:
        """The open file.

        Raises SourceError if it cannot be opened.
        """
        try:
            return open_regular(self.path)
        except OSError as error:
            raise SourceError(f"cannot open {self.path}: {error.strerror or error}") from None


def _note(reader: RecordingReader, counts: Counter[str]) -> None:
    """Copy the counts of the reader."""
    if reader.counts["cut"]:
        counts["truncated"] = 1
    for name in ("damaged", "mixed streams", "late messages"):
        if reader.counts[name]:
            counts[name] = reader.counts[name]


def sensor_of_packets(path: Path, calibration: Path | None, payloads: list[bytes], model: str) -> SensorModel:
    """The sensor of a recording's packets, found as for a capture. A calibration that was given, or lies beside it, is
    preferred to the one in its texts, and that to the sensor's own table and a generic one."""
    sensor = find_sensor(path, calibration, payloads, model)
    if sensor.origin not in ("generic", "stream"):
        return sensor
    try:
        with open_regular(path) as file:
            own = sensor_noted(RecordingReader(file, warn=False).metadata, model, payloads)
    except CalibrationError as error:
        logger.warning("the calibration in %s is not used: %s", path, error)
        return sensor
    return own or sensor
