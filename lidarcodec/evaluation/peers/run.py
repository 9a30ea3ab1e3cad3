"""Measures one peer with one value of its knob on one source. The result has the fields of `bench`, with None for
fields that do not apply.

A peer for x y z or ranges stores only the geometry, so its `geometry` and its `total` are equal. A peer for packets
stores everything, so only the total is known. Errors of points are along the ray from the sensor's origin, relative to
the original point, or to the nearest original point if the order is lost.

>>> from lidarcodec.evaluation.peers.table import peer
>>> result = bench_peer("sim:city?frames=1", "peer:zstd", 3)
>>> result["codec"], result["settings"], result["packets_identical"], result["bits_per_point"]["geometry"]
('peer:zstd', {'level': 3, 'holds': 'packets'}, True, None)
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.evaluation.bench import Metrics, MoreErrors, frames_and_payloads, kbps_at_10hz
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.evaluation.metrics import PEAK_M, RangeErrors, times_ms
from lidarcodec.evaluation.peers.base import Coder, Floats, Peer
from lidarcodec.evaluation.peers.table import peer, versions
from lidarcodec.frame import Frame
from lidarcodec.sources import open_source
from lidarcodec.units import PACKET_BYTES

PLANES = ("range", "mask", "geometry", "intensity", "azimuth", "side", "header", "total")


def bench_peer(
    spec: str | Path,
    name: str,
    value: float,
    *,
    frames: int | None = None,
    skip: int = 0,
    calibration: Path | None = None,
    metrics: Metrics = "usual",
    framing: str = "revolution",
    unkept: Counter[str] | None = None,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """The object that `lidarcodec bench --json` prints for a peer. unkept: is given what the source counted

    Raises UnknownNameError, MissingExtraError, SourceError, and DecodeError if the peer fails on a frame.
    """
    found = peer(name)
    run = _Run(name, found, value, MoreErrors() if metrics == "all" else None)
    with open_source(spec, calibration=calibration) as source:
        source.sensor.only_hdl64e("a comparison with other coders")
        cut = frames_and_payloads(source.packets(), source.sensor, framing)
        for frame, payloads in islice(cut, skip, None if frames is None else skip + frames):
            run.frame(frame, payloads)
            tick()
        if unkept is not None:
            unkept |= source.counts
        origin = {"origin": source.sensor.origin, "hash": source.sensor.hash}
        about = f"{spec} ({source.caveat})" if source.caveat else str(spec)
    if not run.frames:
        raise SourceError(f"{spec} has no frame after the first {skip}: nothing to measure")
    return {"source": about, **run.result(), "calibration": origin, "version": versions(found)}


@dataclass
class _PointErrors:
    """Errors along the ray of points in metres."""

    lost: int = 0
    invented: int = 0
    compared: int = 0
    max_m: float = 0.0
    squared: float = 0.0

    def add(self, original: Floats, decoded: Floats, ordered: bool) -> None:
        self.lost += max(len(original) - len(decoded), 0)
        self.invented += max(len(decoded) - len(original), 0)
        if not len(original) or not len(decoded):
            return
        if not ordered or len(original) != len(decoded):
            decoded = decoded[Cloud(decoded).nearest(original)]
        ray = original / np.maximum(np.linalg.norm(original, axis=1), 1e-9)[:, None]
        off = np.einsum("ij,ij->i", decoded - original, ray)
        self.compared += len(off)
        self.max_m = max(self.max_m, float(np.abs(off).max()))
        self.squared += float(off @ off)

    @property
    def rmse_m(self) -> float | None:
        return math.sqrt(self.squared / self.compared) if self.compared else None

    @property
    def max_error_m(self) -> float | None:
        return round(self.max_m, 6) if self.compared else None

    @property
    def psnr_db(self) -> float | None:
        return 20 * math.log10(PEAK_M / self.rmse_m) if self.rmse_m else None


@dataclass
class _Run:
    name: str
    peer: Peer
    value: float
    more: MoreErrors | None
    frames: int = 0
    packets: int = 0
    points: int = 0
    size: int = 0
    identical: bool = True
    errors: RangeErrors = field(default_factory=RangeErrors)
    offsets: _PointErrors = field(default_factory=_PointErrors)
    encoding: list[float] = field(default_factory=list)
    decoding: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.coder: Coder = self.peer.make(self.value)

    def frame(self, frame: Frame, payloads: list[bytes]) -> None:
        """Code, decode and compare one frame."""
        given = self._given(frame, payloads)
        try:
            data, back = self._there_and_back(given)
        except Exception as error:  # other projects raise errors of any type
            what = f"{self.name} {self.peer.knob}={self.value:g} failed on frame {frame.index}"
            raise DecodeError(f"{what}: {type(error).__name__}: {error}") from error
        self.frames += 1
        self.packets += len(payloads)
        self.points += frame.points
        self.size += len(data)
        self._compare(frame, given, back)

    def _there_and_back(self, given: Any) -> tuple[bytes, Any]:
        if not self.frames:  # libraries load at their first use, and this must not count as the peer's time
            warm = self.peer.make(self.value)
            warm.decode(warm.encode(given))
        started = perf_counter()
        data = self.coder.encode(given)
        between = perf_counter()
        back = self.coder.decode(data)
        self.decoding.append(perf_counter() - between)
        self.encoding.append(between - started)
        return data, back

    def _given(self, frame: Frame, payloads: list[bytes]) -> Any:
        if self.peer.feed == "packets":
            return b"".join(payloads)
        return frame.range if self.peer.feed == "ranges" else _rings(frame)

    def _compare(self, frame: Frame, given: Any, back: Any) -> None:
        if self.peer.feed == "x y z":
            self.offsets.add(given, back, self.peer.ordered)
            if self.more is not None:
                self.more.clouds.add(given, back)
            return
        self.identical &= self.peer.feed == "packets" and back == given
        decoded = frame if self.peer.feed == "packets" else frame.with_(range=back)
        self.errors.add(frame.range, decoded.range)
        if self.more is not None:
            self.more.add(frame, decoded)

    def result(self) -> dict[str, Any]:
        """The result as plain values."""
        feed = self.peer.feed
        whole = feed == "packets"
        errors = self.offsets if feed == "x y z" else self.errors
        bits = dict.fromkeys(PLANES) | {"total": self._per(self.points)}
        kept = self.points - errors.lost
        value = int(self.value) if self.value == int(self.value) and self.peer.knob != "max_error_m" else self.value
        return {
            "codec": self.name,
            "settings": {self.peer.knob: value, "holds": feed},
            "frames": self.frames,
            "frames_left_out": 0,
            "points": self.points,
            "points_per_frame": round(self.points / self.frames, 3),
            "bits_per_point": bits if whole else bits | {"geometry": bits["total"]},
            "ratio": round(self.packets * PACKET_BYTES / self.size, 6) if whole else None,
            "kbps_at_10hz": kbps_at_10hz(self.size, self.packets),
            "rmse_m": errors.rmse_m,
            "max_error_m": errors.max_error_m,
            "psnr_db": None if errors.psnr_db is None else round(errors.psnr_db, 4),
            "kept_fraction": round(kept / self.points, 6) if self.points else None,
            "lost": errors.lost,
            "invented": errors.invented,
            "bits_per_kept_point": self._per(kept),
            "kb_per_frame": round(self.size / self.frames / 1e3, 4),
            "packets_identical": self.identical if whole else None,
            "encode_ms": times_ms(self.encoding),
            "decode_ms": times_ms(self.decoding),
            **self._more(),
        }

    def _per(self, points: int) -> float | None:
        return round(self.size * 8 / points, 6) if points else None

    def _more(self) -> dict[str, Any]:
        if self.more is None:
            return {}
        return self.more.result() | ({"range_errors": None} if self.peer.feed == "x y z" else {})


def _rings(frame: Frame) -> Floats:
    """(N, 3) float64 metres, ring by ring: the order of KITTI's files, which also needs the fewest bits."""
    cloud = frame.cloud()
    return xyz_of(cloud[np.argsort(cloud["ring"], kind="stable")])
