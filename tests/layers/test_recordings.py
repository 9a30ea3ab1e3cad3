"""Recordings of two layers: encode writes both, decode and verify take what is there and say what is not."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

import lidarcodec
from lidarcodec.commands.verify import verify
from lidarcodec.errors import HeaderError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.layers import pack as pack_refinement
from lidarcodec.layers import peek_refinement, unpack
from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.recording.layout import REFINE_ENCODING
from lidarcodec.recording.refinements import Refinements
from lidarcodec.sources import open_source
from lidarcodec.wire import pack
from tests.command_line import run, run_here
from tests.layers.bases import sent

SOURCE = "sim:city?frames=3&seed=4"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two layers of three turns."""
    out = tmp_path_factory.mktemp("layers") / "both.mcap"
    options = ["--codec", "pcodec", "--set", "base_error_m=0.05", "--set", "key_interval=1", "--json"]
    told = json.loads(run_here("encode", SOURCE, str(out), *options).stdout)
    assert 0 < told["refinement_bytes"] < told["coded_bytes"]
    return out


def without(recording: Path, out: Path, *, lost: set[int], frames: set[int], settings: bool = True) -> Path:
    """The recording without some sectors of some frames, and the rest in another order. settings: whether it says its
    settings, as live recordings do not"""
    with recording.open("rb") as source, out.open("wb") as handle:
        reader = RecordingReader(source)
        about = {name: text for name, text in reader.metadata.items() if settings or name != "settings"}
        writer = RecordingWriter(handle, "vehicle", "lidar", None, about)
        late: list[bytes] = []
        for channel, stored in reader.everything():
            data = stored.data()
            if channel.encoding == REFINE_ENCODING:
                head = peek_refinement(data)
                if head.frame_index not in frames or head.sector not in lost:
                    late.insert(0, data)
            else:
                writer.write(data)
        for data in late:
            writer.write_refinement(data)
        writer.close()
    return out


def test_verify_sees_exact_packets(recording: Path) -> None:
    found = verify(recording, SOURCE)
    assert found["packets_identical"]
    assert not found["broken"]
    assert found["layers"] == {"whole": 3, "part": 0, "base": 0}
    assert found["bounds_m"] == [0.0]
    assert not found["changed"]


def test_lost_sectors_are_told_and_leave_the_bound_of_the_base(recording: Path, tmp_path: Path) -> None:
    cut = without(recording, tmp_path / "cut.mcap", lost={2}, frames={1})
    cut = without(cut, tmp_path / "cut2.mcap", lost=set(range(12)), frames={2})
    found = verify(cut, SOURCE)
    assert found["layers"] == {"whole": 1, "part": 1, "base": 1}
    assert not found["broken"]
    assert not found["packets_identical"]
    assert found["bounds_m"] == [0.0, 0.05]
    assert 0 < found["max_error_m"] <= 0.05
    told = run("decode", str(cut), str(tmp_path / "out.pcap"), "--json")
    assert json.loads(told.stdout)["layers"] == found["layers"]
    assert "1 frames refined whole, 1 in part, 1 base only" in told.stderr


def test_a_recording_read_as_a_source_has_exact_packets(recording: Path) -> None:
    with open_source(SOURCE) as original, open_source(str(recording)) as read:
        given = [packet.payload for packet in original.packets()]
        assert [packet.payload for packet in read.packets()] == given


def test_frames_that_are_not_refined_are_told_also_of_live_recordings(recording: Path, tmp_path: Path) -> None:
    cut = without(recording, tmp_path / "cut.mcap", lost=set(range(12)), frames={0, 2}, settings=False)
    recorded = RecordedFrames(cut)
    assert len(list(recorded)) == 3
    assert recorded.layers == {"whole": 1, "base": 2}
    with open_source(str(cut)) as read:
        assert sum(1 for _ in read.packets())
        assert read.counts["not refined"] == 2
    told = run("encode", str(cut), str(tmp_path / "again.mcap"), "--codec", "pcodec")
    assert "only in part: 2 frames of two layers that are not refined whole" in told.stderr


def test_one_layer_has_no_layers(tmp_path: Path) -> None:
    run_here(
        "encode", SOURCE, str(tmp_path / "one.mcap"), "--codec", "pcodec", "--frames", "1", "--set", "max_error_m=0.05"
    )
    recorded = RecordedFrames(tmp_path / "one.mcap")
    assert len(list(recorded)) == 1
    assert not recorded.layers


def test_damaged_refinements_are_counted_and_change_nothing(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "damaged.mcap"
    with recording.open("rb") as source, out.open("wb") as handle:
        reader = RecordingReader(source)
        writer = RecordingWriter(handle, "vehicle", "lidar", None, reader.metadata)
        for channel, stored in reader.everything():
            data = stored.data()
            if channel.encoding != REFINE_ENCODING:
                writer.write(data)
                continue
            one = unpack(data)
            if one.sector == 5:
                data = pack_refinement(one._replace(base=one.base ^ 1))
            writer.write_refinement(data)
        writer.close()
    recorded = RecordedFrames(out)
    assert len(list(recorded)) == 3
    assert recorded.layers == {"part": 3}
    assert sum(recorded.failed.values()) == 3
    assert any("does not fit this base" in text for text in recorded.failed)
    assert verify(out, SOURCE)["broken"] == ["3 messages could not be decoded"]


def test_one_that_came_twice_takes_the_place_of_no_other() -> None:
    """A path that repeats messages left half of the sectors out, though all were in the recording."""
    given, kept = sent(), Refinements()
    sectors = [given.refinable.code(sector) for sector in given.refinable.sectors]
    for data in sectors:
        kept.put(data)
        kept.put(data)
        kept.put(pack_refinement(unpack(data)._replace(base=1)))
    assert [data for data in kept.take(given.message) if unpack(data).base != 1] == sectors
    assert not kept.unread


def test_what_is_kept_for_later_is_bounded() -> None:
    given, kept = sent(), Refinements()
    data = given.refinable.code(0)
    for base in range(20):
        kept.put(pack_refinement(unpack(data)._replace(base=base)))
    kept.put(b"\x93LDR and no more")
    assert kept.unread == 17
    assert len(kept.take(given.message)) == 4
    assert not kept.take(given.message)
    for index in range(70):
        kept.put(pack_refinement(unpack(data)._replace(frame_index=index)))
    assert kept.unread == 17 + 6


def test_writers_refuse_what_is_no_refinement() -> None:
    given = sent()
    with RecordingWriter(io.BytesIO(), "truck", "roof") as writer:
        with pytest.raises(HeaderError, match="not a refinement"):
            writer.write_refinement(pack(given.message))
        with pytest.raises(HeaderError, match="should have"):
            writer.write_refinement(given.refinable.code(0) + b"\0")


@pytest.mark.sweep
def test_refinements_that_come_after_the_next_frame_go_with_their_own(recording: Path, tmp_path: Path) -> None:
    late = without(recording, tmp_path / "late.mcap", lost=set(), frames=set())  # all behind the last message
    run_here("cut", str(late), str(tmp_path / "part.mcap"), "--every", "0.1")
    parts = sorted(tmp_path.glob("part-*.mcap"))
    assert len(parts) == 3
    for part in parts:
        assert verify(part, SOURCE, allow_part=True)["layers"] == {"whole": 1, "part": 0, "base": 0}
    run_here("cut", str(late), str(tmp_path / "first.mcap"), "--frames", "1")
    assert verify(tmp_path / "first.mcap", SOURCE, allow_part=True)["packets_identical"]
    told = json.loads(run_here("info", str(parts[0]), "--json").stdout)
    assert told["refinements"] == 12
    assert 0 < told["bytes of refinements"] < parts[0].stat().st_size


@pytest.mark.sweep
def test_cut_and_join_keep_both_layers(recording: Path, tmp_path: Path) -> None:
    for name, more in (("one", ["--frames", "1"]), ("two", ["--skip", "1", "--frames", "1"])):
        run_here("cut", str(recording), str(tmp_path / f"{name}.mcap"), *more)
    assert RecordedFrames(tmp_path / "one.mcap").settings() == lidarcodec.StreamSettings(
        base_error_m=0.05, key_interval=1
    )
    assert verify(tmp_path / "one.mcap", SOURCE, allow_part=True)["layers"] == {"whole": 1, "part": 0, "base": 0}
    assert verify(tmp_path / "two.mcap", SOURCE, allow_part=True)["layers"]["whole"] >= 1
