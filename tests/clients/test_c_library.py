"""The C library against the package's own decoder, and the programs of clients/cpp, built by the system's compiler."""

from __future__ import annotations

import random
import shutil
import struct
import subprocess
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder
from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    HeaderError,
    MissingReferenceError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.network.shelf import shipped
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.planes.lattice_section import lattice_bytes, read_lattice
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import settings_from
from tests.clients.c_session import CSession, Decoded
from tests.conftest import ROOT
from tests.fuzz.corpus import Plan, plans, stream
from tests.fuzz.damage import damaged
from tests.sensors.made_frames import made_frames, made_layouts
from tests.sweeps import ALL, sampled
from tests.vectors.make import split

CODECS = ("raw", "zstd", "pcodec", "riddle", "predictive", "png")
NUMBERS = {table.codec_id(name) for name in CODECS}
GOLDEN = sorted(path for path in (ROOT / "tests/golden").glob("v1_*.bin") if path.stem.split("_")[1] in CODECS)
VECTORS = sorted((ROOT / "tests/vectors").glob("*.bin"))
OTHERS = [path for path in VECTORS if path.stem.startswith("other_")]
KEY_MESSAGE = next(iter(split((ROOT / "tests/golden/v1_pcodec_lossless.bin").read_bytes())))


@pytest.fixture
def session(bare: CSession) -> CSession:
    """A session that knows the package's weights."""
    for weights in shipped().values():
        bare.give_weights(weights.data)
    return bare


def alike(frame: Frame, found: Decoded) -> None:
    sensor = frame.sensor
    assert (frame.index, frame.stamp_ns, sensor.name, sensor.model) == (
        found.index,
        found.stamp_ns,
        found.sensor,
        found.model,
    )
    assert found.range_step_m == pytest.approx(sensor.range_step_m, rel=1e-12)
    np.testing.assert_array_equal(sensor.laser_of_ring, found.laser)
    np.testing.assert_array_equal(frame.azimuth, found.azimuth)
    if frame.lattice is None:
        np.testing.assert_array_equal(frame.fired, found.fired)
    for name, image in {"range": frame.range, "intensity": frame.intensity, **frame.planes}.items():
        np.testing.assert_array_equal(image, found.planes.get(name, np.zeros_like(image)), name)
    assert (frame.pose is None) == (found.pose is None)
    if frame.pose is not None:
        np.testing.assert_array_equal(frame.pose[:3], found.pose)
    alike_points(frame, frame.cloud("first"), found, found.points)
    if not sensor.is_hdl64e:
        alike_points(frame, frame.cloud("all"), found, found.all_points)


def alike_points(frame: Frame, cloud: np.ndarray, found: Decoded, points: np.ndarray) -> None:
    for name in ("intensity", "laser", "ring"):
        np.testing.assert_array_equal(cloud[name], points[name])
    for name in "xyz":
        np.testing.assert_allclose(points[name], cloud[name], rtol=1e-5, atol=1e-4)
    if frame.sensor.is_hdl64e:
        return
    np.testing.assert_array_equal(cloud["t_ns"], points["t_ns"])
    for name in {*(cloud.dtype.names or ())} & {*frame.planes}:
        second = found.planes.get(f"{name}2", found.planes[name])
        values = np.where(
            points["return_number"] == 2, second.ravel()[points["cell"]], found.planes[name].ravel()[points["cell"]]
        )
        np.testing.assert_array_equal(cloud[name], values, name)
    if "return_number" in (cloud.dtype.names or ()):
        np.testing.assert_array_equal(cloud["return_number"], points["return_number"])


@pytest.mark.parametrize("path", GOLDEN + VECTORS, ids=lambda path: path.stem)
def test_frames_are_those_of_the_package(path: Path, session: CSession) -> None:
    decoder = StreamDecoder()
    for data in split(path.read_bytes()):
        (frame,) = decoder.decode(wire.unpack(data))
        alike(frame, session.push(data))


def _decoder(number: int) -> Decoder:
    if number not in NUMBERS:
        raise UnsupportedVersionError(f"codec {number} is not compared")
    return table.make_decoder(number)


def _bare(message: Message) -> Message:
    """Without what the C library does not look into: side information and position packets."""
    sections = []
    for section in message.sections:
        if section.type == SectionType.LATTICE:
            sections.append(section._replace(data=lattice_bytes(read_lattice(section.data)._replace(side=None))))
        elif section.type not in (SectionType.SIDE, SectionType.POSITION):
            sections.append(section)
    return replace(message, sections=tuple(sections), packets=0)


def _outcome(decode: Callable[..., Any], *given: object) -> Any:
    try:
        return decode(*given)
    except DecodeError as error:
        return error


def _class(error: DecodeError) -> str:
    return "UnsupportedVersionError" if isinstance(error, UnsupportedVersionError) else type(error).__name__


COMPARED = [plan for plan in plans() if plan.settings["codec"] in CODECS and plan.size in ("tiny", "slab")]
SMALLEST = list({plan.name: plan for plan in reversed(COMPARED)}.values())


@pytest.mark.parametrize("plan", sampled(COMPARED, SMALLEST), ids=lambda plan: f"{plan.name} {plan.size}")
def test_damaged_messages_end_as_in_the_package(plan: Plan, session: CSession) -> None:
    """Messages that are damaged and have right checksums, between valid ones: frames, or errors of the same class."""
    rng = random.Random(plan.name)
    parts = [_bare(message) for message in stream(plan, 5).parts]
    others = [section for message in parts for section in message.sections]
    decoder, seen = StreamDecoder(_decoder), Counter[str]()

    def feed(data: bytes) -> None:
        message = _outcome(wire.unpack, data)
        if isinstance(message, DecodeError):
            found = _outcome(session.push, data)
            assert isinstance(found, DecodeError), str(message)
            assert _class(found) == _class(message), (str(found), str(message))
            return
        if message.codec == table.codec_id("raw") and message.needs is not None:
            return  # the package's decoder of raw looks at no reference
        if any(section.type in (SectionType.SIDE, SectionType.POSITION) for section in message.sections):
            return
        wanted, found = _outcome(decoder.decode, message), _outcome(session.push, data)
        if isinstance(wanted, DecodeError) and "side information" in str(wanted):
            return  # of a lattice
        if isinstance(wanted, DecodeError):
            assert isinstance(found, DecodeError), str(wanted)
            assert _class(found) == _class(wanted), (str(found), str(wanted))
            if isinstance(wanted, MissingReferenceError):
                assert isinstance(found, MissingReferenceError)
                assert found.needs == wanted.needs
            seen[_class(wanted)] += 1
        else:
            assert isinstance(found, Decoded), str(found)
            alike(wanted[0], found)
            seen["decoded"] += 1

    for message in parts:
        feed(wire.pack(message))
    assert seen["decoded"] == len(parts)
    for _ in range(3):
        for message in parts:
            if rng.random() < 0.7:
                feed(damaged(message, others, rng))
            if rng.random() < 0.8:
                feed(wire.pack(message))


def test_calls_in_any_order_and_without_what_is_not_wanted(session: CSession) -> None:
    """Points before the first frame, no bytes at all, and a frame of which only the points are wanted."""
    assert session.points() == 0
    for data in (None, b""):
        with pytest.raises(TruncatedError):
            session.push(data)
        with pytest.raises(HeaderError):
            session.give_weights(data)
    (frame,) = StreamDecoder().decode(wire.unpack(KEY_MESSAGE))
    session.push_unseen(KEY_MESSAGE)
    assert session.points() == frame.points
    with pytest.raises(ChecksumError):
        session.push_unseen(KEY_MESSAGE[:-1] + bytes([KEY_MESSAGE[-1] ^ 1]))
    assert session.points() == 0


def test_other_codecs_are_refused_by_name(session: CSession) -> None:
    data = next(iter(split((ROOT / "tests/golden/v1_jxl_lossless.bin").read_bytes())))
    with pytest.raises(UnsupportedVersionError, match="jxl"):
        session.push(data)


def record(path: Path, messages: list[bytes], compression: str) -> None:
    """A recording in chunks of some messages each."""
    with path.open("wb") as file:
        kind = CompressionType.ZSTD if compression == "zstd" else CompressionType.NONE
        writer = Writer(file, chunk_size=20_000, compression=kind)
        writer.start()
        ours = writer.register_channel("lidarcodec/v1/vehicle/lidar/frame", "lidarcodec", 0)
        other = writer.register_channel("somewhere/else", "json", 0)
        for number, data in enumerate(messages):
            writer.add_message(other, number, b"{}", number)
            writer.add_message(ours, number, data, number)
        writer.finish()


LIVE = (
    *("golden/v1_pcodec_lossless", "golden/v1_predictive_turns_lossless", "golden/v1_riddle_turns_lossless"),
    *("vectors/other_zstd_vlp16", "vectors/other_predictive_os0-32", "vectors/other_zstd_os1-128"),
)


@pytest.mark.parametrize("compression", ["none", "zstd"])
@pytest.mark.parametrize("name", LIVE)
def test_a_program_decodes_a_recording(
    name: str, compression: str, programs: Path, installed: Path, tmp_path: Path
) -> None:
    messages = list(split((ROOT / "tests" / f"{name}.bin").read_bytes()))
    recording, out = tmp_path / "stream.mcap", tmp_path / "points"
    record(recording, messages, compression)
    words = [
        programs / "decode_recording",
        recording,
        out,
        "--all",
        "--weights",
        installed / "share/lidarcodec/weights",
    ]
    said = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60).stdout.splitlines()
    decoder = StreamDecoder()
    frames = [decoder.decode(wire.unpack(data))[0] for data in messages]
    assert said[-1] == f"{len(frames)} frames, 0 messages refused"
    for number, frame in enumerate(frames):
        cloud = frame.cloud("first" if frame.sensor.is_hdl64e else "all")
        model = frame.sensor.model
        assert said[number].endswith(f"frame {frame.index} of a {model} at {frame.stamp_ns} ns: {len(cloud)} points")
        points = np.fromfile(out / f"{number:06d}.bin", "<f4").reshape(-1, 4)
        reflectance = cloud["intensity"] / np.float32(np.iinfo(cloud["intensity"].dtype).max)
        np.testing.assert_allclose(
            points, np.stack([cloud["x"], cloud["y"], cloud["z"], reflectance], 1), rtol=1e-5, atol=1e-4
        )


def test_what_a_program_does_not_understand_is_reported(programs: Path, tmp_path: Path) -> None:
    """An option that is misspelt is no folder, and a bag of something else is no recording of no frames."""
    program, empty = programs / "decode_recording", tmp_path / "empty.mcap"
    record(empty, [], "none")
    misspelt = subprocess.run([program, empty, "--al"], capture_output=True, text=True, timeout=60, check=False)
    assert (misspelt.returncode, misspelt.stderr[:6]) == (2, "usage:")
    nothing = subprocess.run([program, empty], capture_output=True, text=True, timeout=60, check=False)
    assert (nothing.returncode, "no messages" in nothing.stderr) == (1, True)


def test_a_program_prints_points_and_attributes_of_another_sensor(programs: Path) -> None:
    messages = list(split((ROOT / "tests/vectors/other_predictive_os0-32.bin").read_bytes()))
    given = b"".join(struct.pack("<I", len(data)) + data for data in messages)
    said = subprocess.run([programs / "print_points"], input=given, capture_output=True, check=True, timeout=60).stdout
    decoder = StreamDecoder()
    for data, line in zip(messages, said.decode().splitlines(), strict=True):
        (frame,) = decoder.decode(wire.unpack(data))
        cloud = frame.cloud("all")
        assert line.startswith(f"frame {frame.index} of a {frame.sensor.name}: {len(cloud)} points, the first at ")
        for name in ("intensity", "signal", "near_ir"):
            assert f"{name} {cloud[0][name]}" in line


@pytest.mark.sweep
def test_damaged_messages_of_other_sensors_end_as_in_the_package(session: CSession) -> None:
    """As above, of vectors: planes of all kinds, tables, lattices, odd packets, metadata."""
    rng = random.Random(30)
    seen = Counter[str]()
    for path in OTHERS:
        messages = [wire.unpack(data) for data in split(path.read_bytes())][:3]
        others = [section for message in messages for section in message.sections]
        decoder = StreamDecoder()
        for number in range(40 if ALL else 10):
            data = damaged(messages[number % 3], others, rng) if number > 2 else wire.pack(messages[number])
            try:
                message = wire.unpack(data)
            except DecodeError:
                continue
            if message.has(SectionType.POSITION) or not message.planes:
                continue  # the C library does not look into what is sent to another port
            found = _outcome(session.push, data)
            if "needs a decoder of pictures" in str(found):
                continue  # the package has them
            wanted = _outcome(decoder.decode, message)
            if "damaged zstd frame" in str(wanted):
                continue  # a newer libzstd sees more of it than an older one
            if "side information" in str(wanted) and message.has(SectionType.LATTICE):
                continue  # of packets in a lattice, which has none here
            if isinstance(wanted, DecodeError):
                assert isinstance(found, DecodeError), str(wanted)
                assert _class(found) == _class(wanted), (str(found), str(wanted))
            else:
                assert isinstance(found, Decoded), str(found)
                if number <= 2 or "zstd" not in path.stem:  # damaged frames of zstd are other bytes for another libzstd
                    alike(wanted[0], found)
            seen[type(wanted).__name__] += 1
    assert seen["list"] > len(OTHERS)
    assert seen["SectionError"] > len(OTHERS)


@pytest.mark.parametrize(("sensor", "layout"), made_layouts())
def test_points_of_every_layout(sensor: SensorModel, layout: str, session: CSession) -> None:
    """Of all models and modes, those too that no capture has."""
    encoder, decoder = StreamEncoder(settings_from({"codec": "zstd"}), 7), StreamDecoder()
    for frame in made_frames(sensor, layout, 2, 3):
        (message,) = encoder.encode(frame)
        (decoded,) = decoder.decode(message)
        alike(decoded, session.push(wire.pack(message)))


def test_a_recording_that_was_cut_is_read_as_far_as_it_goes(programs: Path, tmp_path: Path) -> None:
    recording = tmp_path / "stream.mcap"
    record(recording, list(split((ROOT / "tests/golden/v1_pcodec_lossless.bin").read_bytes())), "none")
    whole = recording.read_bytes()
    for size in range(0, len(whole), 997):
        recording.write_bytes(whole[:size])
        words = [programs / "decode_recording", recording]
        result = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        assert result.returncode == (0 if " frame " in result.stdout else 1), result.stderr


def test_a_program_prints_points_of_a_stream_that_learns(programs: Path) -> None:
    """Messages with updates of weights, one of them damaged: what refers to it waits for a key message."""
    plan = next(plan for plan in plans() if (plan.name, plan.size) == ("riddle updates", "slab"))
    messages = list(stream(plan, 5).messages)
    assert any(section.type == SectionType.WEIGHTS for data in messages for section in wire.unpack(data).sections)
    messages += [messages[0][:-1] + bytes([messages[0][-1] ^ 1]), *messages]
    given = b"".join(struct.pack("<I", len(data)) + data for data in messages)
    words = [programs / "print_points", "--weights", ROOT / "lidarcodec/network/weights"]
    result = subprocess.run(words, input=given, capture_output=True, check=True, timeout=60)
    decoder, wanted = StreamDecoder(), []
    for data in messages:
        try:
            (frame,) = decoder.decode(wire.unpack(data))
        except DecodeError:
            continue
        wanted.append(f"frame {frame.index} of a {frame.sensor.name}: {frame.points} points")
    said = result.stdout.decode().splitlines()
    assert [line.partition(", the first")[0] for line in said] == wanted
    assert b"checksum" in result.stderr


def test_pkg_config_finds_it(installed: Path, tmp_path: Path) -> None:
    """A program in C, by the flags that pkg-config gives."""
    if shutil.which("pkg-config") is None or shutil.which("cc") is None:
        pytest.skip("needs pkg-config and a C compiler")
    program = tmp_path / "open.c"
    program.write_text("#include <lidarcodec.h>\nint main(void) { lidarcodec_close(lidarcodec_open()); return 0; }\n")
    folder = next(installed.rglob("lidarcodec.pc")).parent
    words = ["pkg-config", "--cflags", "--libs", "lidarcodec"]
    flags = subprocess.run(
        words, env={"PKG_CONFIG_PATH": str(folder), "PATH": "/usr/bin:/bin"}, check=True, capture_output=True, text=True
    )
    compiled = ["cc", "-std=c99", "-Wall", "-Werror", str(program), "-o", str(tmp_path / "open"), *flags.stdout.split()]
    subprocess.run(compiled, check=True, capture_output=True, timeout=60)
    library = next(installed.rglob("liblidarcodec.so")).parent
    subprocess.run([tmp_path / "open"], env={"LD_LIBRARY_PATH": str(library)}, check=True, timeout=60)
