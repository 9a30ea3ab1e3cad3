"""The C library against the package's own decoder, and the programs of clients/cpp, built by the system's compiler."""

from __future__ import annotations

import random
import shutil
import struct
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
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
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.thinned_stream import lattice_bytes, read_lattice
from tests.clients.c_session import CSession, Decoded
from tests.conftest import ROOT
from tests.fuzz.corpus import Plan, plans, stream
from tests.fuzz.damage import damaged
from tests.vectors.make import split

CODECS = ("raw", "zstd", "pcodec", "riddle", "predictive")
NUMBERS = {table.codec_id(name) for name in CODECS}
GOLDEN = sorted(path for path in (ROOT / "tests/golden").glob("v1_*.bin") if path.stem.split("_")[1] in CODECS)
VECTORS = sorted((ROOT / "tests/vectors").glob("*.bin"))
BUILD = ROOT / "build" / "native"
KEY_MESSAGE = next(iter(split((ROOT / "tests/golden/v1_pcodec_lossless.bin").read_bytes())))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library as `cmake --install` puts it into a folder."""
    if not list((BUILD / "native" / "c").glob("liblidarcodec.*")):
        pytest.skip(
            "needs the headers of zstd and zlib when the native core is built: apt install libzstd-dev zlib1g-dev"
        )
    prefix = tmp_path_factory.mktemp("installed")
    words = ["cmake", "--install", str(BUILD), "--prefix", str(prefix), "--component", "c"]
    subprocess.run(words, check=True, capture_output=True, timeout=60)
    return prefix


@pytest.fixture
def session(installed: Path) -> Iterator[CSession]:
    """A session that knows the package's weights."""
    made = CSession(next(installed.rglob("liblidarcodec.so")))
    for weights in shipped().values():
        made.give_weights(weights.data)
    yield made
    made.close()


def alike(frame: Frame, found: Decoded) -> None:
    assert (frame.index, frame.stamp_ns, frame.sensor.name) == (found.index, found.stamp_ns, found.sensor)
    for name in ("range", "intensity", "azimuth"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(found, name), name)
    if frame.lattice is None:
        np.testing.assert_array_equal(frame.fired, found.fired)
    assert (frame.pose is None) == (found.pose is None)
    if frame.pose is not None:
        np.testing.assert_array_equal(frame.pose[:3], found.pose)
    cloud = frame.cloud()
    for name in ("intensity", "laser", "ring"):
        np.testing.assert_array_equal(cloud[name], found.points[name])
    for name in "xyz":
        np.testing.assert_allclose(found.points[name], cloud[name], rtol=1e-5, atol=1e-4)


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


@pytest.mark.parametrize("plan", COMPARED, ids=lambda plan: f"{plan.name} {plan.size}".replace(" ", "-"))
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


@pytest.fixture(scope="module")
def programs(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of clients/cpp, built against the library as it is installed."""
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake")
    build = tmp_path_factory.mktemp("programs")
    words = ["cmake", "-S", str(ROOT / "clients" / "cpp"), "-B", str(build), f"-DCMAKE_PREFIX_PATH={installed}"]
    for step in (words, ["cmake", "--build", str(build)]):
        subprocess.run(step, check=True, capture_output=True, timeout=300)
    return build


def _record(path: Path, messages: list[bytes], compression: str) -> None:
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


LIVE = ("v1_pcodec_lossless", "v1_predictive_turns_lossless", "v1_riddle_turns_lossless")


@pytest.mark.parametrize("compression", ["none", "zstd"])
@pytest.mark.parametrize("name", LIVE)
def test_a_program_decodes_a_recording(
    name: str, compression: str, programs: Path, installed: Path, tmp_path: Path
) -> None:
    messages = list(split((ROOT / "tests/golden" / f"{name}.bin").read_bytes()))
    recording, out = tmp_path / "stream.mcap", tmp_path / "points"
    out.mkdir()
    _record(recording, messages, compression)
    words = [programs / "decode_recording", recording, out, "--weights", installed / "share/lidarcodec/weights"]
    said = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60).stdout.splitlines()
    decoder = StreamDecoder()
    frames = [decoder.decode(wire.unpack(data))[0] for data in messages]
    assert said[-1] == f"{len(frames)} frames, 0 messages refused"
    for number, frame in enumerate(frames):
        assert said[number].endswith(f"frame {frame.index} at {frame.stamp_ns} ns: {frame.points} points")
        points = np.fromfile(out / f"{number}.bin", "<f4").reshape(-1, 4)
        cloud = frame.cloud()
        np.testing.assert_allclose(
            points, np.stack([cloud[key] for key in ("x", "y", "z", "intensity")], 1), rtol=1e-5, atol=1e-4
        )


def test_a_recording_that_was_cut_is_read_as_far_as_it_goes(programs: Path, tmp_path: Path) -> None:
    recording = tmp_path / "stream.mcap"
    _record(recording, list(split((ROOT / "tests/golden/v1_pcodec_lossless.bin").read_bytes())), "none")
    whole = recording.read_bytes()
    for size in range(0, len(whole), 997):
        recording.write_bytes(whole[:size])
        words = [programs / "decode_recording", recording]
        result = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        assert result.returncode == (1 if size < 8 else 0), result.stderr


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
