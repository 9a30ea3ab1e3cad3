"""Measures one codec with one setting on one source: packs, unpacks, decodes and compares every message.

>>> from lidarcodec.settings import StreamSettings
>>> result = bench("sim:city?frames=2", StreamSettings(codec="zstd"))
>>> result["codec"], result["frames"], result["packets_identical"], result["max_error_m"]
('zstd', 2, True, 0.0)
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, Final, Literal

import lidarcodec
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.codecs.base import own_settings
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.errors import DecodeError, SettingsError, SourceError
from lidarcodec.evaluation.geometry import CloudErrors, xyz_of
from lidarcodec.evaluation.metrics import IntensityErrors, RangeErrors, Sizes, times_ms
from lidarcodec.evaluation.range_bands import RangeBands
from lidarcodec.evaluation.turns import Turns
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.packet import Packet, data_packets
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.posed import posed
from lidarcodec.units import FRAME_PACKETS
from lidarcodec.wire import pack, unpack

Metrics = Literal["usual", "all"]
METRICS: Final[tuple[Metrics, ...]] = ("usual", "all")
FRAMES_AT_10HZ: Final = 10
ZSTD_LEVEL: Final = 3
"""Of zstd, with which messages of point clouds are compared."""


def bench(
    spec: str | Path,
    settings: StreamSettings,
    *,
    frames: int | None = None,
    skip: int = 0,
    calibration: Path | None = None,
    poses: Path | None = None,
    metrics: Metrics = "usual",
    learn: int = 0,
    unkept: Counter[str] | None = None,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """The object that `lidarcodec bench --json` prints for one setting.

    frames: number of frames, None for all; skip: number of frames to skip first; metrics: `all` adds error quantiles by
    range and the distances of the clouds (0.4 s a frame); learn: training steps after each frame, for codecs that can
    learn. Their time and gain are in `learned`, not in the other times; unkept: is given what the source counted; tick:
    called after each frame
    Raises SettingsError, UnknownNameError, SourceError, and DecodeError if the codec cannot decode its own messages.
    """
    if settings.base_error_m is not None:
        raise SettingsError(
            "bench cannot measure base_error_m: encode recordings and compare their sizes instead", "base_error_m"
        )
    encoder = StreamEncoder(settings)
    if learn:
        encoder.learn(0)
    run = _Run(encoder, StreamDecoder(), more=MoreErrors() if metrics == "all" else None)
    with open_source(spec, calibration=calibration, poses=poses) as source:
        encoder.prepare(source.sensor)
        cut = frames_and_payloads(source.packets(), source.sensor, encoder.settings.framing)
        for frame, payloads in islice(cut, skip, None if frames is None else skip + frames):
            run.frame(posed(frame, source.poses if poses else None), payloads)
            if learn:
                encoder.learn(learn)
            tick()
        run.flush()
        if unkept is not None:
            unkept |= source.counts
        found = {"origin": source.sensor.origin, "hash": source.sensor.hash}
        name = f"{spec} ({source.caveat})" if source.caveat else str(spec)
    if not run.frames:
        raise SourceError(f"{spec} has no frame after the first {skip}: nothing to measure")
    return {"source": name, **run.result(), "calibration": found, "version": lidarcodec.__version__}


def effective(settings: StreamSettings) -> dict[str, Any]:
    """All settings as plain values, including the codec's settings and their defaults."""
    own = own_settings(table.codec(settings.codec).settings, settings)
    return settings.model_dump(mode="json") | {"codec_settings": own.model_dump(mode="json")}


def frames_and_payloads(
    packets: Iterable[Packet], sensor: SensorModel, framing: str
) -> Iterator[tuple[Frame, list[bytes]]]:
    """Frames, each with its packets' payloads from the source."""
    waiting: deque[bytes] = deque()

    def remembered() -> Iterator[Packet]:
        for packet in packets:
            if not packet.position:
                waiting.append(packet.payload)
            yield packet

    for frame in frames_of(remembered(), sensor, framing):
        yield frame, [waiting.popleft() for _ in range(frame.side.packets if frame.side else 0)]


def kbps_at_10hz(size: int, packets: int) -> float:
    """Mean bitrate for 348 packets ten times a second. size: bytes of the messages of `packets` packets"""
    return round(size * 8 / packets * FRAME_PACKETS * FRAMES_AT_10HZ / 1000, 3)


@dataclass
class MoreErrors:
    """The additional errors of `metrics="all"`."""

    bands: RangeBands = field(default_factory=RangeBands)
    clouds: CloudErrors = field(default_factory=CloudErrors)
    filled: CloudErrors = field(default_factory=CloudErrors)
    intensity: IntensityErrors = field(default_factory=IntensityErrors)

    def add(self, original: Frame, decoded: Frame) -> None:
        """Compare all returns of a frame with its decoded frame."""
        if original.sensor.is_hdl64e:
            self.bands.add(original.range, decoded.range)
        self.intensity.add(original.intensity, decoded.intensity, (original.range > 0) & (decoded.range > 0))
        whole = xyz_of(original.with_(keep=None, lattice=None).cloud())
        self.clouds.add(whole, xyz_of(decoded.cloud()))
        if decoded.lattice is None:
            self.filled.take(self.clouds)
        else:
            self.filled.add(whole, xyz_of(filled(decoded).cloud()))

    def result(self) -> dict[str, Any]:
        """`range_errors`, the fields of `IntensityErrors` and `CloudErrors`, and in `filled` the fields of
        `CloudErrors` with the returns that a receiver interpolates."""
        clouds = {**self.clouds.result(), "filled": self.filled.result()}
        return {"range_errors": self.bands.result(), **self.intensity.result(), **clouds}


@dataclass
class _PerFrame:
    """Times of frames. The time of a group is divided among its frames."""

    seconds: list[float] = field(default_factory=list)
    pending_s: float = 0.0

    def add(self, seconds: float, frames: int) -> None:
        """Count a call of `seconds`, after which `frames` frames were complete."""
        self.pending_s += seconds
        if frames:
            self.seconds += [self.pending_s / frames] * frames
            self.pending_s = 0.0


@dataclass
class _Run:
    """Runs encoder and decoder, and adds up their results."""

    encoder: StreamEncoder
    decoder: StreamDecoder
    more: MoreErrors | None = None
    frames: int = 0
    left_out: int = 0
    packets: int = 0
    payload_bytes: int = 0
    zstd_bytes: int = 0
    points: int = 0
    hdl64e: bool = True
    turns: Turns = field(init=False)
    identical: bool = True
    sizes: Sizes = field(default_factory=Sizes)
    errors: RangeErrors = field(default_factory=RangeErrors)
    encoding: _PerFrame = field(default_factory=_PerFrame)
    decoding: _PerFrame = field(default_factory=_PerFrame)
    waiting: dict[int, tuple[Frame, list[bytes]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.turns = Turns(self.encoder.settings.framing)

    def frame(self, frame: Frame, payloads: list[bytes]) -> None:
        """Encode, pack, unpack, decode and compare one frame."""
        if not self.frames:
            self._warm_up(frame)
        self.frames += 1
        self.packets += len(payloads)
        self.payload_bytes += sum(map(len, payloads))
        if frame.sensor.is_cloud:
            self.zstd_bytes += sum(len(compress(payload, ZSTD_LEVEL)) for payload in payloads)
        self.hdl64e = frame.sensor.is_hdl64e
        if not self.hdl64e:
            self.turns.add(frame, payloads)
        self.points += frame.points
        self._encode(partial(self._reduced_and_encoded, frame, payloads))

    def flush(self) -> None:
        """Take the frames that encoder and decoder still hold.

        Raises DecodeError if a frame was not returned.
        """
        self._encode(self.encoder.flush)
        self._compare(self.decoder.flush())
        if self.waiting:
            raise DecodeError(f"the decoder did not return {len(self.waiting)} of {self.frames} frames")

    def _reduced_and_encoded(self, frame: Frame, payloads: list[bytes]) -> list[Message]:
        messages = self.encoder.encode(frame)
        if self.encoder.left_out:
            self.left_out += 1
            self.identical = False
        else:
            self.waiting[frame.index] = self.encoder.reduced or frame, payloads
        return messages

    def _encode(self, messages: Callable[[], list[Message]]) -> None:
        started = perf_counter()
        coded = [(message, pack(message)) for message in messages()]
        self.encoding.add(perf_counter() - started, sum(message.frame_count for message, _ in coded))
        self._decode(coded)

    def _decode(self, coded: list[tuple[Message, bytes]]) -> None:
        for message, data in coded:
            self.sizes.add(message, len(data))
            started = perf_counter()
            decoded = self.decoder.decode(unpack(data))
            self.decoding.add(perf_counter() - started, len(decoded))
            self._compare(decoded)

    def _compare(self, decoded: list[Frame]) -> None:
        for frame in decoded:
            original, payloads = self.waiting.pop(frame.index)
            sent = original.range if original.keep is None else original.range * original.keep
            self.errors.range_step_m = frame.sensor.range_step_m
            self.errors.add(sent, frame.range)
            if self.more is not None:
                self.more.add(original, frame)
            if self.identical:
                self.identical = b"".join(p.payload for p in data_packets(packets_of(frame))) == b"".join(payloads)

    def _zstd_bits(self) -> float | None:
        """Bits a point of the messages of point clouds, each in a zstd frame as it is."""
        return round(self.zstd_bytes * 8 / self.points, 6) if self.points else None

    def _kbps(self) -> float:
        """kbit/s at ten turns a second. A turn is 348 packets of an HDL-64E; of another sensor it is as it turned."""
        if self.hdl64e:
            return kbps_at_10hz(self.sizes.total, self.packets)
        return round(self.sizes.total * 8 / self.turns.count * FRAMES_AT_10HZ / 1000, 3)

    def _warm_up(self, frame: Frame) -> None:
        """Code one frame with a separate session. Libraries load at their first use, and this must not count as the
        codec's time."""
        decoder = StreamDecoder()
        session = StreamEncoder(self.encoder.settings)
        for message in session.encode(frame) + session.flush():
            decoder.decode(unpack(pack(message)))

    def result(self) -> dict[str, Any]:
        """Fields of the result that do not depend on the source."""
        errors, kept = self.errors, self.errors.points
        return {
            "codec": self.encoder.settings.codec,
            "settings": effective(self.encoder.settings),
            "frames": self.frames,
            "frames_left_out": self.left_out,
            "points": self.points,
            "points_per_frame": round(self.points / self.frames, 3),
            "bits_per_point": self.sizes.bits_per(self.points),
            "ratio": round(self.payload_bytes / self.sizes.total, 6),
            "kbps_at_10hz": self._kbps(),
            "rmse_m": errors.rmse_m,
            "max_error_m": errors.max_error_m,
            "psnr_db": None if errors.psnr_db is None else round(errors.psnr_db, 4),
            "kept_fraction": round(kept / self.points, 6) if self.points else None,
            "lost": errors.lost,
            "invented": errors.invented,
            "bits_per_kept_point": round(self.sizes.total * 8 / kept, 6) if kept else None,
            "kb_per_frame": round(self.sizes.total / self.frames / 1e3, 4),
            "packets_identical": self.identical,
            "encode_ms": times_ms(self.encoding.seconds),
            "decode_ms": times_ms(self.decoding.seconds),
            **({"zstd_bits_per_point": self._zstd_bits()} if self.zstd_bytes else {}),
            **({} if self.more is None else self.more.result()),
            **({} if self.encoder.learned is None else {"learned": self.encoder.learned}),
        }
