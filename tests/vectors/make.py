"""`python -m tests.vectors.make` writes the shared test vectors that are missing; one that exists is never touched.

A vector is a file of messages, one after the other, and a `.json` of the same name with what every message must
become: an object for each frame, with digests (the first 16 hex digits of SHA-256) of its little-endian arrays.
`golden_*.json` says it of the golden messages of tests/golden, for the codecs that a page decodes. Vectors of point
clouds are in `point_clouds`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec import StreamDecoder, StreamEncoder, wire
from lidarcodec.codecs import table, zstd
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.vectors import cloud_vectors
from tests.vectors.digest import digest
from tests.vectors.other_sensors import STREAMS, expected_of_other, messages_of

FOLDER = Path(__file__).parent
GOLDEN = FOLDER.parent / "golden"
GOLDEN_CODECS = ("raw", "zstd", "pcodec", "predictive", "riddle", "png")
STREAM = 0x1234_5678_9ABC_DEF0


modelled_zstd = independent_encoder(zstd.ZstdSettings, zstd.code_ranges, mask_history=lambda _: True)
"""`zstd` as no encoder writes it, and every decoder must read it: modelled intensities, masks with history."""


def varied() -> list[Frame]:
    """Frames that differ in what fired, what was reduced and what is known."""
    rng = np.random.default_rng(21)
    sent = [
        frames.scene(3),
        frames.scene(3).with_(pose=frames.pose()),
        frames.three_to_one(2),
        frames.noise(1),
        frames.scene(6).with_(keep=rng.random((64, 36)) < 0.02),
        frames.scene(6).with_(keep=rng.random((64, 36)) < 0.02),
        frames.one_return(),
        frames.ordinary()["empty"],
        frames.scene(2, seed=8, intensity=np.full((64, 12), 9, np.uint8), holes=0.0),
        frames.scene(4).with_(sensor=frames.SENSOR.with_convention("veloview")),
    ]
    return [frame.with_(index=index) for index, frame in enumerate(sent)]


def thinned_frames() -> list[Frame]:
    """Frames with walls that go on between columns, with edges, halves that fire in turns, and next to nothing."""
    rng = np.random.default_rng(22)
    sent = []
    for index in range(6):
        frame = frames.scene(4 + index, seed=index, holes=0.02)
        angle = np.radians(np.arange(frame.width) * 0.17)
        walls = np.rint(4000 / np.cos(angle - 0.1 * index)) * (1 + 0.1 * np.arange(64)[:, None])
        walls[:, 20:22] = 1500
        ranges = np.where(frame.range > 0, walls + rng.integers(-3, 4, frame.range.shape), 0)
        sent.append(frame.with_(range=ranges.astype(np.uint16)))
    sent[1] = sent[1].with_(side=None, pose=frames.pose())
    sent[2] = sent[2].with_(azimuth=(sent[2].azimuth + np.uint16(35_500)) % np.uint16(36_000))
    sent += [frames.three_to_one(8), frames.irregular_side(4), frames.one_return(), frames.ordinary()["empty"]]
    return [frame.with_(index=index) for index, frame in enumerate(sent)]


def thinned_streams() -> dict[str, list[Message]]:
    """Messages of frames that are thinned to some of their columns, each to others."""
    made: dict[str, list[Message]] = {}
    for codec, effort in {"zstd": {}, "predictive": {}, "riddle": {"effort": 1}}.items():
        settings = StreamSettings(codec=codec, codec_settings=effort, key_interval=4, reduction="lattice:2")
        encoder = StreamEncoder(settings, STREAM)
        messages: list[Message] = []
        for frame, step in zip(thinned_frames(), (2, 3, 5, 8, 16, 64, 4, 2, 3, 2), strict=True):
            encoder.apply(settings.changed(reduction=f"lattice:{step}"))
            messages += encoder.encode(frame)
        made[f"{codec}_thinned"] = messages
    return made


def streams() -> dict[str, list[Message]]:
    """Messages by name of the vector."""
    made = thinned_streams() | {name: messages_of(stream) for name, stream in STREAMS.items()}
    for name, settings in {
        "raw": StreamSettings(codec="raw", key_interval=4),
        "zstd": StreamSettings(codec="zstd", max_error_m=0, key_interval=4),
        "zstd_coarse": StreamSettings(codec="zstd", max_error_m=0.05, intensity="levels=16", key_interval=4),
        "zstd_ranges": StreamSettings(codec="zstd", max_error_m=0.5, intensity="off", key_interval=4),
    }.items():
        encoder = table.make_encoder(settings, STREAM)
        made[name] = [one for frame in varied() for one in encoder.encode(frame)]
    for name, levels in {"zstd_modelled": "lossless", "zstd_modelled_levels": "levels=7"}.items():
        settings = StreamSettings(codec="zstd", max_error_m=0.01, intensity=levels, key_interval=20)
        modelled = modelled_zstd(table.codec_id("zstd"), settings, STREAM)
        made[name] = [one for frame in varied() for one in modelled.encode(frame)]
    return made | lossy_streams()


def lossy_streams() -> dict[str, list[Message]]:
    """Messages that refer to frames before the last one, as after losses; decoders get all of them."""
    made: dict[str, list[Message]] = {}
    for codec, own in {"zstd": {}, "predictive": {"motion": True}}.items():
        settings = StreamSettings(codec=codec, codec_settings=own, key_interval=20)
        maker = modelled_zstd if codec == "zstd" else table.codec(codec).encoder
        encoder, messages = maker(table.codec_id(codec), settings, STREAM), []
        for frame, needs in zip(varied(), (0, 0, 0, 1, 0, 3, 1, 4, 5, 5), strict=True):
            encoder.refer_to({needs})
            messages += encoder.encode(frame)
        made[f"{codec}_losses"] = messages
    return made


def split(data: bytes) -> Iterator[bytes]:
    """Messages one after the other."""
    while data:
        size = wire.peek(data).total_bytes
        yield data[:size]
        data = data[size:]


def expected_of(frame: Frame, message: Message) -> dict[str, Any]:
    """What a decoder must find in a message; numbers of 64 bits as text. Points: the first, middle and last, metres."""
    if frame.sensor.is_cloud:
        return cloud_vectors.expected_of_cloud(frame)
    if message.planes:
        return expected_of_other(frame, message)
    cloud = frame.cloud()
    shown = [cloud[at] for at in (0, len(cloud) // 2, len(cloud) - 1)] if len(cloud) else []
    fired = frame.fired if frame.lattice is None else frame.fired & np.isin(np.arange(frame.width), frame.lattice)
    return {
        "stream": str(message.stream_id),
        "index": str(frame.index),
        "stamp_ns": str(frame.stamp_ns),
        "sensor": [frame.sensor.name, frame.sensor.hash, frame.sensor.convention, frame.sensor.range_step_m],
        "width": frame.width,
        "returns": int(np.count_nonzero(frame.valid)),
        "range": digest(np.where(frame.valid, frame.range_u16, np.uint16(0))),
        "intensity": digest(frame.intensity),
        "azimuth": digest(frame.azimuth),
        "fired": digest(fired.astype(np.uint8)),
        "pose": None if frame.pose is None else frame.pose[:3].ravel().tolist(),
        **({} if frame.mount is None else {"mount": frame.mount[:3].ravel().tolist()}),
        **({} if frame.lattice is None else _thinned(frame)),
        "points": [[round(float(p[axis]), 4) for axis in "xyz"] + [int(p["intensity"]), int(p["ring"])] for p in shown],
    }


def _thinned(frame: Frame) -> dict[str, Any]:
    """What a decoder must find in a thinned frame, and make up in it. `fired` is that of the columns that were sent."""
    wide = filled(frame)
    made_up = np.zeros(frame.range.shape, np.bool_) if wide.filled is None else wide.filled
    return {
        "lattice": digest(frame.lattice),
        "made_up": int(np.count_nonzero(made_up)),
        "filled": [digest(image) for image in (made_up.astype(np.uint8), wide.range_u16, wide.intensity)],
    }


def expected(data: bytes) -> list[dict[str, Any]]:
    """Of all messages of a file, each of which is one frame."""
    decoder, found = StreamDecoder(), []
    for one in split(data):
        message = wire.unpack(one)
        (frame,) = decoder.decode(message)
        found.append(expected_of(frame, message))
    return found


def golden_files() -> list[Path]:
    """Golden files of the codecs that a page decodes."""
    return sorted(path for codec in GOLDEN_CODECS for path in GOLDEN.glob(f"v1_{codec}_*.bin"))


def _write(path: Path, what: Any) -> None:
    if not path.exists():
        lines = ",\n".join(json.dumps(frame) for frame in what)
        path.write_text(f"[\n{lines}\n]\n")


def main() -> None:
    """Write those that are missing."""
    paths = {FOLDER / f"{name}.bin": messages for name, messages in streams().items()}
    for name, settings in cloud_vectors.STREAMS.items():
        paths[cloud_vectors.FOLDER / f"{name}.bin"] = cloud_vectors.messages_of(settings)
    for path, messages in paths.items():
        if not path.exists():
            path.write_bytes(b"".join(wire.pack(one) for one in messages))
        _write(path.with_suffix(".json"), expected(path.read_bytes()))
    for path in golden_files():
        _write(FOLDER / f"golden_{path.stem}.json", expected(path.read_bytes()))


if __name__ == "__main__":
    main()
