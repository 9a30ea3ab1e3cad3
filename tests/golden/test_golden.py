"""Messages that earlier versions wrote. They stand in recordings, so every later version must read them, forever.

A golden file holds messages one after the other, and is named by its format version: `v1_pcodec_lossless.bin`. The
`.json` beside it holds a digest of every frame that must come out. `make golden` writes the files that are missing and
never touches one that exists.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.settings import StreamSettings
from lidarcodec.side import SideInfo
from lidarcodec.wire.header import MAJOR
from tests.contracts import frames

FOLDER = Path(__file__).parent
WRITE = os.environ.get("LIDARCODEC_GOLDEN") == "write"
STREAM = 0x0123_4567_89AB_CDEF


def settings_of() -> dict[str, StreamSettings]:
    """Settings by name of the golden file without version: two for each codec, and those that change the format.

    Those named modelled were written when intensities began to be: the others hold them grouped.
    """
    found: dict[str, StreamSettings] = {}
    for name in table.names():
        bound = 0.01 if table.codec(name).bounded else None
        exact = "lossless" if bound else "default"
        found[f"{name}_{exact}"] = StreamSettings(codec=name, max_error_m=0 if bound else None, key_interval=3)
        found[f"{name}_coarse"] = StreamSettings(codec=name, max_error_m=bound, intensity="levels=16", key_interval=3)
    found["pcodec_modelled_lossless"] = found["pcodec_lossless"]
    found["pcodec_modelled_coarse"] = found["pcodec_coarse"]
    found["predictive_motion"] = StreamSettings(
        codec="predictive", codec_settings={"motion": True}, max_error_m=0.01, key_interval=6
    )
    slab_settings = {"codec": "predictive", "key_interval": 20}
    found["predictive_slabs_lossless"] = StreamSettings(max_error_m=0, **slab_settings)
    found["predictive_slabs_motion"] = StreamSettings(
        max_error_m=0.01, codec_settings={"motion": True}, **slab_settings
    )
    for name in ("predictive", "riddle"):
        found[f"{name}_turns_lossless"] = StreamSettings(
            codec=name, codec_settings={"motion": True}, max_error_m=0, key_interval=20
        )
    # Those before were written when masks of such streams were coded one by one.
    found["predictive_masks_motion"] = found["predictive_motion"]
    found["predictive_masks_slabs_motion"] = found["predictive_slabs_motion"]
    found["riddle_masks_turns_lossless"] = found["riddle_turns_lossless"]
    own = {"motion": True, "weights": str(FOLDER / "cases.lcrw")}
    found["riddle_cases_turns_coarse"] = StreamSettings(
        codec="riddle", codec_settings=own, max_error_m=0.01, key_interval=20
    )
    # Those before were written when firings were not counted.
    found["riddle_firings_slabs_coarse"] = StreamSettings(codec="riddle", max_error_m=0.01, key_interval=20)
    for name in (
        "predictive_lossless",
        "predictive_slabs_motion",
        "predictive_turns_lossless",
        "riddle_turns_lossless",
    ):
        codec, kind = name.split("_", 1)
        found[f"{codec}_firings_{kind}"] = found[name]
    # Those before were written with all contexts.
    quick = ("predictive_lossless", "predictive_slabs_motion", "predictive_turns_lossless")
    found |= {name.replace("_", "_quick_", 1): found[name] for name in quick}
    found["riddle_quick_turns_lossless"] = StreamSettings(
        codec="riddle", codec_settings={"effort": 1}, max_error_m=0, key_interval=20
    )
    # Those before were written with weights that have all tiles.
    found["riddle_tiles_turns_lossless"] = StreamSettings(
        codec="riddle", codec_settings={"effort": 4}, max_error_m=0, key_interval=20
    )
    # Those before, but quick ones, were written when as many bits of an offset learned in every leaf.
    for kind in ("lossless", "slabs_motion", "turns_lossless"):
        full = found[f"predictive_{kind}"]
        own = {"codec_settings": full.codec_settings | {"effort": 2}}
        found[f"predictive_depths_{kind}"] = full.model_copy(update=own)
    found["riddle_depths_turns_lossless"] = found["riddle_turns_lossless"]
    found["riddle_depths_slabs_coarse"] = found["riddle_firings_slabs_coarse"]
    # Those before with a bound were written when ranges were rounded.
    found["predictive_free_coarse"] = found["predictive_coarse"]
    found["predictive_free_slabs_motion"] = found["predictive_slabs_motion"]
    found["riddle_free_turns_coarse"] = StreamSettings(codec="riddle", max_error_m=0.05, key_interval=20)
    for name in ("raw", "zstd"):
        found[f"{name}_positions_lossless"] = found[f"{name}_lossless"]
    found["pcodec_history"] = StreamSettings(codec_settings={"mask_history": True}, key_interval=5)
    return found


def stream() -> list[Frame]:
    """Frames that use every section and every way to write it."""
    rng = np.random.default_rng(11)
    sent = [
        frames.scene(4),
        frames.irregular_side(6).with_(pose=frames.pose()),
        frames.three_to_one(3),
        frames.scene(4).with_(keep=rng.random((64, 24)) < 0.3),
        frames.noise(2),
        frames.scene(2).with_(side=None),
        frames.one_return(),
        frames.ordinary()["empty"],
        frames.scene(40, seed=12),
    ]
    return [frame.with_(index=index) for index, frame in enumerate(sent)]


def slabs(turns: int = 2) -> list[Frame]:
    """Turns of a sensor so quick that slabs of two packets are an eighth of one."""
    rng = np.random.default_rng(9)
    first = frames.scene(16, seed=5)
    cut = []
    for index in range(8 * turns):
        at = slice(index % 8 * 12, index % 8 * 12 + 12)
        ranges = first.range[:, at].astype(int)
        seen = np.where(ranges > 0, (ranges + 10 * (index // 8) + rng.integers(-3, 4, ranges.shape)).clip(1, 65535), 0)
        azimuth = np.tile((np.arange(at.start, at.stop) * 375).astype(np.uint16), (2, 1))
        cut.append(frames.scene(2, index=index, range=seen.astype(np.uint16), azimuth=azimuth))
    return cut


def turns() -> list[Frame]:
    """Whole turns of a sensor with 150 columns in each."""
    sent = [frames.scene(25, seed=3, index=index) for index in range(3)]
    at = np.tile((np.arange(sent[0].width) * 240 % 36000).astype(np.uint16), (2, 1))
    return [frame.with_(azimuth=at) for frame in sent]


def with_positions() -> list[Frame]:
    """Frames with position packets and without, one of them reduced."""
    keep = np.random.default_rng(12).random((64, 24)) < 0.3
    sent = [frames.scene(4), frames.scene(6), frames.scene(4).with_(keep=keep), frames.ordinary()["no packets"]]
    sides = [frames.with_positions(4), SideInfo.regular(6), frames.with_positions(4), frames.with_positions(0)]
    return [frame.with_(index=at, side=side) for at, (frame, side) in enumerate(zip(sent, sides, strict=True))]


def stream_of(name: str) -> list[Frame]:
    """Frames of the golden file of that name."""
    if "positions" in name:
        return with_positions()
    return slabs() if "slabs" in name else turns() if "turns" in name else stream()


def digest(frame: Frame) -> str:
    """Names everything in a frame."""
    parts = [
        f"{frame.index} {frame.stamp_ns} {frame.sensor.hash} {frame.sensor.convention} {frame.sensor.range_step_m}"
    ]
    arrays = [frame.range, frame.intensity, frame.azimuth, frame.fired]
    if frame.side is not None:
        side = frame.side
        arrays += [side.packet_ns, side.gps_us, side.status, side.layouts[side.layout], side.irregular, side.second]
        parts += [f"{at} {ns} {hashlib.sha256(payload).hexdigest()}" for at, ns, payload in side.positions]
    if frame.pose is not None:
        arrays.append(frame.pose)
    for array in arrays:
        parts.append(f"{array.dtype.str}{array.shape}")
        parts.append(hashlib.sha256(array.astype(array.dtype.newbyteorder("<")).tobytes()).hexdigest())
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:32]


def split(data: bytes) -> Iterator[bytes]:
    """Messages one after the other."""
    while data:
        size = wire.peek(data).total_bytes
        yield data[:size]
        data = data[size:]


def decoded(data: bytes) -> list[Frame]:
    """Frames of a golden file."""
    came: list[Frame] = []
    decoder = table.make_decoder(wire.peek(data).codec)
    for one in split(data):
        came += decoder.decode(wire.unpack(one))
    return came + decoder.flush()


@pytest.mark.parametrize("name", settings_of())
def test_a_golden_file_exists_for_every_codec(name: str) -> None:
    path = FOLDER / f"v{MAJOR}_{name}.bin"
    if WRITE and not path.exists():
        encoder = table.make_encoder(settings_of()[name], STREAM)
        messages = [one for frame in stream_of(name) for one in encoder.encode(frame)] + encoder.flush()
        data = b"".join(wire.pack(one) for one in messages)
        path.write_bytes(data)
        path.with_suffix(".json").write_text(json.dumps([digest(frame) for frame in decoded(data)], indent=1) + "\n")
    assert path.exists(), f"{path.name} is missing: run `make golden` and commit it"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("v*_*.bin")), ids=lambda path: path.stem)
def test_golden_messages_are_read_as_ever(path: Path) -> None:
    expected = json.loads(path.with_suffix(".json").read_text())
    assert [digest(frame) for frame in decoded(path.read_bytes())] == expected
    assert len(expected) == sum(wire.peek(one).frame_count for one in split(path.read_bytes()))


@pytest.mark.parametrize("name", [name for name in settings_of() if name.endswith("_lossless")])
def test_lossless_golden_messages_hold_what_was_sent(name: str) -> None:
    """The frames are written down in this folder's code: should their making ever change, so does this test."""
    path = FOLDER / f"v1_{name}.bin"
    for came, sent in zip(decoded(path.read_bytes()), stream_of(name), strict=True):
        np.testing.assert_array_equal(came.range, np.where(sent.valid, sent.range, 0))
        assert (came.side is None) == (sent.side is None)
        assert came.side is None or came.side.positions == sent.side.positions


def test_a_newer_major_version_is_refused_clearly() -> None:
    for path in FOLDER.glob("v1_*.bin"):
        data = bytearray(next(split(path.read_bytes())))
        data[4] = MAJOR + 1
        with pytest.raises(UnsupportedVersionError, match=f"version {MAJOR + 1}"):
            wire.unpack(bytes(data))
