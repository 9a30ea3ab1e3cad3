"""Position packets live: from a source over the network to the UDP stream, and into the recordings of both ends."""

from __future__ import annotations

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.apps.test_udp_out import Driver
from tests.packets import packets_in
from tests.positions import interleaved, position
from tests.sweeps import sampled
from tests.transport.test_contract import eventually

LAST = list(Loop(3).packets())[-1]
SENT = [*interleaved(Loop(3).packets()), position(LAST.stamp_ns + 4000)]


@pytest.mark.parametrize(
    ("codec", "isolate"), sampled([("pcodec", "never"), ("jpeg", "always")], [("pcodec", "never")])
)
def test_they_reach_the_other_end_and_both_recordings(tmp_path, codec, isolate):
    capture = tmp_path / "drive.pcap"
    with capture.open("wb") as file:
        PcapWriter(file).write_all(SENT)
    data, positions = Driver(), Driver()
    udp = f"{data.address}?position={positions.address.rpartition(':')[2]}"
    network = MemoryNetwork()
    try:
        with (
            network.transport() as near,
            network.transport() as far,
            subscribe(
                "vehicle/lidar", transport=far, udp=udp, record=tmp_path / "far", newest=False, until_end=True,
                isolate=isolate,
            ) as stream,
            open_source(capture) as source,
            Publisher(
                source, StreamSettings(codec=codec, framing="packets:100"), transport=near, rate="max",
                record=tmp_path / "near", isolate=isolate,
            ) as publisher,
        ):  # fmt: skip
            frames = sum(1 for _ in stream)
            sent = stream.summary()["udp"]
            status = publisher.status()
        assert frames == 11
        assert sent["packets"] == status["packets"] == 1044
        assert sent["position packets"] == status["source"]["position packets"] == 76
        assert "position packets not kept" not in status["source"]
        assert eventually(lambda: len(positions.payloads) == 76)
    finally:
        data.close()
        positions.close()
    assert positions.payloads == [packet.payload for packet in SENT if packet.position]
    (near_file,), (far_file,) = (tmp_path / "near").iterdir(), (tmp_path / "far").iterdir()
    assert packets_in(near_file) == SENT
    came = packets_in(far_file)
    assert [packet.position for packet in came] == [packet.position for packet in SENT]
    assert [packet for packet in came if packet.position] == [packet for packet in SENT if packet.position]
