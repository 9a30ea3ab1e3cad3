"""RosbagSource: packets in `velodyne_msgs/VelodyneScan` messages of a rosbag2, from MCAP or SQLite files, the
`sensor_msgs/PointCloud2` messages of a rosbag2 or of a bag of ROS 1, and coded messages in
`point_cloud_interfaces/CompressedPointCloud2`.

It needs no ROS. A bag is a folder with a metadata.yaml and one or more files, or a single such file.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final, TypeVar

import zstandard

from lidarcodec.budgets import EXPANDED_BASE, EXPANDED_TIMES, Allowance, FileTooLargeError, read_file
from lidarcodec.errors import DecodeError, SectionError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.frame import Frame
from lidarcodec.interop import ros
from lidarcodec.interop.compressed_cloud import message_of
from lidarcodec.interop.velodyne_scan import packets_of_scan
from lidarcodec.mounting import Mounting
from lidarcodec.packet import Packet
from lidarcodec.recording import MESSAGE_ENCODING, PACKET_ENCODING, RecordingReader
from lidarcodec.recording.records import MAX_RECORD
from lidarcodec.recording.rosbag import ENCODING, PROFILE
from lidarcodec.sensor_model import POINTCLOUD2
from lidarcodec.sensors import check_recognised, find_sensor, read_calibration
from lidarcodec.sensors.clouds.message import ROS1
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.cloud_packets import CloudPackets
from lidarcodec.sources.decompress import WINDOW_LIMIT
from lidarcodec.sources.posed import CarriedPoses
from lidarcodec.sources.rosbag import bag1, sqlite
from lidarcodec.sources.rosbag.coded import CodedMessages
from lidarcodec.sources.spec import Spec
from lidarcodec.sources.table_search import SEARCHED_PACKETS
from lidarcodec.untrusted.yaml import YamlRefusedError, read_yaml

logger = logging.getLogger(__name__)
Found = TypeVar("Found")

METADATA: Final = "metadata.yaml"
SCAN: Final = ros.VELODYNE_SCAN.name.replace("/msg/", "/")
CLOUD: Final = ros.POINT_CLOUD2.name.replace("/msg/", "/")
CODED: Final = ros.COMPRESSED_CLOUD.name.replace("/msg/", "/")
FIRST_CLOUDS: Final = 2
NAMED_TYPES: Final = 8
"""Clouds that are looked at before the reading begins."""
_WHAT: Final = {SCAN: "packets", CLOUD: "clouds", CODED: "compressed clouds"}
_MAX_FILES: Final = 4096
_ZSTD: Final = b"\x28\xb5\x2f\xfd"


class RosbagSource(PacketSource):
    """Packets of one topic of a bag: those in VelodyneScan messages, PointCloud2 messages, each of which is one, or
    what coded messages decode to.

    Counts: `truncated` (1 if a file was cut), `damaged`, `bad scans` (messages of another type or format), `too long`
    (messages of more than 32 MiB); of coded messages also those of CodedMessages
    """

    def __init__(
        self, path: Path, calibration: Path | None = None, topic: str | None = None, model: str | None = None
    ) -> None:
        """Reads the beginning.

        topic: topic to read, for a bag with several; by default its packets, else its clouds, else its coded messages
        Raises SourceError if this is no bag or has no such topic, PacketError for packets of another sensor,
        CalibrationError.
        """
        self.path = path
        self.files = _files_of(path)
        self.topic, self._kind = _topic_of(path, self.files, topic, model)
        if self._kind == CODED:
            self.carried = CarriedPoses()
            frame = self._first_frame()
            super().__init__(frame.sensor if calibration is None else read_calibration(calibration, "given"))
            self.start_ns = frame.stamp_ns
            self.mount = None if frame.mount is None else Mounting.of_matrix(frame.mount)
        else:
            clouds = self._kind == CLOUD
            first = list(islice(self._read(Counter(), warn=False), FIRST_CLOUDS if clouds else SEARCHED_PACKETS))
            if not first:
                raise SourceError(f"{path} has no readable packet on topic {self.topic}")
            payloads = [packet.payload for packet in first]
            found = POINTCLOUD2 if clouds else model or check_recognised(payloads).model
            super().__init__(find_sensor(path, calibration, payloads, found))
            self.start_ns = first[0].stamp_ns
        self.label = f"rosbag {path.name}, {self.topic}"

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> RosbagSource:
        """The source for a path with an option `?topic=`."""
        spec.only("topic", "model")
        return cls(spec.path, calibration, spec.options.get("topic"), spec.model())

    def packets(self) -> Iterator[Packet]:
        """Packets in the order of the files, from the first at each call."""
        for packet in self._read(self.counts, warn=True):
            if self.closed:
                return
            yield packet

    def _first_frame(self) -> Frame:
        counts = Counter[str]()
        coded = CodedMessages(self.path, self.files, counts, CarriedPoses(), warn=False)
        frame = next(coded.frames(self._each(message_of, counts, warn=False)), None)
        if frame is None:
            raise SourceError(f"{self.path} has no message of lidarcodec that can be decoded on topic {self.topic}")
        return frame

    def _read(self, counts: Counter[str], warn: bool) -> Iterator[Packet]:
        if self.carried is not None:
            coded = CodedMessages(self.path, self.files, counts, self.carried, warn=warn)
            yield from coded.packets(self._each(message_of, counts, warn))
            return
        of = CloudPackets(counts).of if self._kind == CLOUD else packets_of_scan
        for packets in self._each(of, counts, warn):
            yield from packets

    def _each(self, of: Callable[[bytes], Found], counts: Counter[str], warn: bool) -> Iterator[Found]:
        """What `of` makes of each message of the topic. Those from which it raises a DecodeError are counted."""
        expands, seen, number = Allowance(EXPANDED_BASE, EXPANDED_TIMES), 0, 0
        for file in self.files:
            for data in _messages(file, self.topic, counts, warn):
                seen, number = seen + len(data), number + 1
                try:
                    found = of(_plain(data, expands, seen))
                except DecodeError:
                    counts["bad scans"] += 1
                    continue
                yield found
        announced = _announced_count(self.path, self.topic)
        if number < announced:
            counts["damaged"] += 1
            if warn:
                text = "%s: %s announces %d messages of %s, but %d were found"
                logger.warning(text, self.path, METADATA, announced, self.topic, number)


def is_rosbag(path: Path) -> bool:
    """Whether an MCAP file is a bag of ROS 2, not a recording of lidarcodec.

    Raises OSError, SourceError.
    """
    with open_regular(path) as stream:
        reader = RecordingReader(stream, warn=False)
        found = {channel.encoding for channel in reader.channels.values()}
        return reader.profile == PROFILE or (ENCODING in found and not found & {MESSAGE_ENCODING, PACKET_ENCODING})


def _files_of(path: Path) -> list[Path]:
    """Files of a bag, in the order of its metadata."""
    if not path.is_dir():
        return [path]
    about = _information(path / METADATA)
    names = about.get("relative_file_paths")
    if not isinstance(names, list) or not 0 < len(names) <= _MAX_FILES or not all(isinstance(n, str) for n in names):
        raise SourceError(f"{path / METADATA} does not name any file")
    if about.get("compression_mode") == "file":
        raise SourceError(f"the files of {path} are compressed: decompress them first (zstd -d)")
    files = [path / Path(name).name for name in names]  # some versions write the folder before the name
    for file in files:
        if not file.is_file():
            raise SourceError(f"{path} does not contain {file.name}, which {METADATA} names")
    return files


def _information(path: Path) -> dict[str, Any]:
    try:
        found = read_yaml(read_file(path, "bag"))
    except OSError as error:
        raise SourceError(f"cannot open {path}: {error.strerror or error}") from None
    except (FileTooLargeError, YamlRefusedError) as error:
        raise SourceError(f"{path} does not describe a rosbag: {error}") from None
    about = found.get("rosbag2_bagfile_information") if isinstance(found, dict) else None
    if not isinstance(about, dict):
        raise SourceError(f"{path} does not describe a rosbag")
    return about


def _announced_count(path: Path, topic: str) -> int:
    """Number of messages of a topic by the bag's metadata; 0 if it has no number."""
    told = _information(path / METADATA).get("topics_with_message_count") if path.is_dir() else None
    for one in told if isinstance(told, list) else ():
        about = one.get("topic_metadata") if isinstance(one, dict) else None
        if isinstance(about, dict) and about.get("name") == topic and isinstance(one.get("message_count"), int):
            return int(one["message_count"])
    return 0


def _topics(file: Path) -> dict[str, str]:
    if bag1.is_bag(file):
        return bag1.topics(file)
    if sqlite.is_database(file):
        return sqlite.topics(file)
    with open_regular(file) as stream:
        return RecordingReader(stream, warn=False).topics()


def _topic_of(path: Path, files: list[Path], wanted: str | None, model: str | None) -> tuple[str, str]:
    """The topic to read and its type, SCAN, CLOUD or CODED: `wanted`, or the only one with scans, else with clouds,
    else with coded messages."""
    topics: dict[str, str] = {}
    try:
        for file in files:
            topics |= _topics(file)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}") from None
    # ROS 1 called it velodyne_msgs/VelodyneScan, and some bags that were converted still do.
    types = {name: kind.replace("/msg/", "/") for name, kind in topics.items()}
    sought = [SCAN, CLOUD, CODED] if model is None else [CLOUD] if model == POINTCLOUD2 else [SCAN]
    if _in_ros1(files):
        sought = [kind for kind in sought if kind == CLOUD]
    has = {kind: sorted(name for name, of in types.items() if of == kind) for kind in sought}
    names = [name for kind in sought for name in has[kind]]
    if wanted is not None and wanted not in names:
        text = " or ".join(kind for kind in sought if has[kind]) or " or ".join(sought[:2])
        raise SourceError(f"{path} has no {text} on topic {wanted}: choose one of {', '.join(names) or 'none'}")
    if wanted is not None:
        return wanted, types[wanted]
    kind = next((kind for kind in sought if has[kind]), None)
    if kind is None:
        raise SourceError(f"{path} has no {' or '.join(sought)}: the types of its topics are "
        f"{', '.join(sorted(set(types.values()))[:NAMED_TYPES]) or 'no messages'}")  # fmt: skip
    if len(has[kind]) > 1:
        chosen = f"choose one with ?topic=NAME, of {', '.join(has[kind])}"
        raise SourceError(f"{path} has {_WHAT[kind]} on several topics: {chosen}")
    return has[kind][0], kind


def _in_ros1(files: list[Path]) -> bool:
    return any(bag1.is_bag(file) for file in files)


def _messages(file: Path, topic: str, counts: Counter[str], warn: bool) -> Iterator[bytes]:
    if bag1.is_bag(file):
        for data in bag1.messages(file, topic, counts, warn):
            yield ROS1 + data
        return
    if sqlite.is_database(file):
        yield from sqlite.messages(file, topic, counts, warn)
        return
    with open_regular(file) as stream:
        reader = RecordingReader(stream, warn)
        for _, data in reader.others(ENCODING, topic):
            yield data
        if reader.counts["cut"]:
            counts["truncated"] = 1
        if reader.counts["damaged"]:
            counts["damaged"] += reader.counts["damaged"]


def _plain(data: bytes, expands: Allowance, seen: int) -> bytes:
    """A message decompressed, for bags with compressed messages.

    expands: limit of the bytes that all messages decompress to; seen: compressed bytes read so far
    """
    if data[:4] != _ZSTD:
        return data
    if not expands.spend(0, seen):
        raise SectionError(f"compressed messages expand to more than {EXPANDED_TIMES} times their size")
    try:
        if zstandard.frame_content_size(data) > MAX_RECORD:  # zstandard allocates this size whatever the limit below
            raise SectionError(f"a compressed message has more than {MAX_RECORD} bytes")
        plain = zstandard.ZstdDecompressor(max_window_size=WINDOW_LIMIT).decompress(data, max_output_size=MAX_RECORD)
    except zstandard.ZstdError as error:
        raise SectionError(f"a compressed message cannot be read: {error}") from None
    expands.spend(len(plain), seen)
    return plain
