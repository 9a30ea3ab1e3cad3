"""What a user loses if these fail: his capture is not read, or wrongly, or a damaged one brings the program down."""

from __future__ import annotations

import gzip
import itertools
import logging
import lzma
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard

from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.sensors import generic_sensor, status_bytes
from lidarcodec.sources import open_source
from tests.sources import captures as c
from tests.sweeps import ALL, examples

PAYLOADS = [c.payload(k) for k in range(20)]
STAMPS_US = [(c.T0_NS + k * 288_000) // 1000 * 1000 for k in range(20)]


@pytest.fixture
def write(tmp_path: Path):
    def put(data: bytes, name: str = "drive.pcap") -> Path:
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return put


def read(path: Path | str):
    """Payloads, stamps and counts of a source."""
    with open_source(path) as source:
        packets = list(source.packets())
        return [p.payload for p in packets], [p.stamp_ns for p in packets], dict(source.counts)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_all_four_magics_give_the_same_packets_and_their_times(write, order, nanoseconds):
    payloads, stamps, counts = read(write(c.pcap(map(c.frame, PAYLOADS), order=order, nanoseconds=nanoseconds)))
    assert payloads == PAYLOADS
    assert stamps == ([c.T0_NS + k * 288_000 for k in range(20)] if nanoseconds else STAMPS_US)
    assert counts == {}


def datagram_forms(payload: bytes) -> dict[str, tuple[int, list[bytes]]]:
    """The same payload in every wrapping that capture programs write: link type and frames."""
    ip, ip6 = c.ipv4(c.udp(payload)), c.ipv6(c.udp(payload))
    whole, size = c.udp(payload), 800
    fragments = [c.ipv4(whole[:size], flags=0x2000), c.ipv4(whole[size:], flags=size // 8)]
    head6 = [struct.pack(">BBHI", 17, 0, 1, 9), struct.pack(">BBHI", 17, 0, size, 9)]
    fragments6 = [c.ipv6(head6[0] + whole[:size], 44), c.ipv6(head6[1] + whole[size:], 44)]
    sll = struct.pack(">HHH8sH", 0, 1, 6, bytes(8), 0x0800)
    sll2 = struct.pack(">HHIHBB8s", 0x0800, 0, 1, 1, 0, 6, bytes(8))
    return {
        "ethernet": (1, [c.ethernet(ip)]),
        "padded frame": (1, [c.ethernet(ip) + bytes(9)]),
        "vlan": (1, [c.ethernet(ip, [0x8100])]),
        "vlan in vlan": (1, [c.ethernet(ip, [0x88A8, 0x8100])]),
        "ipv4 options": (1, [c.ethernet(c.ipv4(c.udp(payload), options=b"\x94\x04\0\0" * 3))]),
        "total length 0": (1, [c.ethernet(ip[:2] + b"\0\0" + ip[4:])]),
        "ipv6": (1, [c.ethernet(ip6, ethertype=0x86DD)]),
        "ipv6 hop by hop": (1, [c.ethernet(c.ipv6(b"\x11\0" + bytes(6) + c.udp(payload), 0), ethertype=0x86DD)]),
        "sll": (113, [sll + ip]),
        "sll vlan": (113, [sll[:-2] + b"\x81\0" + b"\0\x05\x08\0" + ip]),
        "sll2": (276, [sll2 + ip]),
        "null": (0, [struct.pack("<I", 2) + ip]),
        "loop ipv6": (108, [struct.pack(">I", 24) + ip6]),
        "raw": (101, [ip]),
        "raw ipv6": (101, [ip6]),
        "raw ipv4": (228, [ip]),
        "fragments": (1, list(map(c.ethernet, fragments))),
        "fragments out of order": (1, list(map(c.ethernet, [fragments[1], fragments[0]]))),
        "fragment twice": (1, list(map(c.ethernet, [fragments[0], fragments[0], fragments[1]]))),
        "ipv6 fragments": (101, fragments6),
    }


@pytest.mark.parametrize("form", datagram_forms(PAYLOADS[0]))
def test_a_payload_is_found_in_every_wrapping(write, form):
    linktype, frames = datagram_forms(PAYLOADS[0])[form]
    payloads, _, counts = read(write(c.pcap(frames, linktype=linktype)))
    assert payloads == [PAYLOADS[0]]
    assert counts == {}


def test_whole_position_packets_are_kept_though_their_ip_header_has_the_length_of_a_data_packet(write):
    position = c.udp(bytes(512), port=8308)
    wrong = c.ipv4(position)[:2] + struct.pack(">H", 1234) + c.ipv4(position)[4:]
    path = write(c.pcap([c.frame(PAYLOADS[0]), c.ethernet(wrong), c.ethernet(wrong[:400])]))
    with open_source(path) as source:
        assert [packet.position for packet in source.packets()] == [False, True]
        assert source.counts == {"position packets": 1, "cut packets": 1}


def test_fragments_that_never_complete_are_counted_and_take_bounded_memory(write):
    whole = c.udp(PAYLOADS[1])
    lost = [c.ethernet(c.ipv4(whole[:800], identity=k, flags=0x2000)) for k in range(500)]
    overlap = [
        c.ethernet(c.ipv4(whole[at:end], identity=999, flags=f)) for at, end, f in ((0, 800, 0x2000), (8, None, 1))
    ]
    beyond = [c.ethernet(c.ipv4(whole[:800], identity=998, flags=0x1FFF))]
    payloads, _, counts = read(write(c.pcap([c.frame(PAYLOADS[0]), *lost, *overlap, *beyond])))
    assert payloads == [PAYLOADS[0]]
    assert counts == {"lost fragments": 500, "bad fragments": 2}


@pytest.mark.parametrize("order", ["<", ">"])
def test_pcapng_in_both_byte_orders(write, order):
    payloads, stamps, counts = read(write(c.pcapng(map(c.frame, PAYLOADS), order=order)))
    assert payloads == PAYLOADS
    assert stamps == STAMPS_US
    assert counts == {}


@pytest.mark.parametrize(
    ("resolution", "offset_s", "stamp", "expected_ns"),
    [
        (9, None, c.T0_NS, c.T0_NS),
        (3, None, 1_700_000_000_123, 1_700_000_000_123_000_000),
        (0x80 | 10, None, 1_700_000_000 * 1024 + 512, 1_700_000_000_500_000_000),
        (9, 1_700_000_000, 123_456_789, c.T0_NS),
    ],
)
def test_pcapng_clocks(write, resolution, offset_s, stamp, expected_ns):
    data = c.section() + c.interface(resolution=resolution, offset_s=offset_s)
    data += c.enhanced(c.frame(PAYLOADS[0]), stamp)
    assert read(write(data))[1] == [expected_ns]


def test_pcapng_sections_interfaces_simple_packets_and_strange_blocks(write):
    frames = list(map(c.frame, PAYLOADS))
    raw_ip = c.ipv4(c.udp(PAYLOADS[1]))
    simple = c.block(3, struct.pack("<I", len(frames[2])) + frames[2])
    old = c.block(2, struct.pack("<HHIIII", 0, 0, 0, 5, len(frames[3]), len(frames[3])) + frames[3], "<")
    data = (
        (c.section() + c.interface(1) + c.interface(101))
        + (c.enhanced(frames[0], 1_000_000) + c.enhanced(raw_ip, 2_000_000, index=1) + simple + old)
        + (c.block(0x0BAD, bytes(100)) + c.enhanced(frames[4], 3, index=7))
        + (c.section(">") + c.interface(1, ">") + c.enhanced(frames[5], 4_000_000, ">"))
    )
    payloads, stamps, counts = read(write(data, "drive.pcapng"))
    assert payloads == [PAYLOADS[k] for k in (0, 1, 2, 3, 5)]
    assert stamps == [10**9, 2 * 10**9, 2 * 10**9, 5000, 4 * 10**9]
    assert counts == {"without time stamp": 1, "packets of no interface": 1}


EMPTY = b"\x5a\x2a\x4d\x18\4\0\0\0mine"
"""A frame of zstd that holds nothing, as pzstd writes them."""
COMPRESSIONS = {
    "zst": lambda data: zstandard.compress(data, 3),
    "xz": lambda data: lzma.compress(data, preset=0),
    "gz": lambda data: gzip.compress(data, 1),
    "joined xz": lambda data: lzma.compress(data[:5000], preset=0) + bytes(4) + lzma.compress(data[5000:], preset=0),
    "joined zst": lambda data: zstandard.compress(data[:5000]) + zstandard.compress(data[5000:]),
    "zst with empty frames": lambda data: (
        EMPTY + zstandard.compress(data[:5000]) + EMPTY + zstandard.compress(data[5000:]) + EMPTY
    ),
    "joined gz": lambda data: gzip.compress(data[:5000]) + gzip.compress(data[5000:]),
}


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("make", [c.pcap, c.pcapng])
def test_compression_is_known_by_content_whatever_the_name(write, compression, make):
    data = COMPRESSIONS[compression](make(map(c.frame, PAYLOADS)))
    assert read(write(data, "no hint"))[0] == PAYLOADS


@pytest.mark.parametrize("compression", ["zst", "xz", "gz"])
def test_cut_compressed_captures_give_what_is_whole(write, compression, caplog):
    generator = np.random.default_rng(1)
    payloads = [c.payload(k)[:1204] + b"\0\0" for k in range(300)]
    noise = [c.frame(p[:100] + generator.bytes(1100) + p[1200:]) for p in payloads]
    data = COMPRESSIONS[compression](c.pcap(noise))
    with caplog.at_level(logging.WARNING, "lidarcodec.sources"):
        found, _, counts = read(write(data[: len(data) * 3 // 4]))
    assert 90 < len(found) < 300
    assert found == [f[42:] for f in noise[: len(found)]]
    assert counts == {"truncated": 1}
    assert len([r for r in caplog.records if "truncated" in r.message]) == 1


@pytest.mark.parametrize("compression", ["zst", "xz", "gz"])
def test_damaged_compressed_captures_end_with_a_count(write, compression):
    generator = np.random.default_rng(2)
    data = bytearray(COMPRESSIONS[compression](c.pcap(c.frame(generator.bytes(1206)) for _ in range(100))))
    data[len(data) // 2] ^= 0x55
    try:
        found, _, counts = read(write(bytes(data)))
    except SourceError:  # nothing whole before the damage
        return
    assert len(found) <= 100
    assert set(counts) <= {"damaged", "truncated", "bad packets", "other traffic", "wrong length", "other stream"}


@pytest.mark.drawn
@pytest.mark.parametrize("make", [c.pcap, c.pcapng])
def test_every_prefix_of_a_capture_gives_what_is_whole(write, make, caplog):
    data, sizes = make(map(c.frame, PAYLOADS[:3])), []
    for whole in range(1, 4):
        sizes.append(len(make(map(c.frame, PAYLOADS[:whole]))))
    for cut in [
        *range(0, len(data), 7 if ALL else 29),
        *(size + more for size in sizes for more in (-1, 0, 1)),
        len(data),
    ]:
        whole = sum(size <= cut for size in sizes)
        caplog.clear()
        path = write(data[:cut])
        if whole == 0:
            with pytest.raises(SourceError):
                read(path)
            continue
        payloads, _, counts = read(path)
        assert payloads == PAYLOADS[:whole]
        assert counts == ({} if cut in sizes or cut > len(data) else {"truncated": 1})
        cut_short = [r for r in caplog.records if "this unit has no calibration of its own" not in r.message]
        assert len(cut_short) == len([r for r in cut_short if r.levelno < logging.WARNING]) + len(counts)


@pytest.mark.drawn
@pytest.mark.parametrize("make", [c.pcap, c.pcapng])
def test_mutated_captures_raise_only_our_errors(write, make):
    data = make(map(c.frame, PAYLOADS[:6]))
    generator = np.random.default_rng(7)
    for _ in range(examples(400)):
        mutated = bytearray(data)
        for _ in range(int(generator.integers(1, 12))):
            # mostly in headers: the lengths are there
            at = int(generator.choice([int(generator.integers(len(data))), int(generator.integers(90))]))
            mutated[at] = int(generator.choice([0, 255, 127, 128, int(generator.integers(256))]))
        try:
            payloads, stamps, _ = read(write(bytes(mutated)))
        except LidarCodecError:
            continue
        assert all(len(p) == 1206 for p in payloads)
        assert all(0 <= stamp < 2**63 for stamp in stamps)


@pytest.mark.drawn
def test_random_bytes_behind_a_good_header_raise_only_our_errors(write):
    generator = np.random.default_rng(8)
    heads = [c.pcap([]), c.pcap([], linktype=113), c.section() + c.interface(), c.pcapng(map(c.frame, PAYLOADS[:1]))]
    for number in range(examples(200)):
        junk = generator.bytes(int(generator.integers(0, 3000)))
        try:
            read(write(heads[number % len(heads)] + junk))
        except LidarCodecError:
            continue


def test_a_record_that_claims_gigabytes_ends_the_reading_at_once(write):
    data = c.pcap(map(c.frame, PAYLOADS[:4])) + struct.pack("<IIII", 1, 0, 0x7FFF_FFFF, 1248) + bytes(5000)
    payloads, _, counts = read(write(data))
    assert payloads == PAYLOADS[:4]
    assert counts == {"damaged": 1}


def test_the_most_frequent_sensor_is_taken_and_the_rest_counted(write):
    frames = []
    for k in range(20):
        frames += [c.frame(PAYLOADS[k])] * 2 + [c.frame(PAYLOADS[k], port=2369)]
        frames += [c.frame(PAYLOADS[k], source=c.OTHER)]
    frames += [c.frame(bytes(512), port=8308)] * 3 + [c.frame(bytes(100))] + [c.ethernet(bytes(40), ethertype=0x0806)]
    path = write(c.pcap(frames))
    payloads, _, counts = read(path)
    assert payloads == [p for p in PAYLOADS for _ in range(2)] + [bytes(512)] * 3
    assert counts == {"other stream": 40, "position packets": 3, "wrong length": 1, "other traffic": 1}
    assert read(f"{path}?port=2369&position=off")[0] == PAYLOADS
    other, _, counts = read(f"{path}?src=192.168.3.44")
    assert other == PAYLOADS
    assert counts["position packets not kept"] == 3
    assert counts["other datagrams"] == 1
    with pytest.raises(SourceError, match=r"its streams are: 192.168.3.43 to port 2368"):
        open_source(f"{path}?port=99")
    with pytest.raises(SourceError, match="an IP address"):
        open_source(f"{path}?src=sensor")


def test_of_two_sensors_the_one_that_sends_more_is_taken(write):
    other = (struct.pack("<HH", 0xEEFF, 0) + bytes(96)) * 12 + bytes(4) + b"\x37\x22"
    frames = [c.frame(other, source=c.OTHER)] * 30 + [c.frame(p) for p in PAYLOADS]
    path = write(c.pcap(frames))
    payloads, _, counts = read(path)
    assert payloads == [other] * 30
    assert counts == {"other stream": len(PAYLOADS)}
    assert open_source(path).sensor.model == "vlp16"
    payloads, _, counts = read(f"{path}?src=192.168.3.43")
    assert payloads == PAYLOADS
    assert counts == {"other stream": 30}


def test_a_stream_that_begins_late_is_taken_if_it_is_asked_for(write):
    """`info` counted 151 packets of it, and "no such stream" was the answer to who asked for them."""
    other = (struct.pack("<HH", 0xEEFF, 0) + bytes(96)) * 12 + bytes(4) + b"\x37\x22"
    frames = [c.frame(p) for p in itertools.islice(itertools.cycle(PAYLOADS), 1030)]
    path = write(c.pcap(frames + [c.frame(other, source=c.OTHER)] * 30 + frames))
    assert read(path)[2] == {"other stream": 30}
    payloads, _, counts = read(f"{path}?src=192.168.3.44")
    assert payloads == [other] * 30
    assert counts == {"other stream": 2060}
    with pytest.raises(SourceError, match=r"its streams are: 192.168.3.43 to port 2368, 192.168.3.44 to port 2368$"):
        open_source(f"{path}?src=192.168.3.45")


def test_the_sensors_own_calibration_is_found_wherever_the_file_begins(write):
    table = status_bytes(generic_sensor("HDL-64E S3"))
    payloads = [c.payload(k)[:1204] + table[(k + 3000) % len(table)].tobytes() for k in range(len(table) + 20)]
    with open_source(write(c.pcap(map(c.frame, payloads)))) as source:
        assert source.sensor.origin == "stream"
        assert sum(1 for _ in source.packets()) == len(payloads)
    assert open_source(write(c.pcap(map(c.frame, payloads[:2000])))).sensor.origin == "generic"


def test_a_file_without_sensor_packets_says_what_it_holds(write):
    with pytest.raises(SourceError, match=r"its UDP datagrams are: 3 of 100 bytes"):
        open_source(write(c.pcap([c.frame(bytes(100))] * 3)))
    with pytest.raises(SourceError, match="no UDP datagrams at all"):
        open_source(write(c.pcap([])))
    with pytest.raises(SourceError, match=r"is not a pcap or pcapng file: it is a text file. Give a capture"):
        open_source(write(b"# Hello\n\nworld\n"))
    with pytest.raises(SourceError, match=r"it begins with 52 49 46 46. Give a capture"):
        open_source(write(b"RIFF\x00\x01\x02WAVEfmt "))
    with pytest.raises(SourceError, match="it is empty"):
        open_source(write(b""))


def test_packets_can_be_read_again_and_close_ends_them(write):
    with open_source(write(c.pcap(map(c.frame, PAYLOADS)))) as source:
        assert len(list(source.packets())) == len(list(source.packets())) == 20
        running = source.packets()
        next(running)
        source.close()
        source.close()
        assert list(running) == []


def test_the_real_s3_capture_gives_306_packets_and_one_warning(data_file, caplog):
    with open_source(data_file("hdl64e_s3_atwall.pcap")) as source:
        packets = list(source.packets())
    assert len(packets) == 306
    assert dict(source.counts) == {"truncated": 1}
    assert len([r for r in caplog.records if r.levelno == logging.WARNING]) == 1
    assert source.sensor.origin == "beside"
    assert packets[0].stamp_ns == source.start_ns == 1404833944288631000
    assert all(b.stamp_ns > a.stamp_ns for a, b in itertools.pairwise(packets))


@pytest.mark.parametrize(
    ("name", "model", "packets"),
    [("hdl32e_monterey_first800.pcap", "hdl32e", 720), ("vlp16_sampleshort.pcap", "vlp16", 291)],
)
def test_captures_of_other_sensors_are_taken_by_name(data_file, name, model, packets):
    with open_source(data_file(name)) as source:
        assert source.sensor.model == model
        assert sum(not packet.position for packet in source.packets()) == packets
        assert set(source.counts) <= {"position packets", "truncated"}
        assert source.counts["position packets"]


def test_a_compressed_kitti_capture_streams(data_file):
    with open_source(data_file("kitti_tracking0006_f000-010.pcap.xz")) as source:
        stamps = np.array([packet.stamp_ns for packet in source.packets()])
    assert len(stamps) == (5_002_936 - 24) // 1264
    assert dict(source.counts) == {}
    assert 280_000 < np.median(np.diff(stamps)) < 295_000


@pytest.mark.parametrize("ending", [".pcap", ".pcap.zst"])
def test_a_tail_of_zeros_ends_the_reading_at_once(write, ending):
    """What a power cut leaves behind; and a gigabyte of them in a small archive would be read for minutes."""
    data = c.pcap(map(c.frame, PAYLOADS)) + bytes(5_000_000)
    payloads, _, counts = read(write(zstandard.compress(data) if ending.endswith("zst") else data, f"drive{ending}"))
    assert payloads == PAYLOADS
    assert counts == {"damaged": 1}
