"""Inputs for native/fuzz/fuzz_session.cpp: streams of messages of every codec that a session of the core decodes.

A byte says how they are decoded; then comes each message behind its length. Calibrations are not compressed, and
networks are small ones that the stream brings, so that a fuzzer can change both (native/fuzz/parts/fuzz_messages.hpp).
"""

from __future__ import annotations

import contextlib
import struct
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec.codecs import table
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.network.learner import Offer
from lidarcodec.network.networks import CASES, Net, quantised
from lidarcodec.network.shelf import native_nets, networks_of
from lidarcodec.network.update import Update, update_of
from lidarcodec.network.weight_file import pack_weights, unpack_weights
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.planes.clouds import columns, positions, section
from lidarcodec.settings import settings_from
from lidarcodec.wire import pack, unpack
from tests.fuzz import configurations, extremes, other_sensors
from tests.vectors.make import split

CODECS = ("raw", "zstd", "pcodec", "riddle", "predictive", "png", "jxl", "jpeg", "jpeg-layered", "h264", "h264-log")
_NAMED = ("PLAIN", "MORE", "FEW", "FREE", "ROUNDED", "REDUCED", "THINNED")
_GOLDEN = Path(__file__).parents[1] / "golden"
_MESSAGES = 4
_MOST_BYTES = 24_000


class _Taught:
    """Stands for a learner that has something to offer after the first frame, and then no more."""

    def __init__(self, update: Update, of: str) -> None:
        self.of, self._frames = (of, 0, True), 0
        self._offer = Offer(update.weights, native_nets(networks_of(update.weights, 2)), update, 0.0)

    def offered(self) -> Offer | None:
        self._frames += 1
        return self._offer if self._frames == 2 else None

    def samples_of(self, frame: Frame, *, expects: bool) -> None:
        """Nothing: it learns no more."""


def _nets(seed: int) -> list[Net]:
    """The smallest networks there can be, of any weights: alone, expecting; the first layers with biases of cases."""
    numbers, nets = np.random.default_rng(seed), []
    for expects, dims in ((False, (72, 8, 8, 32)), (True, (112, 8, 8, 32))):
        shapes = zip(dims[1:], dims[:-1], strict=True)
        net = quantised(expects, 0, [(numbers.normal(0, 0.2, shape), np.zeros(shape[0])) for shape in shapes])
        cases = numbers.integers(-60, 60, (CASES, 8)).astype(np.int8)
        nets.append(replace(net, layers=(replace(net.layers[0], cases=cases), *net.layers[1:])))
    return nets


@cache
def _weights() -> bytes:
    return pack_weights(_nets(3), {})


def _plain(message: Message, frame: Frame) -> Message:
    """The message with its calibration as it is, not compressed."""
    table_of = Section(SectionType.CALIBRATION, encode_calibration(frame.sensor, key=True, plain=True))
    sections = (table_of if s.type == SectionType.CALIBRATION and s.data[0] else s for s in message.sections)
    return replace(message, sections=tuple(sections))


def _together(settings: dict[str, Any], made: list[Frame]) -> list[Frame]:
    """The frames; those of a group are near each other: stamps at both ends of time are none."""
    if settings["codec"] != "jpeg-layered":
        return made
    return [frame.with_(stamp_ns=number) for number, frame in enumerate(made)]


def _coded(settings: dict[str, Any], made: list[Frame], *, learns: bool = False) -> list[Message]:
    with tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-") as folder:
        own = settings.get("codec_settings", {})
        if settings["codec"] == "riddle" and own.get("effort") != 1:
            path = Path(folder) / "own.lcrw"
            path.write_bytes(_weights())
            settings = {**settings, "codec_settings": {**own, "weights": str(path)}}
        encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
        if learns:
            base = unpack_weights(_weights())
            learner = _Taught(update_of(base, _nets(4), (5, 6, 6, 5)), base.name)
            encoder._encoder._ranges._learner = learner  # type: ignore[attr-defined]
        made = _together(settings, made)
        coded = [(encoder.encode(frame, key=frame is made[0]), frame) for frame in made]
        coded.append((encoder.flush(), made[-1]))
        return [_plain(message, frame) for messages, frame in coded for message in messages]


def _raw_zstd(plain: bytes) -> bytes:
    """A zstd frame whose blocks are not compressed, so that a fuzzer can change what it holds."""
    most = 1 << 16
    parts = [plain[at : at + most] for at in range(0, len(plain), most)] or [b""]
    head = struct.pack("<IBI", 0xFD2FB528, 0xA0, len(plain))
    heads = ((len(part) << 3 | (number == len(parts) - 1)).to_bytes(3, "little") for number, part in enumerate(parts))
    return head + b"".join(head_of + part for head_of, part in zip(heads, parts, strict=True))


def _described(message: Message) -> Message:
    """A message of another sensor than an HDL-64E, with its description as it is, not compressed."""

    def plain(section: Section) -> Section:
        if section.type != SectionType.CALIBRATION or not section.data[0]:
            return section
        size = int.from_bytes(section.data[9:13], "little")
        return section._replace(data=section.data[:13] + _raw_zstd(decompress(section.data[13:], size)))

    return replace(message, sections=tuple(map(plain, message.sections)))


def _golden(path: Path) -> list[Message]:
    """The messages of a file; those of riddle with networks of their own."""
    messages = list(map(unpack, split(path.read_bytes())))
    if messages[0].codec == table.codec_id("riddle"):
        own = Section(SectionType.WEIGHTS, _weights())
        messages[0] = replace(messages[0], sections=(own, *messages[0].sections))
    return messages


def _others(seed: int) -> Iterator[list[Message]]:
    """A few frames of every other sensor, by each kind of planes, with tables, steps, few columns and few returns."""
    models = [model for model in other_sensors.SIZES if model not in ("clouds", "os0-128")]
    for place, model in enumerate(models):
        made = other_sensors.SIZES[model](seed)
        of = [*configurations.OTHERS.values(), *configurations.OTHER_PICTURES]
        for number, settings in islice(enumerate(of), place % 2, None, 2):
            at, count = (4 * number + 7 * place) % (len(made) - 3), 3 if settings["codec"] == "riddle" else 2
            encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
            coded = [*map(encoder.encode, _together(settings, made[at : at + count])), encoder.flush()]
            yield [_described(message) for messages in coded for message in messages]


@contextlib.contextmanager
def _cloud_bytes_as_they_are() -> Iterator[None]:
    """Clouds are written with zstd frames whose blocks are not compressed."""
    modules = (section, columns, positions)
    for module in modules:
        module.compress = lambda data, _=3: _raw_zstd(bytes(data))  # type: ignore[attr-defined, assignment]
    try:
        yield
    finally:
        for module in modules:
            module.compress = compress  # type: ignore[attr-defined]


def _clouds(seed: int) -> Iterator[list[Message]]:
    """Every point cloud with each codec, and one that follows it."""
    made = other_sensors.SIZES["clouds"](seed)
    with _cloud_bytes_as_they_are():
        for number, settings in enumerate(configurations.CLOUDS.values()):
            for frame in made[number % 2 :: 2]:
                encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
                coded = [encoder.encode(frame), encoder.encode(frame.with_(index=frame.index + 1))]
                yield [_described(message) for messages in coded for message in messages]


def _streams(seed: int) -> Iterator[list[Message]]:
    tiny, small = extremes.SIZES["tiny"](seed), extremes.small(seed)
    of = [settings for name in _NAMED for settings in getattr(configurations, name).values()]
    for settings in of:
        if settings["codec"] in CODECS:
            yield _coded(settings, tiny)
    for settings in ({"codec": "riddle"}, {"codec": "riddle", "max_error_m": 0.05}):
        yield _coded(settings, tiny, learns=True)
    for codec in CODECS:
        for at in range(0, len(small), _MESSAGES):
            yield _coded({"codec": codec}, small[at : at + _MESSAGES])
    for path in sorted(_GOLDEN.glob("v1_*.bin")):
        if path.stem.split("_")[1] in CODECS:
            yield _golden(path)


def _input(way: int, messages: Iterable[Message]) -> bytes:
    packed = map(pack, messages)
    return bytes([way]) + b"".join(struct.pack("<I", len(data)) + data for data in packed)


def sessions(seed: int) -> Iterator[bytes]:
    """Streams by the class and by the C interface, with and without calls between messages."""
    return _inputs(_streams(seed))


def others(seed: int) -> Iterator[bytes]:
    """The same of other sensors than the HDL-64E, and of point clouds."""
    return _inputs(chain(_others(seed), _clouds(seed)))


def _inputs(streams: Iterable[list[Message]]) -> Iterator[bytes]:
    for number, messages in enumerate(streams):
        for way in (0, 1, 2 * number + 1 & 255):
            data = _input(way, messages[:_MESSAGES])
            if len(data) < _MOST_BYTES:
                yield data
            elif way < 2:
                yield _input(way, messages[:1])[:_MOST_BYTES]
