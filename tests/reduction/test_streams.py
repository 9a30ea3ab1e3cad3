"""Reduction in a stream: through every codec, under a target bitrate, and while settings change."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec import api
from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, size_of, unpack
from tests.sweeps import sampled


@pytest.fixture(scope="module")
def road() -> list[Frame]:
    return list(api.read_frames("sim:road?frames=8"))


def came_back(encoder: StreamEncoder, frames: list[Frame]) -> list[Frame]:
    decoder = StreamDecoder()
    messages = [message for frame in frames for message in encoder.encode(frame)] + encoder.flush()
    return [frame for one in messages for frame in decoder.decode(unpack(pack(one)))] + decoder.flush()


@pytest.mark.parametrize("codec", table.names())
def test_every_codec_sends_what_stays_and_nothing_else(road: list[Frame], codec: str) -> None:
    settings = StreamSettings(codec=codec, reduction="voxel", keep_points=2000)
    found = came_back(StreamEncoder(settings), road[:3])
    assert [frame.index for frame in found] == [0, 1, 2]
    for came, sent in zip(found, road[:3], strict=True):
        assert came.points == 2000
        assert not (came.valid & ~sent.valid).any()
        if table.codec(codec).bounded:
            np.testing.assert_array_equal(came.range[came.valid], sent.range[came.valid])


def test_reduction_changes_between_two_frames(road: list[Frame]) -> None:
    encoder, decoder, points, names = StreamEncoder(StreamSettings(codec="predictive")), StreamDecoder(), [], []
    changes = {2: {"reduction": "voxel", "keep_points": 5000}, 4: {"keep_points": 700}, 6: {"reduction": "columns:16",
               "keep_points": None}, 7: {"reduction": "all"}}  # fmt: skip
    for frame in road:
        if frame.index in changes:
            encoder.apply(encoder.settings.changed(**changes[frame.index]))
        for message in encoder.encode(frame):
            points += [came.points for came in decoder.decode(unpack(pack(message)))]
        names.append(encoder.reduction and encoder.reduction["name"])
    full = [frame.points for frame in road]
    sixteenth = int(road[6].valid[:, ::16].sum())
    assert points == [full[0], full[1], 5000, 5000, 700, 700, sixteenth, full[7]]
    assert names == [None, None, "voxel", "voxel", "voxel", "voxel", "columns:16", None]


def test_settings_that_are_refused_change_nothing(road: list[Frame]) -> None:
    encoder = StreamEncoder(StreamSettings(reduction="voxel", keep_points=900))
    with pytest.raises(SettingsError):
        encoder.apply(StreamSettings(reduction="voxel:7"))
    assert encoder.settings.keep_points == 900
    assert came_back(encoder, road[:1])[0].points == 900


def test_the_status_says_what_is_in_force_and_how_many_stay(road: list[Frame]) -> None:
    encoder = StreamEncoder(StreamSettings(reduction="voxel", keep_fraction=0.1))
    assert encoder.reduction == {"name": "voxel", "returns": None, "kept": None}
    encoder.encode(road[0])
    about = encoder.reduction
    assert about is not None
    assert (about["returns"], about["kept"]) == (road[0].points, int(road[0].points * 0.1 + 0.5))
    assert 0.1 < about["cell_m"] < 2


@pytest.mark.parametrize("target", sampled([400, 600], [600]))
def test_a_target_bitrate_is_kept_by_a_reduced_stream(road: list[Frame], target: float) -> None:
    settings = StreamSettings(codec="predictive", reduction="voxel", keep_points=9000, intensity="off",
                              target_kbps=target)  # fmt: skip
    encoder, sizes = StreamEncoder(settings), []
    for index in range(60):
        frame = road[index % 8].with_(index=index, stamp_ns=road[0].stamp_ns + index * 100_000_000)
        sizes += [size_of(message) for message in encoder.encode(frame)]
    assert np.mean(sizes[10:]) * 8 / 0.1 / 1e3 == pytest.approx(target, rel=0.05)
    assert encoder.rate is not None
    assert encoder.rate["reached"]
