"""docs/wire-format.md against the code: its tables, and a decoder written from it alone that imports none of ours."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard

import lidarcodec.errors
from lidarcodec import entropy, wire
from lidarcodec.codecs import table
from lidarcodec.message import SectionType
from lidarcodec.planes.intensity import Quality, reduced
from lidarcodec.settings import StreamSettings
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS
from lidarcodec.wire import header
from tests.contracts import frames

DOCS = Path(__file__).resolve().parents[2] / "docs"
FORMAT = (DOCS / "wire-format.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table after a heading."""
    text = FORMAT[FORMAT.index(heading) :]
    lines = re.search(r"(?:^\|.*\n)+", text, re.M)
    assert lines
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[0].splitlines()[2:]]


def test_the_header_table_is_the_layout() -> None:
    fields = [(int(row[0]), int(row[1])) for row in rows("### Header")]
    assert [offset for offset, _ in fields] == [0, *np.cumsum([size for _, size in fields])[:-1].tolist()]
    assert sum(size for _, size in fields) == header.HEADER_BYTES
    codes = re.findall(r"\d*[a-zA-Z]", header.LAYOUT.format.removeprefix("<"))
    assert [size for _, size in fields] == [struct.calcsize(f"<{code}") for code in codes]


def test_the_limits_are_the_documented_ones() -> None:
    text = " ".join(" ".join(row) for row in rows("### Header"))
    for limit in (header.MAX_MESSAGE, MAX_COLUMNS, MAX_PACKETS, header.MAX_SECTIONS, header.MAX_FRAMES):
        assert f"to {limit:,}" in text
    assert f"version {header.MAJOR}.{header.MINOR}" in FORMAT.splitlines()[0]
    assert rows("# Wire format")[-1][0] == f"{header.MAJOR}.{header.MINOR}"


def test_every_section_type_and_codec_is_documented() -> None:
    assert {int(row[0]): row[1] for row in rows("### Sections")} == {int(kind): kind.name for kind in SectionType}
    codecs = {row[0]: row[1] for row in rows("## Codecs")}
    for name in table.names():
        assert codecs[str(table.codec_id(name))].startswith(f"[{name}]")


def test_every_codec_and_setting_has_its_place() -> None:
    page = (DOCS / "codecs.md").read_text()
    for name in table.names():
        section = page[page.index(f"\n## {name}\n") :].split("\n## ", 2)[1]
        for setting in table.codec(name).settings.model_fields:
            assert f"`{setting}`" in section, f"{name}: {setting}"


def test_the_tree_of_errors_is_the_one_in_the_code() -> None:
    tree = re.search(r"^LidarCodecError\n(?:  .*\n)+", lidarcodec.errors.__doc__ or "", re.M)
    assert tree
    assert f"```\n{tree[0]}```" in (DOCS / "errors.md").read_text()
    named = set(re.findall(r"^ *(\w+Error)", tree[0], re.M))
    assert named == {name for name in vars(lidarcodec.errors) if name.endswith("Error")}


def crc32c(data: bytes) -> int:
    """CRC-32C, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x82F63B78 * (crc & 1)
    return crc ^ 0xFFFFFFFF


def sections_of(data: bytes) -> tuple[dict[str, int], dict[int, bytes]]:
    """Header fields and sections of a message of one frame, as the page says."""
    assert data[:5] == b"\x93LDC\x01"
    assert int.from_bytes(data[-4:], "little") == crc32c(data[:-4])
    names = ["minor", "header", "total", "codec", "flags", "stream", "stamp", "index", "needs", "frames", "width"]
    names += ["packets", "sections"]
    fields = dict(zip(names, struct.unpack_from("<BHIHHQqQQHHHH", data, 5), strict=True))
    assert fields["total"] == len(data)
    at, found = fields["header"], {}
    for _ in range(fields["sections"]):
        kind, _, size = struct.unpack_from("<BBI", data, at)
        found[kind] = data[at + 6 : at + 6 + size]
        at += 6 + size
    assert at == len(data) - 4
    return fields, found


def message_of(codec: str, frame: object, **values: object) -> bytes:
    """A frame's message."""
    encoder = table.make_encoder(StreamSettings(codec=codec, **values), 77)
    return wire.pack(encoder.encode(frame)[0])  # type: ignore[arg-type]


def test_the_checksum_is_the_documented_one() -> None:
    assert crc32c(b"123456789") == 0xE3069283 != zlib.crc32(b"123456789")


def test_raw_by_the_book() -> None:
    frame = frames.irregular_side(6).with_(pose=frames.pose())
    fields, found = sections_of(message_of("raw", frame))
    width, packets = fields["width"], fields["packets"]
    assert (fields["codec"], fields["flags"], fields["stamp"]) == (1, 1, frame.stamp_ns)
    np.testing.assert_array_equal(np.frombuffer(found[1], "<u2").reshape(64, width), frame.range)
    np.testing.assert_array_equal(np.frombuffer(found[3], "u1").reshape(64, width), frame.intensity)
    np.testing.assert_array_equal(np.frombuffer(found[4][: 4 * width], "<u2").reshape(2, width), frame.azimuth)
    halves = np.frombuffer(found[4][4 * width :], "u1")
    np.testing.assert_array_equal([halves & 1, halves >> 1], frame.fired)
    np.testing.assert_array_equal(np.frombuffer(found[10], "<f8").reshape(3, 4), frame.pose[:3])

    side, at = frame.side, 10
    layouts, irregular, second = struct.unpack_from("<HII", found[5])
    for count, dtype, expected in (
        (packets, "<i8", side.packet_ns),
        (packets, "<u4", side.gps_us),
        (2 * packets, "u1", side.status),
        (packets, "<u2", side.layout),
        (12 * layouts, "u1", side.layouts),
        (100 * irregular, "u1", side.irregular),
        (96 * second, "u1", side.second),
    ):
        np.testing.assert_array_equal(np.frombuffer(found[5], dtype, count, at), expected.ravel())
        at += count * np.dtype(dtype).itemsize
    assert at == len(found[5])

    calibration = found[6]
    convention, step, name_bytes = struct.unpack_from("<BIB", calibration, 9)
    assert (calibration[0], convention, step, calibration[15 : 15 + name_bytes]) == (2, 0, 20_000, b"HDL-64E")
    rotation = np.frombuffer(calibration, "<i4", 64, 15 + name_bytes) * 1e-8
    np.testing.assert_allclose(rotation, frame.sensor.calibration["rot_correction_rad"])


def indices_of_groups(data: bytes, valid: int) -> list[int]:
    """Indices of a pcodec RANGE section behind its step."""
    from pcodec import wrapped

    number, at = data[0], 1
    starts, counts = [], []
    for _ in range(number):
        start, count = struct.unpack_from("<BI", data, at)
        starts.append(start)
        counts.append(count)
        at += 5
    pco, read = wrapped.FileDecompressor.new(data[at:])
    at += read
    numbers = []
    for count in counts:
        chunk, read = pco.chunk_decompressor(data[at:], "i16")
        at += read
        page = np.empty(count, np.int16)
        _, read = chunk.read_page_into(data[at:], count, page)
        at += read
        numbers.append(iter(page.tolist()))
    assert at == len(data)
    last, value, values = [0, 0, 0, 0], 0, []
    for _ in range(valid):
        activity = sum(last).bit_length()
        group = max(g for g in range(number) if starts[g] <= activity)
        change = next(numbers[group])
        value = (value + change) % 65536
        last = [*last[1:], abs(change)]
        values.append(value)
    return values


def indices_of_planes(data: bytes, valid: int) -> list[int]:
    """Indices of a zstd RANGE section behind its step."""
    plain = zstandard.ZstdDecompressor().decompress(data)
    assert len(plain) == 2 * valid
    value, values = 0, []
    for low, high in zip(plain[:valid], plain[valid:], strict=True):
        folded = low + 256 * high
        value = (value + (folded >> 1 if folded % 2 == 0 else -(folded + 1 >> 1))) % 65536
        values.append(value)
    return values


@pytest.mark.parametrize("max_error_m", [0, 0.01])
@pytest.mark.parametrize(("codec", "indices_of"), [("zstd", indices_of_planes), ("pcodec", indices_of_groups)])
@pytest.mark.parametrize("frame", [frames.scene(40), frames.noise(3)], ids=["scene", "noise"])
def test_ranges_by_the_book(codec: str, indices_of, frame, max_error_m: float) -> None:
    _, found = sections_of(message_of(codec, frame, max_error_m=max_error_m))
    step = int.from_bytes(found[1][:2], "little")
    assert step == (1 if max_error_m == 0 else 11)
    sent = frame.range[frame.valid].tolist()
    for index, x in zip(indices_of(found[1][2:], len(sent)), sent, strict=True):
        assert index == (x + (step - 1) // 2) // step
        came = ((step - 1) // 2 + 1) // 2 if index == 0 else min(index * step, 65535)
        assert abs(came - x) <= (step - 1) // 2


@pytest.mark.parametrize("frame", [frames.scene(60), frames.noise(40)], ids=["form 0", "form 1"])
def test_grouped_intensities_by_the_book(frame) -> None:
    def plain(data: bytes) -> np.ndarray:
        return np.frombuffer(zstandard.ZstdDecompressor().decompress(data), np.uint8)

    def coded_bytes(data: bytes) -> list[int]:
        number, at = data[0], 1 + 9 * data[0]
        table, groups = [struct.unpack_from("<BII", data, 1 + 9 * g) for g in range(number)], []
        for _, _, size in table:
            groups.append(iter(plain(data[at : at + size]).tolist()))
            at += size
        assert at == len(data)
        values, before = [], 0
        for _ in range(sum(count for _, count, _ in table)):
            before = next(groups[max(g for g in range(number) if table[g][0] <= before)])
            values.append(before)
        return values

    _, found = sections_of(message_of("zstd", frame))
    coded, first = found[3], int.from_bytes(found[3][1:5], "little")
    if coded[0] == 0:
        np.testing.assert_array_equal(coded_bytes(coded[1:]), frame.intensity[frame.valid])
    else:
        np.testing.assert_array_equal(coded_bytes(coded[5 : 5 + first]), frame.intensity[frame.valid])
        np.testing.assert_array_equal(plain(coded[5 + first :]), frame.intensity[~frame.valid])
    for few, quality in {"levels=10": Quality(10), "error=9": Quality(14, 9)}.items():
        _, found = sections_of(message_of("zstd", frame, intensity=few))
        assert found[3][:1] == b"\x02"
        np.testing.assert_array_equal(coded_bytes(found[3][1:]), reduced(frame, quality)[frame.valid])


@pytest.mark.parametrize("frame", [frames.scene(60), frames.noise(40)], ids=["form 3", "form 4"])
def test_modelled_intensities_by_the_book(frame) -> None:
    """What is inside of modelled intensities is checked against their own page in tests/entropy."""

    def modelled(values: np.ndarray) -> bytes:
        return entropy.encode_intensity(values, frame.valid, frame.fired, frame.sensor, turn=turn)

    turn = entropy.columns_in_turn(frame.azimuth)
    _, found = sections_of(message_of("pcodec", frame))
    returns, others = modelled(frame.intensity), frame.intensity[~frame.valid]
    if not others.any():
        assert found[3] == b"\x03" + returns
    else:
        assert found[3][:5] == b"\x04" + struct.pack("<I", len(returns))
        assert found[3][5 : 5 + len(returns)] == returns
        plain = zstandard.ZstdDecompressor().decompress(found[3][5 + len(returns) :])
        np.testing.assert_array_equal(np.frombuffer(plain, np.uint8), others)
    for few, quality in {"levels=10": Quality(10), "error=9": Quality(14, 9)}.items():
        _, found = sections_of(message_of("pcodec", frame, intensity=few))
        assert found[3] == b"\x05" + modelled(reduced(frame, quality))
