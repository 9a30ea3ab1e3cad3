"""CaptureSource: the packets of one sensor in a pcap or pcapng file, which may be compressed or cut off."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import closing
from ipaddress import ip_address
from itertools import islice
from pathlib import Path
from typing import IO, Final, NamedTuple

from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.files.regular import check_regular
from lidarcodec.packet import UNKEPT_POSITIONS, Packet
from lidarcodec.sensor_model import HDL64E
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.captures.datagrams import Datagram, DatagramReader
from lidarcodec.sources.captures.pcap import MAGICS, Ending, Record, read_pcap
from lidarcodec.sources.captures.pcapng import MAGIC as PCAPNG_MAGIC
from lidarcodec.sources.captures.pcapng import read_pcapng
from lidarcodec.sources.decompress import ByteStream
from lidarcodec.sources.spec import Spec, address_of
from lidarcodec.sources.table_search import SEARCHED_PACKETS, carries_table
from lidarcodec.sources.unkept import OTHER_POSITIONS
from lidarcodec.units import MAX_POSITION_BYTES, PACKET_BYTES, POSITION_BYTES

logger = logging.getLogger(__name__)

FIRST_PACKETS: Final = 1024
"""Number of first packets that are searched for streams: 0.3 s of an HDL-64E. If none of them is of the wanted sender
or port, the file is searched for the first that is, and this many are looked at from there on."""

NAMED_STREAMS: Final = 16
MAX_STREAMS: Final = 64
"""Most streams of a capture in the search for the sensor's stream."""
POSITIONS: Final = "position packets"

LOOK_BYTES: Final = 60
"""Bytes behind the first four that show whether a file is text."""
REMEDY: Final = "Give a capture (.pcap, .pcapng), a recording (.mcap), a rosbag or a KITTI folder"
OF_POINTS: Final = frozenset({".ply", ".pcd", ".las", ".laz", ".csv", ".npz", ".e57"})
"""Endings of files that `convert` writes and nothing here reads."""

Stream = tuple[bytes, int]
"""Sender's address and destination port."""


def stamped_datagrams(
    path: Path, counts: Counter[str], ending: Ending, file: IO[bytes] | None = None
) -> Generator[tuple[int, Datagram]]:
    """(host time in ns, datagram) of every UDP datagram in a capture; time of the frame that completes it.

    file: an open one to read instead of the one at `path`, as of ByteStream
    Raises SourceError if the file cannot be read or is no capture.
    """
    stream = ByteStream(path, file)
    try:
        reader = DatagramReader(counts)
        read = reader.read
        for stamp_ns, linktype, data in _records(path, stream, counts, ending):
            datagram = read(linktype, data)
            if datagram is not None:
                yield stamp_ns, datagram
        reader.finish()
    finally:
        stream.close()
        if stream.problem:
            ending.replace("truncated" if "cut" in stream.problem else "damaged", stream.problem)


def _records(path: Path, stream: ByteStream, counts: Counter[str], ending: Ending) -> Iterator[Record]:
    head = stream.read(4)
    if head[:4] in MAGICS:
        return read_pcap(stream, head, ending)
    if head[:4] == PCAPNG_MAGIC:
        return read_pcapng(stream, head, ending, counts)
    if path.suffix.lower() in OF_POINTS:
        raise SourceError(
            f"{path} holds points, which cannot become packets again: give the capture or recording that they come from"
        )
    what = _contents(head + stream.read(LOOK_BYTES)) if head else stream.problem or "it is empty"
    kind = "recording (.mcap)" if path.suffix.lower() == ".mcap" else "pcap or pcapng file"
    raise SourceError(f"{path} is not a {kind}: {what}. {REMEDY}")


def _contents(begins: bytes) -> str:
    """What the first bytes of a file of no known kind show."""
    if begins.isascii() and b"".join(begins.split()).decode().isprintable():
        return "it is a text file"
    return f"it begins with {begins[:4].hex(' ')}"


class CaptureSource(PacketSource):
    """Packets of one sensor in a capture file: its data packets, and position packets of the same sender.

    Counts: `truncated`, `damaged` (1 if the file ended early), `position packets` (which are given), and data that is
    not given: `position packets not kept` (of another sender), `position packets to another port`, `wrong length`,
    `other stream`, `other datagrams`, `other traffic`, ...
    """

    def __init__(
        self,
        path: Path,
        calibration: Path | None = None,
        port: int | None = None,
        src: str | None = None,
        position: int | None = None,
        model: str | None = None,
    ) -> None:
        """Reads the first packets, to find the streams and the sensor of the chosen one.

        model: of the sensor, as in `--model`; by default the one that the packets show
        port, src: destination port and sender's address of the stream to take; by default the most frequent stream.
        position: destination port of its position packets, by default 8308 (of an Ouster's inertial unit: the port
        after the data's); 0: leave them out.
        Raises SourceError if the file cannot be read or has no such stream, PacketError for another sensor,
        CalibrationError.
        """
        from lidarcodec.sensors.find import find_sensor
        from lidarcodec.sensors.models.table import auxiliary_port

        self.path = path
        address = None if src is None else address_of(src).packed
        beside, ending = self._check(), Ending()
        datagrams = self._datagrams(Counter(), ending)
        self.stream, payloads, self.start_ns, found = _choose(
            path, datagrams, ending, port, address, model, search=calibration is None
        )
        super().__init__(find_sensor(beside, calibration, payloads, found))
        self.label = f"capture {path.name}, {_name(self.stream)}"
        self._warned = False
        usual = auxiliary_port(self.sensor.model, self.stream[1])
        self._position_port = usual if position is None else position

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> CaptureSource:
        """The source for a path with options `?port=`, `?src=` and `?position=`."""
        spec.only("port", "src", "position", "model")
        port, src = spec.whole("port", 1, 65535), spec.options.get("src")
        return cls(spec.path, calibration, port, src, spec.position_port(), spec.model())

    def packets(self) -> Iterator[Packet]:
        """Packets in order of the file, from its beginning at each call. Cost: about 3 us a packet."""
        ending = Ending()
        counts, chosen, hdl64e = self.counts, self.stream, self.sensor.is_hdl64e
        for stamp_ns, (source, _, port, payload) in self._datagrams(counts, ending):
            if self.closed:
                return
            if (source, port) == chosen and (not hdl64e or len(payload) == PACKET_BYTES):
                yield Packet(payload, stamp_ns)
                continue
            cause = self._other((source, port), len(payload))
            counts[cause] += 1
            if cause == POSITIONS:
                yield Packet(payload, stamp_ns, position=True)
        if ending.cause:
            counts[ending.cause] = 1
            if not self._warned:
                self._warned = True
                logger.warning(
                    "%s is %s: %s. Only the packets before that place were read", self.path, ending.cause, ending.text
                )

    def _check(self) -> Path | None:
        """The path beside which a calibration may lie. Raises SourceError if this is no file."""
        try:
            check_regular(self.path)
        except OSError as error:
            raise SourceError(f"cannot open {self.path}: {error.strerror or error}") from None
        return self.path

    def _datagrams(self, counts: Counter[str], ending: Ending) -> Iterator[tuple[int, Datagram]]:
        """The datagrams from the first one, at each call."""
        return stamped_datagrams(self.path, counts, ending)

    def _other(self, stream: Stream, size: int) -> str:
        """The counter for a datagram that is not a data packet of the chosen stream. POSITIONS: it is kept."""
        if stream == (self.stream[0], self._position_port):
            return POSITIONS if size <= MAX_POSITION_BYTES else "wrong length"
        if size == PACKET_BYTES:
            return "other stream"
        if stream == self.stream:
            return "wrong length"
        if size != POSITION_BYTES:
            return "other datagrams"
        return OTHER_POSITIONS if stream[0] == self.stream[0] else UNKEPT_POSITIONS


class Choice(NamedTuple):
    """The stream to take, its first payloads, the host time of the first, and the model of its sensor."""

    stream: Stream
    payloads: list[bytes]
    start_ns: int
    model: str


def _choose(
    path: Path,
    datagrams: Iterator[tuple[int, Datagram]],
    ending: Ending,
    port: int | None,
    source: bytes | None,
    model: str | None,
    search: bool,
) -> Choice:
    """The stream to take; its first payloads are enough to `search` for a calibration.

    datagrams: of the file, from the first one;  ending: why they ended early

    Raises SourceError if there is none, PacketError if none is of a known sensor, UnknownNameError for the model.
    """
    lengths = Counter[int]()
    streams: dict[Stream, list[bytes]] = {}
    others: dict[Stream, None] = {}
    stamps: dict[Stream, int] = {}
    last = FIRST_PACKETS
    for count, (stamp_ns, (sender, _, target, payload)) in enumerate(datagrams, 1):
        lengths[len(payload)] += 1
        if port not in (None, target) or source not in (None, sender):
            if len(others) < NAMED_STREAMS:
                others[sender, target] = None
        elif (sender, target) in streams or len(streams) < MAX_STREAMS:
            last = last if streams else max(last, count + FIRST_PACKETS - 1)
            streams.setdefault((sender, target), []).append(payload)
            stamps.setdefault((sender, target), stamp_ns)
        if count >= last and (streams or not others):
            break
    if not streams and others:
        raise SourceError(f"{path} has no such stream; its streams are: {', '.join(map(_name, others))}")
    if not streams:
        raise SourceError(f"{path} holds no sensor packets{_seen(lengths)}{'; ' + ending.text if ending.text else ''}")
    chosen, found = _recognised(
        str(path), sorted(streams, key=lambda one: -sum(map(len, streams[one]))), streams, model
    )
    if found is None:
        raise SourceError(f"{path} holds no packets of a known sensor{_seen(lengths)}; to take packets of any "
        "sensor, add --model packets")  # fmt: skip
    payloads = streams[chosen]
    if found == HDL64E:
        payloads = [one for one in payloads if len(one) == PACKET_BYTES]
        if search and carries_table(payloads):
            more = (d.payload for _, d in datagrams if (d.source, d.port) == chosen and len(d.payload) == PACKET_BYTES)
            payloads.extend(islice(more, SEARCHED_PACKETS - len(payloads)))
    if isinstance(datagrams, Generator):
        datagrams.close()
    return Choice(chosen, payloads, stamps[chosen], found)


def _recognised(
    label: str, wanted: list[Stream], streams: dict[Stream, list[bytes]], model: str | None
) -> tuple[Stream, str | None]:
    """The first of these streams that is of the named model, or of a known one; None as its model: there is none."""
    from lidarcodec.sensors.recognise import recognised, takes, warn_if_another

    if model is not None:
        chosen = next((one for one in wanted if takes(model, streams[one])), wanted[0])
        warn_if_another(model, streams[chosen], label)
        return chosen, model
    for stream in wanted:
        found = recognised(streams[stream])
        if found is not None:
            return stream, found.model
    return wanted[0], None


class Sender(NamedTuple):
    """One sensor in a capture: its address and destination port, and its model."""

    stream: Stream
    model: str

    def __str__(self) -> str:
        return f"{self.model} at {_name(self.stream)}"


def senders_of(path: Path) -> list[Sender]:
    """The sensors among the first packets of a capture; none of a file that cannot be read, or holds none.

    Raises nothing for damage: what lies before it counts.
    """
    from lidarcodec.sensors.recognise import STREAM_PACKETS, recognised

    streams: dict[Stream, list[bytes]] = {}
    try:
        with closing(stamped_datagrams(path, Counter(), Ending())) as datagrams:
            for _, (sender, _, target, payload) in islice(datagrams, FIRST_PACKETS):
                if (sender, target) in streams or len(streams) < MAX_STREAMS:
                    payloads = streams.setdefault((sender, target), [])
                    payloads += [payload] * (len(payloads) < STREAM_PACKETS)
    except LidarCodecError:
        return []
    found = {stream: recognised(payloads) for stream, payloads in streams.items()}
    return [Sender(stream, one.model) for stream, one in found.items() if one is not None]


def _name(stream: Stream) -> str:
    return f"{ip_address(stream[0])} to port {stream[1]}"


def _seen(lengths: Counter[int]) -> str:
    if not lengths:
        return ": no UDP datagrams at all"
    sizes = ", ".join(f"{count} of {size} bytes" for size, count in lengths.most_common(3))
    return f" of {PACKET_BYTES} bytes; its UDP datagrams are: {sizes}"
