"""Real captures through the whole path over Zenoh: every payload that went in comes out."""

from __future__ import annotations

from itertools import product

import pytest

import lidarcodec
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.assembly import packets_of
from lidarcodec.sources import open_source
from lidarcodec.transport import Endpoints
from tests.packets import payloads_in
from tests.sweeps import sampled
from tests.transport.conftest import free_port


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "framing"),
    sampled(
        product(
            ["hdl64e_s3_atwall.pcap", "kitti_tracking0006_f000-010.pcap.xz", "kitti_sfnd_f000-049.pcap.xz"],
            ["packets", "revolution"],
        ),
        [
            ("hdl64e_s3_atwall.pcap", "packets"),
            ("hdl64e_s3_atwall.pcap", "revolution"),
            ("kitti_tracking0006_f000-010.pcap.xz", "packets"),
        ],
    ),
)
def test_every_payload_arrives(data_file, name, framing):
    path, port = data_file(name), free_port()
    sent = payloads_in(path)
    with (
        subscribe(newest=False, until_end=True, loopback_port=port) as stream,
        open_source(path) as source,
        Publisher(
            source,
            lidarcodec.StreamSettings(framing=framing),
            rate="max",
            endpoints=Endpoints(loopback_port=port),
        ) as car,
    ):
        received = [packet.payload for frame in stream for packet in packets_of(frame)]
        assert received == sent
        assert car.status()["errors"] == stream.summary()["errors"] == {}
