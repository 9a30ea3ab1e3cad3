"""What somebody who works in Python would lose: a typo that is told, frames in other processes, files, figures."""

from __future__ import annotations

import inspect
import pickle
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

import lidarcodec
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.bench import bench
from lidarcodec.recording import RecordingWriter
from lidarcodec.settings import SettingChanges
from lidarcodec.wire import pack


@pytest.fixture(scope="module")
def frames() -> list[lidarcodec.Frame]:
    return list(lidarcodec.read_frames("sim:city?frames=2"))


def test_typed_changes_are_the_settings() -> None:
    fields = {name: field.annotation for name, field in lidarcodec.StreamSettings.model_fields.items()}
    assert get_type_hints(SettingChanges) == fields


@pytest.mark.parametrize(
    "call",
    [
        lambda **wrong: lidarcodec.encode([], **wrong),
        lambda **wrong: lidarcodec.encode([], lidarcodec.StreamSettings(), **wrong),
        lambda **wrong: lidarcodec.StreamSettings().changed(**wrong),
        lambda **wrong: lidarcodec.open_source("sim:city", **wrong),
        lambda **wrong: lidarcodec.subscribe("a/b", **wrong),
        lambda **wrong: lidarcodec.Publisher(lidarcodec.open_source("sim:city"), **wrong),
    ],
)
def test_a_typo_is_refused_by_its_name(call: Any) -> None:
    with pytest.raises((lidarcodec.LidarCodecError, TypeError), match="codex"):
        call(codex="pcodec")


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"code": "pcodec"}, "unknown setting 'code': did you mean codec"),
        ({"max_error_m": 30}, "max_error_m must be at most 20"),
        ({"codec": 3}, "codec must be text"),
        ({"purpose": "see"}, "purpose must be 'look', 'localise', 'detect' or 'archive'"),
        ({"framing": "slabs"}, "framing must be revolution"),
    ],
)
def test_a_wrong_setting_is_one_plain_sentence_of_our_own_error(values: dict[str, Any], says: str) -> None:
    with pytest.raises(SettingsError, match=says) as caught:
        lidarcodec.StreamSettings(**values)
    assert caught.value.field == next(iter(values))
    assert str(caught.value).startswith(says), "the field is named once"
    with pytest.raises(SettingsError, match=says):
        lidarcodec.StreamSettings().changed(**values)


def test_one_frame_or_a_path_where_many_or_a_source_are_taken_is_refused_with_what_to_write(frames, tmp_path) -> None:
    calls: list[tuple[Any, str]] = [
        (lambda: lidarcodec.encode(frames[0]), r"write \[frame\]"),  # type: ignore[arg-type]
        (lambda: next(lidarcodec.decode(b"message")), r"write \[message\]"),  # type: ignore[arg-type]
        (lambda: lidarcodec.write_frames(frames[0], tmp_path / "a.ply"), r"write \[frame\]"),  # type: ignore[arg-type]
        (lambda: lidarcodec.Publisher("a.pcap"), "open_source"),  # type: ignore[arg-type]
        (lambda: lidarcodec.open_source("sim:city", calibration="no.xml"), "cannot read calibration no.xml"),
    ]
    for call, says in calls:
        with pytest.raises(lidarcodec.LidarCodecError, match=says):
            call()
    with pytest.raises(AttributeError, match="did you mean read_frames"):
        _ = lidarcodec.read_frame


def test_no_public_function_takes_anything() -> None:
    for name in lidarcodec.__all__:
        thing = getattr(lidarcodec, name)
        if callable(thing) and name not in ("StreamSettings", "LidarCodecError"):
            kinds = inspect.signature(thing).parameters.values()
            loose = [one for one in kinds if one.kind is one.VAR_KEYWORD and "Unpack" not in str(one.annotation)]
            assert not loose, name


@pytest.mark.parametrize("spec", ["sim:city?frames=1", "sim:city?sensor=vlp16&returns=dual&frames=1"])
def test_frames_go_to_another_process_and_are_the_same(spec: str) -> None:
    (frame, *_) = lidarcodec.read_frames(spec)
    frame = frame.with_(pose=np.eye(4), keep=frame.range % 3 > 0)
    back = pickle.loads(pickle.dumps(frame))
    assert back.cloud("all").tobytes() == frame.cloud("all").tobytes()
    assert (back.index, back.stamp_ns, back.sensor.hash) == (frame.index, frame.stamp_ns, frame.sensor.hash)
    assert lidarcodec.packets_of(back) == lidarcodec.packets_of(frame)
    arrays = {"range": back.range, "keep": back.keep, "pose": back.pose, **back.planes}
    for name, array in arrays.items():
        assert array is not None
        assert np.array_equal(array, getattr(frame, name, None) if name not in frame.planes else frame.planes[name])
        assert not array.flags.writeable


@pytest.mark.parametrize("ending", [".ply", ".las"])
def test_points_are_written_whole_or_not_at_all(frames: list[lidarcodec.Frame], tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"town{ending}"
    count = lidarcodec.write_frames(iter(frames), out)
    assert count == sum(len(frame.cloud()) for frame in frames)
    if ending == ".las":
        laspy = pytest.importorskip("laspy", reason="the extra `las`")
        assert len(laspy.read(out)) == count
    else:
        assert f"element vertex {count:>10}".split()[-1] in out.read_bytes()[:400].decode(errors="replace")
    with pytest.raises(lidarcodec.LidarCodecError, match="exists"):
        lidarcodec.write_frames(frames, out)
    with pytest.raises(lidarcodec.LidarCodecError, match="no frames"):
        lidarcodec.write_frames([], tmp_path / f"none{ending}")
    with pytest.raises(lidarcodec.LidarCodecError, match=r"give a name that ends in .* write \[frame\] to each"):
        lidarcodec.write_frames(frames, tmp_path / "town.xyz")
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def test_a_recording_is_verified_and_its_bits_are_those_of_bench(tmp_path: Path) -> None:
    spec, settings = "sim:city?frames=2", lidarcodec.StreamSettings(codec="pcodec", max_error_m=0.02)
    frames = list(lidarcodec.read_frames(spec))
    encoder = lidarcodec.StreamEncoder(settings, stream_id=1)
    messages = [pack(message) for frame in frames for message in encoder.encode(frame)]
    recording = tmp_path / "town.mcap"
    with recording.open("wb") as file:
        writer = RecordingWriter(file, "car", "lidar", settings)
        for data in messages:
            writer.write(data)
        writer.close()
    found = lidarcodec.verify(recording, spec)
    assert (found["broken"], found["max_error_m"], found["coverage"]["whole"]) == ([], 0.02, True)
    assert lidarcodec.verify(recording, "sim:city?frames=3")["broken"]
    assert lidarcodec.verify(recording, "sim:city?frames=3", allow_part=True)["broken"] == []
    bits = lidarcodec.bits_per_point(messages, sum(frame.points for frame in frames))
    assert bits == bench(spec, settings)["bits_per_point"]
    assert lidarcodec.bits_per_point([], 0)["total"] is None
