"""Messages that stand in recordings, and what must come out of them.

A golden file holds messages one after the other, and is named by its format version: `v1_pcodec_lossless.bin`. The
`.json` beside it holds a digest of every frame that must come out. `make golden` writes the files that are missing and
never touches one that exists. Until 1.0.0 is released they may be removed and written anew; those of a release are
kept for ever (docs/wire-format.md, "Versions").
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.mounting import Mounting
from lidarcodec.network.shelf import networks_of, weights_of
from lidarcodec.network.update import Update, update_of
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.side import SideInfo
from lidarcodec.wire.header import MAJOR
from tests.contracts import frames
from tests.vectors.make import split

FOLDER = Path(__file__).parent
WRITE = os.environ.get("LIDARCODEC_GOLDEN") == "write"
STREAM = 0x0123_4567_89AB_CDEF


def settings_of() -> dict[str, StreamSettings]:
    """Settings by name of the golden file without version: two for each codec, and those that change the format.

    Names with `slabs`, `turns`, `positions` and `mounted` are of other frames (`stream_of`).
    """
    found: dict[str, StreamSettings] = {}
    for name in table.names():
        bound = 0.01 if table.codec(name).bounded else None
        exact = "lossless" if bound else "default"
        found[f"{name}_{exact}"] = StreamSettings(codec=name, max_error_m=0 if bound else None, key_interval=3)
        found[f"{name}_coarse"] = StreamSettings(codec=name, max_error_m=bound, intensity="levels=16", key_interval=3)
    found["pcodec_history"] = StreamSettings(codec_settings={"mask_history": True}, key_interval=5)
    for name in ("raw", "zstd"):
        found[f"{name}_positions_lossless"] = found[f"{name}_lossless"]
    found["raw_mounted_lossless"] = found["raw_lossless"]
    return found | _of_predictive() | _of_riddle()


def _of_predictive() -> dict[str, StreamSettings]:
    """Every kind of ranges without networks: quick (effort 1) or not, free, rounded or lossless, frames and slabs."""
    found: dict[str, StreamSettings] = {}
    for effort, prefix in ((1, "predictive"), (2, "predictive_full")):
        alone: dict[str, Any] = {"codec": "predictive", "codec_settings": {"effort": effort}}
        moved = alone | {"codec_settings": {"effort": effort, "motion": True}, "key_interval": 20}
        found |= {
            f"{prefix}_lossless": StreamSettings(**alone, max_error_m=0, key_interval=3),
            f"{prefix}_motion": StreamSettings(**moved | {"key_interval": 6}, max_error_m=0.01),
            f"{prefix}_rounded_motion": StreamSettings(
                **moved | {"key_interval": 6}, max_error_m=0.01, shape="rounded"
            ),
            f"{prefix}_slabs_lossless": StreamSettings(**alone, max_error_m=0, key_interval=20),
            f"{prefix}_slabs_free": StreamSettings(**alone, max_error_m=0.01, key_interval=20),
            f"{prefix}_slabs_motion": StreamSettings(**moved, max_error_m=0.01),
            f"{prefix}_slabs_rounded_motion": StreamSettings(**moved, max_error_m=0.01, shape="rounded"),
            f"{prefix}_turns_lossless": StreamSettings(**moved, max_error_m=0),
        }
    return found


def _of_riddle() -> dict[str, StreamSettings]:
    """All efforts, weights of the package, of the stream and as an update of those of the package."""
    own: dict[str, Any] = {"codec": "riddle", "key_interval": 20}
    moved = own | {"codec_settings": {"motion": True}}
    found = {
        "riddle_turns_lossless": StreamSettings(**moved, max_error_m=0),
        "riddle_turns_free": StreamSettings(**moved, max_error_m=0.05),
        "riddle_turns_rounded": StreamSettings(**moved, max_error_m=0.05, shape="rounded"),
        "riddle_slabs_free": StreamSettings(**own, max_error_m=0.01),
        "riddle_slabs_motion": StreamSettings(**moved, max_error_m=0.01),
        "riddle_updated_turns_lossless": StreamSettings(**own, max_error_m=0),
    }
    for effort in (1, 3, 4):
        settings = {"effort": effort, "motion": True}
        found[f"riddle_effort{effort}_turns_lossless"] = StreamSettings(
            codec="riddle", codec_settings=settings, max_error_m=0, key_interval=20
        )
    settings = {"motion": True, "weights": str(FOLDER / "cases.lcrw")}
    found["riddle_cases_turns_coarse"] = StreamSettings(
        codec="riddle", codec_settings=settings, max_error_m=0.01, key_interval=20
    )
    return found


def updated() -> Update:
    """Weights near those of the package, and how they come of them."""
    rng, base = np.random.default_rng(13), weights_of("")
    nets = []
    for net in networks_of(base, 2):
        first, second, last = net.layers
        moved = second.weights + 64 * rng.integers(-1, 2, second.weights.shape)
        nets.append(replace(net, layers=(first, replace(second, weights=moved.astype(np.int16)), last)))
    return update_of(base, nets, (7, 8, 8, 5))


def coded(name: str) -> list[Message]:
    """Messages of a golden file that is to be written."""
    settings = settings_of()[name]
    if "mounted" in name:
        mounting = StreamEncoder(settings, STREAM)
        return [one for frame in stream_of(name) for one in mounting.encode(frame)] + mounting.flush()
    if "updated" not in name:
        encoder = table.make_encoder(settings, STREAM)
        return [one for frame in stream_of(name) for one in encoder.encode(frame)] + encoder.flush()
    update = updated()
    with NamedTemporaryFile(suffix=".lcrw") as file:
        Path(file.name).write_bytes(update.weights.data)
        settings = settings.changed(codec_settings={"motion": True, "weights": file.name})
        encoder = table.make_encoder(settings, STREAM)
        messages = [one for frame in stream_of(name) for one in encoder.encode(frame)]
    as_update = Section(SectionType.WEIGHTS, update.data)
    return [
        replace(one, sections=tuple(as_update if of.type == SectionType.WEIGHTS else of for of in one.sections))
        for one in messages
    ]


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


def with_mountings() -> list[Frame]:
    """Frames of a sensor that nobody has measured in yet, then at one place of its vehicle, then at another."""
    places = (None, *(Mounting(1.5, -0.25, 1.8, 0.5, -2.0, 90.0),) * 4, Mounting(3.2, 0.0, 0.6))
    mounts = [None if one is None else one.T_vehicle_sensor for one in places]
    return [frames.scene(4, index=index, mount=mount) for index, mount in enumerate(mounts)]


def stream_of(name: str) -> list[Frame]:
    """Frames of the golden file of that name."""
    if "positions" in name:
        return with_positions()
    if "mounted" in name:
        return with_mountings()
    return slabs() if "slabs" in name else turns() if "turns" in name else stream()


def digest(frame: Frame) -> str:
    """Names everything in a frame."""
    parts = [
        f"{frame.index} {frame.stamp_ns} {frame.sensor.hash} {frame.sensor.convention} {frame.sensor.range_step_m}"
    ]
    arrays = [frame.range_u16 if frame.sensor.is_hdl64e else frame.range, frame.intensity, frame.azimuth, frame.fired]
    if frame.side is not None:
        side = frame.side
        arrays += [side.packet_ns, side.gps_us, side.status, side.layouts[side.layout], side.irregular, side.second]
        parts += [f"{at} {ns} {hashlib.sha256(payload).hexdigest()}" for at, ns, payload in side.positions]
    arrays += [matrix for matrix in (frame.pose, frame.mount) if matrix is not None]
    for array in arrays:
        parts.append(f"{array.dtype.str}{array.shape}")
        parts.append(hashlib.sha256(array.astype(array.dtype.newbyteorder("<")).tobytes()).hexdigest())
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:32]


def decoded(data: bytes) -> list[Frame]:
    """Frames of a golden file."""
    came: list[Frame] = []
    decoder = StreamDecoder()
    for one in split(data):
        came += decoder.decode(wire.unpack(one))
    return came + decoder.flush()


@pytest.mark.parametrize("name", settings_of())
def test_a_golden_file_exists_for_every_codec(name: str) -> None:
    path = FOLDER / f"v{MAJOR}_{name}.bin"
    if WRITE and not path.exists():
        data = b"".join(wire.pack(one) for one in coded(name))
        path.write_bytes(data)
        path.with_suffix(".json").write_text(json.dumps([digest(frame) for frame in decoded(data)], indent=1) + "\n")
    assert path.exists(), f"{path.name} is missing: run `make golden` and commit it"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("v*_*.bin")), ids=lambda path: path.stem)
def test_golden_messages_are_read(path: Path) -> None:
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
