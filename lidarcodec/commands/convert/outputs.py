"""Output formats of `convert`: captures, recordings of packets, and bags of ROS 2. All take packets."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Literal, Protocol

from lidarcodec.assembly import Assembler
from lidarcodec.commands.turns import turns_of
from lidarcodec.errors import PacketError, SettingsError
from lidarcodec.evaluation.coded_recording import UNNAMED, Named
from lidarcodec.mounting import MOUNT_TEXT
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import MAX_ODD_BYTES
from lidarcodec.recording import RecordingWriter, RosbagWriter
from lidarcodec.recording.rosbag import CLOUDS_TOPIC, FRAME_ID, PACKETS_TOPIC
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.sources.described import noted
from lidarcodec.sources.posed import posed
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS, PACKET_BYTES

logger = logging.getLogger(__name__)

Form = Literal["pcap", "recording", "packets", "rosbag"]
FORMS: Final[tuple[Form, ...]] = ("pcap", "recording", "packets", "rosbag")


@dataclass(frozen=True)
class Wanted:
    """Options of the output: its format, and options of some formats.

    clouds: whether a recording or a bag also has points;  topic, frame_id: names in a bag;  named: names in a recording
    """

    form: Form
    clouds: bool = False
    topic: str = PACKETS_TOPIC
    frame_id: str = FRAME_ID
    named: Named = UNNAMED


class Output(Protocol):
    """Takes packets; `close` completes the output. left_out: packets so far that the format cannot hold"""

    left_out: int

    def write(self, packet: Packet) -> None:
        """Append one packet."""

    def close(self) -> str:
        """Complete the output without closing the file. Returns a remark for the summary, or an empty text."""


def form_of(out: Path, given: str | None) -> Form | None:
    """The given format of packets, otherwise that of the name's ending; None if it is a format of frames. A name
    without an ending is the folder of a bag.

    Raises SettingsError if the name does not fit the format.
    """
    ending = out.suffix.lower()
    by_name: dict[str, tuple[Form, ...]] = {
        ".pcap": ("pcap",),
        ".mcap": ("recording", "packets", "rosbag"),
        "": ("rosbag",),
    }
    possible = by_name.get(ending, ())
    if given is None:
        return possible[0] if possible else None
    form = next((one for one in FORMS if one == given), None)
    if form is not None and form not in possible:
        fits = next(name for name, forms in by_name.items() if form in forms) or "no ending, for a folder"
        raise SettingsError(f"--as {given} does not fit {out}: its name must end in {fits}", "as")
    return form


def open_output(
    wanted: Wanted,
    handle: BinaryIO,
    source: PacketSource,
    about: Mapping[str, str],
) -> Output:
    """The output of a source's packets, for an open binary file. CodedRecording makes recordings of other codecs."""
    if wanted.form == "pcap":
        return _Capture(handle)
    if wanted.form == "packets":
        said = {} if source.mount is None else {MOUNT_TEXT: str(source.mount)}
        return _Packets(handle, wanted.named.known(source), {**about, **said, **noted(source.sensor)})
    return Bag(wanted, handle, source)


class _Capture:
    left_out = 0

    def __init__(self, handle: BinaryIO) -> None:
        self._writer = PcapWriter(handle)

    def write(self, packet: Packet) -> None:
        self._writer.write(packet)

    def close(self) -> str:
        return ""


class _Batches:
    """Collects packets into batches. put: gets each batch; the last one may be empty;  turns: of this sensor, a batch
    each, and never more than MAX_PACKETS; else 348 packets"""

    def __init__(self, put: Callable[[list[Packet]], None], *, turns: SensorModel | None = None) -> None:
        self._put, self._most = put, MAX_PACKETS if turns else FRAME_PACKETS
        self._rotation = None if turns is None else turns_of(turns)
        self._batch: list[Packet] = []

    def add(self, packet: Packet) -> None:
        if self._rotation is not None and self._rotation.begins(packet.payload):
            self.flush()
        self._batch.append(packet)
        if len(self._batch) == self._most or len(packet.payload) > MAX_ODD_BYTES:
            self.flush()

    def flush(self) -> None:
        batch, self._batch = self._batch, []
        self._put(batch)


class _Packets:
    """Bare packets in a recording."""

    left_out = 0

    def __init__(self, handle: BinaryIO, names: tuple[str, str], about: Mapping[str, str]) -> None:
        self._writer = RecordingWriter(handle, *names, None, about)
        self._batches = _Batches(self._writer.write_packets)

    def write(self, packet: Packet) -> None:
        self._batches.add(packet)

    def close(self) -> str:
        self._batches.flush()
        self._writer.close()
        return ""


class Bag:
    """Scans, and optionally points, in a bag; of a source of point clouds its messages.

    writer: the writer of the bag, for its metadata
    """

    def __init__(self, wanted: Wanted, handle: BinaryIO, source: PacketSource) -> None:
        sensor, self._poses, self._mount = source.sensor, source.poses or source.carried, source.mount
        points_topic = CLOUDS_TOPIC if wanted.topic == PACKETS_TOPIC else wanted.topic
        if not sensor.is_cloud:  # two sensors, each with a topic of its own, keep their points apart, too
            points_topic = wanted.topic.removesuffix("_packets") + "_points"
        self.writer = RosbagWriter(
            handle, packets_topic=wanted.topic, points_topic=points_topic, frame_id=wanted.frame_id
        )
        self._clouds = sensor.is_cloud
        self._batches = _Batches(self.writer.write_scan, turns=sensor)
        self._assembler = Assembler(sensor) if wanted.clouds else None
        self._positions = self._packets = self.left_out = 0

    def write(self, packet: Packet) -> None:
        """Raises PacketError if the first packet is none of a Velodyne."""
        if packet.position:
            self._positions += 1
            return
        if self._clouds:
            self.writer.write_message(packet.stamp_ns, packet.payload)
            return
        if (size := len(packet.payload)) != PACKET_BYTES:
            if not self._packets:
                raise PacketError(
                    f"a rosbag of packets is for a Velodyne, and this sensor sends {size} bytes, not {PACKET_BYTES}: "
                    "for its points add --as clouds (a rosbag, too) or --as ply (a file for each frame)"
                )
            self.left_out += 1
            return
        self._packets += 1
        self._batches.add(packet)
        frame = None if self._assembler is None else self._assembler.push(packet)
        if frame is not None:
            self.writer.write_cloud(posed(frame, self._poses, mount=self._mount))

    def close(self) -> str:
        self._batches.flush()
        last = None if self._assembler is None else self._assembler.flush()
        if last is not None:
            self.writer.write_cloud(posed(last, self._poses, mount=self._mount))
        self.writer.close()
        if self._positions:
            logger.warning("a rosbag cannot hold position packets: %d were left out", self._positions)
        if self.writer.left_out:
            logger.warning("%s", self.writer.not_kept())
        return ", ".join(f"{topic.count} {topic.name}" for topic in self.writer.topics)
