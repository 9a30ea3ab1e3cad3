"""What is made to fail: commands and the live recorder, each in a folder of its own, and what must hold afterwards.

After a failure the output is absent or as it was before; after none it is whole. Nothing else is left in its folder.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.cli import app
from lidarcodec.codecs import table
from lidarcodec.commands.running import run as running
from lidarcodec.entropy import PredictiveCoder
from lidarcodec.errors import LidarCodecError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.network.shelf import native_nets, networks_of, weights_of
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.recording import RecordingReader
from lidarcodec.settings import settings_from
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import pack, unpack
from tests.contracts import frames
from tests.packets import sensor, turning

PACKETS = 24
STREAM = 6
"""Frames of a stream."""
NETWORKS = "networks of riddle"
STREAMS = tuple(f"stream of {codec}" for codec in table.names())
OLD = b"what stood here before\n"


@dataclass(frozen=True)
class Row:
    """work: done in the folder by a child, whose exit code it gives; check: what is wrong afterwards, by exit code."""

    name: str
    work: Callable[[Path], int]
    check: Callable[[Path, int], list[str]]
    before: Callable[[Path], None] = lambda folder: None


def inputs(folder: Path) -> None:
    """The files that rows read."""
    with (folder / "in.pcap").open("wb") as file:
        PcapWriter(file).write_all(turning(PACKETS))
    running.run(app, ["encode", str(folder / "in.pcap"), str(folder / "in.mcap"), "--codec", "predictive", *SMALL])


SMALL = ["--set", "framing=packets:8"]


def _command(*words: str) -> Callable[[Path], int]:
    """A command; IN and OUT stand for the folders of inputs and outputs."""

    def work(folder: Path) -> int:
        at = {"IN": str(folder.parent / "in"), "OUT": str(folder)}
        return running.run(
            app, [word.replace("IN/", at["IN"] + "/").replace("OUT/", at["OUT"] + "/") for word in words]
        )

    return work


def _packets_in(path: Path) -> int:
    with open_source(path) as source:
        return sum(1 for _ in source.packets())


def _whole(name: str, *, old: bool = False, beside: tuple[str, ...] = ()) -> Callable[[Path, int], list[str]]:
    """Whether the output `name` is whole after success, and absent or `old` after a failure; nothing else is there."""

    def check(folder: Path, code: int) -> list[str]:
        there, out = sorted(path.name for path in folder.iterdir()), folder / name
        wrong = [f"{left} was left behind" for left in there if left != name and left not in beside]
        if code == 0:
            try:
                if (count := _packets_in(out)) != PACKETS:
                    wrong.append(f"{count} of {PACKETS} packets after success")
            except LidarCodecError as error:
                wrong.append(f"after success: {error}")
        elif old:
            wrong += [] if out.is_file() and out.read_bytes() == OLD else ["what stood there before is gone"]
        elif out.exists():
            wrong.append(f"{name} is there after a failure")
        return wrong

    return check


def _old(name: str) -> Callable[[Path], None]:
    def before(folder: Path) -> None:
        (folder / name).write_bytes(OLD)

    return before


@cache
def _messages() -> tuple[bytes, ...]:
    encoder = StreamEncoder(settings_from({"codec": "zstd", "key_interval": 2}), stream_id=1)
    return tuple(pack(m) for frame in frames_of(turning(PACKETS), sensor(), "packets:8") for m in encoder.encode(frame))


def _record(folder: Path) -> int:
    """A live recorder, which is given messages, and packets of a sensor beside it; 1 if it says that it stopped."""
    recorder = BackgroundRecorder(folder / "messages", StreamKeys("v", "s"))
    other = BackgroundRecorder(folder / "packets", StreamKeys("v", "t"))
    recorder.start()
    other.start()
    for message in _messages():
        recorder.message(message)
    other.packets(turning(PACKETS))
    recorder.close()
    other.close()
    states = [recorder.state(), other.state()]
    lost = any(state["stopped"] or state["counts"].get("errors") for state in states)
    recorded = sum(state["counts"].get("messages", 0) for state in states)
    return 1 if lost else 0 if recorded == PACKETS // 8 + 1 else 3


def _readable(folder: Path, code: int) -> list[str]:
    """Whether every file of the recorder can be read, from a key message on."""
    wrong = ["a record is missing, and nobody said so"] if code == 3 else []
    for path in sorted(folder.rglob("*")):
        if path.is_dir():
            continue
        try:
            with path.open("rb") as file:
                reader = RecordingReader(file)
                kinds = [unpack(data).key for _, data in reader.messages()]
                packets = sum(1 for _ in reader.packets())
        except LidarCodecError as error:
            wrong.append(f"{path.name}: {error}")
            continue
        if kinds and not kinds[0]:
            wrong.append(f"{path.name} does not begin with a key message")
        if code == 0 and not kinds and not packets:
            wrong.append(f"{path.name} is empty after success")
    return wrong


@cache
def _frames() -> tuple[Frame, ...]:
    return tuple(frames.scene(2, index=index) for index in range(STREAM))


def _stream(codec: str) -> Callable[[Path], int]:
    """A stream that goes on after a frame that could not be encoded, or a message that could not be decoded.

    1: some were lost so, and each of them was said; 3: frames came that are not what was sent.
    """
    settings = settings_from({"codec": codec, "key_interval": 4})

    def work(_: Path) -> int:
        given, lost, wrong = _frames(), 0, 0
        messages: list[Message] = []
        came: list[Frame] = []
        try:
            encoder = StreamEncoder(settings, stream_id=1)
        except MemoryError:
            sys.stderr.write("no encoder\n")
            return 1
        decoder = StreamDecoder()
        steps: list[Callable[[], list[Message]]] = [partial(encoder.encode, frame) for frame in given]
        for encode in [*steps, encoder.flush]:
            try:
                messages += encode()
            except MemoryError:
                lost += 1
        for message in messages:
            try:
                came += decoder.decode(message)
            except (MemoryError, MissingReferenceError):
                lost += 1
        for frame in came if table.codec(codec).bounded else ():
            sent = given[frame.index]
            wrong += not (np.array_equal(frame.range, sent.range) and np.array_equal(frame.intensity, sent.intensity))
        if wrong or (not lost and len(came) != len(given)):
            return 3
        sys.stderr.write(f"lost {lost}\n" * bool(lost))
        return int(bool(lost))

    return work


def _networks(_: Path) -> int:
    """Coders that are given networks, and others in their place."""
    try:
        nets = native_nets(networks_of(weights_of(""), 2))
        PredictiveCoder(nets=nets).change(nets)
    except MemoryError:
        sys.stderr.write("no coder\n")
        return 1
    return 0


def rows() -> list[Row]:
    """All of them."""
    pcap, mcap = "IN/in.pcap", "IN/in.mcap"
    coded = ["--codec", "predictive", *SMALL]
    made = [
        Row("encode", _command("encode", pcap, "OUT/a.mcap", *coded), _whole("a.mcap")),
        Row("encode, points beside", _command("encode", pcap, "OUT/a.mcap", *coded, "--with-clouds"), _whole("a.mcap")),
        Row("decode to a capture", _command("decode", mcap, "OUT/a.pcap"), _whole("a.pcap")),
        Row("convert to a capture", _command("convert", mcap, "OUT/a.pcap"), _whole("a.pcap", beside=("a_db.xml",))),
        Row("convert to a recording", _command("convert", pcap, "OUT/a.mcap", *coded), _whole("a.mcap")),
        Row("convert to a bag", _command("convert", pcap, "OUT/a"), _whole("a")),
    ]
    for name, words, out in (
        ("encode over an old file", ("encode", pcap, "OUT/a.mcap", *coded, "--force"), "a.mcap"),
        ("convert over an old file", ("convert", pcap, "OUT/a.mcap", *coded, "--force"), "a.mcap"),
    ):
        made.append(Row(name, _command(*words), _whole(out, old=True), _old(out)))
    made += [Row("live recorder", _record, _readable), Row(NETWORKS, _networks, lambda folder, code: [])]
    return made + [Row(name, _stream(name.removeprefix("stream of ")), lambda folder, code: []) for name in STREAMS]
