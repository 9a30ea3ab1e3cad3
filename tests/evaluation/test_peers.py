"""Other people's coders: a comparison that is unfair to them, or that dies of one that is missing, is worth nothing."""

import json
import struct
import sys

import numpy as np
import pytest

from lidarcodec.commands.bench import command
from lidarcodec.errors import DecodeError, MissingExtraError, UnknownNameError
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.peers import table
from lidarcodec.evaluation.peers.base import from_levels, to_levels
from lidarcodec.evaluation.peers.run import bench_peer
from lidarcodec.settings import StreamSettings
from tests.packets import LOWER, UPPER
from tests.sources.captures import frame as on_the_wire
from tests.sources.captures import pcap

SOURCE = "sim:city?frames=2"
SLAB = "packets:116"
"""A third of a turn: what is said of a peer holds of any frame."""
FINEST = {"packets": 0.0, "ranges": 0.0, "x y z": 0.02}


def peer(name):
    try:
        return table.peer(name)
    except MissingExtraError as missing:
        pytest.skip(str(missing))


@pytest.fixture(scope="module")
def ours():
    """What our own codec gives for the same frame, lossless and with a bound of 5 cm."""
    lossless, bounded = (StreamSettings(codec="zstd", framing=SLAB, max_error_m=bound) for bound in (None, 0.05))
    return bench(SOURCE, lossless, frames=1, metrics="all"), bench(SOURCE, bounded, frames=2)


@pytest.mark.parametrize("name", table.names())
def test_every_peer_gives_the_frame_back_and_an_object_of_our_shape(name, ours):
    found, ours = peer(name), ours[0]
    result = bench_peer(SOURCE, name, found.values[0], frames=1, metrics="all", framing=SLAB)
    assert result.keys() == ours.keys()
    assert result["bits_per_point"].keys() == ours["bits_per_point"].keys()
    assert (result["frames"], result["points"], result["source"]) == (1, ours["points"], ours["source"])
    assert (result["lost"], result["invented"]) == (0, 0)
    assert result["max_error_m"] <= FINEST[found.feed]
    assert result["packets_identical"] == (True if found.feed == "packets" else None)
    assert result["settings"]["holds"] == found.feed
    points, kbps = result["points"], result["kbps_at_10hz"]
    assert kbps == pytest.approx(result["bits_per_point"]["total"] * points * 30 / 1000, rel=1e-4)  # 30 slabs a second
    assert result["encode_ms"]["p50"] > 0


@pytest.mark.parametrize("name", ["peer:xz-rows", "peer:pcodec", "peer:jpegls", "peer:lerc", "peer:ffv1"])
def test_peers_of_ranges_keep_the_bound_that_they_are_compared_at(name, ours):
    peer(name)
    result, ours = bench_peer(SOURCE, name, 0.05, frames=2, framing=SLAB), ours[1]
    assert 0.02 < result["rmse_m"] < 0.035
    assert result["max_error_m"] <= 0.05
    assert result["rmse_m"] == pytest.approx(ours["rmse_m"], rel=0.02)


def test_pcodec_gives_an_image_without_returns_back():
    coder = peer("peer:pcodec").make(0.01)
    for empty in (np.zeros((64, 10), np.uint16), np.zeros((64, 0), np.uint16)):
        assert np.array_equal(coder.decode(coder.encode(empty)), empty)


@pytest.mark.sweep
def test_fewer_bits_of_draco_are_a_larger_error_and_a_smaller_cloud():
    peer("peer:draco")
    fine, coarse = (bench_peer(SOURCE, "peer:draco", bits, frames=1, metrics="all", framing=SLAB) for bits in (14, 11))
    assert coarse["bits_per_point"]["geometry"] < fine["bits_per_point"]["geometry"]
    assert coarse["rmse_m"] > 4 * fine["rmse_m"]
    assert coarse["d1_psnr_db"] < fine["d1_psnr_db"] - 12
    assert coarse["range_errors"] is None


def test_levels_hold_every_range_and_keep_holes_apart():
    ranges = np.arange(65_536, dtype=np.uint16).reshape(64, -1)
    for bound in (0.0, 0.01, 0.2):
        back = from_levels(to_levels(ranges, bound), bound)
        assert np.array_equal(back > 0, ranges > 0)
        far = np.abs(back.astype(int) - ranges)
        assert far[ranges >= 200].max() * 0.002 <= bound + 1e-9


def test_a_package_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    monkeypatch.delitem(sys.modules, "lidarcodec.evaluation.peers.draco", raising=False)
    with pytest.raises(MissingExtraError, match=r"peer:draco \(DracoPy is not installed\).*lidarcodec\[peers\]"):
        table.peer("peer:draco")


def test_an_unknown_peer_is_told_the_known_ones():
    with pytest.raises(UnknownNameError, match="peer:draco"):
        table.peer("peer:gpcc")


@pytest.fixture
def no_return(tmp_path):
    """A capture of one frame in which nothing came back: an empty cloud."""
    block = b"".join(struct.pack("<HH", flag, 0) + bytes(96) for flag in (UPPER, LOWER) * 6)
    path = tmp_path / "fog.pcap"
    path.write_bytes(pcap([on_the_wire(block + bytes(4) + b"H\x00")] * 348))
    return path


@pytest.mark.parametrize("name", table.names())
def test_a_frame_without_a_return_is_measured_or_refused_by_name(name, no_return):
    found = peer(name)
    try:
        result = bench_peer(no_return, name, found.values[0], metrics="all")
    except DecodeError as refused:
        assert name in str(refused)  # noqa: PT017 (either is right)
    else:
        assert (result["points"], result["rmse_m"], result["bits_per_point"]["total"]) == (0, None, None)


@pytest.mark.sweep
def test_a_peer_that_fails_is_left_out_unless_it_was_asked_for(no_return, capsys, tmp_path):
    peer("peer:draco")
    picture = tmp_path / "nothing.png"
    given = {"frames": 1, "skip": 0, "calibration": None, "poses": None, "as_json": True}
    command.run(str(no_return), codecs="zstd", pairs=[], plot=picture, peers=True, as_curve=True, **given)
    assert picture.exists()
    shown = capsys.readouterr()
    names = {entry["codec"] for entry in json.loads(shown.out)}
    assert {"zstd", "peer:xz-rows"} <= names
    for line in shown.err.splitlines():
        assert line.startswith("not measured: peer:")
