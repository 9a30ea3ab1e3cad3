"""What a user loses if these fail: other programs do not read the captures that `decode` writes."""

from __future__ import annotations

import io
import struct

import dpkt
import pytest

from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter, checksum
from tests.sources import captures as c

PACKETS = [Packet(c.payload(k), c.T0_NS + k * 288_123) for k in range(50)]


def written(packets, **options) -> bytes:
    file = io.BytesIO()
    assert PcapWriter(file, **options).write_all(packets) == len(packets)
    return file.getvalue()


@pytest.mark.parametrize("nanoseconds", [True, False])
def test_what_is_written_comes_back(tmp_path, nanoseconds):
    path = tmp_path / "out.pcap"
    path.write_bytes(written(PACKETS, nanoseconds=nanoseconds))
    step = 1 if nanoseconds else 1000
    with open_source(path) as source:
        assert list(source.packets()) == [Packet(p, ns // step * step) for p, ns, _ in PACKETS]
        assert not source.counts


def test_dpkt_reads_headers_and_payloads():
    for (_, data), packet in zip(dpkt.pcap.Reader(io.BytesIO(written(PACKETS))), PACKETS, strict=True):
        ethernet = dpkt.ethernet.Ethernet(data)
        ip, udp = ethernet.data, ethernet.data.data
        assert (ip.src, ip.dst, udp.sport, udp.dport) == (c.SENSOR, c.BROADCAST, 443, 2368)
        assert ethernet.dst == b"\xff" * 6
        assert udp.data == packet.payload


def test_the_ip_check_sum_is_right():
    header = written(PACKETS[:1])[24 + 16 + 14 :][:20]
    words = struct.unpack(">10H", header)
    assert checksum(header) == 0  # a right header sums up to nothing
    assert sum(words) % 0xFFFF == 0
    assert words[1] == 20 + 8 + 1206


def test_what_a_pcap_file_cannot_hold_is_refused():
    writer = PcapWriter(io.BytesIO())
    for stamp_ns in (-1, 2**32 * 10**9):
        with pytest.raises(SourceError, match="1970 to 2106"):
            writer.write(Packet(bytes(1206), stamp_ns))
    with pytest.raises(SourceError, match="limit 65507"):
        writer.write(Packet(bytes(65_508), 0))
