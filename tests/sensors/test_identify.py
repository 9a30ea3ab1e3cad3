"""What a user would lose here: a VLP-16 shown as nonsense, or a real HDL-64E refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import PacketError
from lidarcodec.sensors import generic_sensor, identify, identify_stream, status_bytes
from tests.packets import LOWER, UPPER, payload, read_plain_pcap, turning

RNG = np.random.default_rng(3)
ONE_BANK = [(UPPER, 20 * k) for k in range(12)]


@pytest.mark.parametrize(
    ("file", "name"), [("hdl32e_monterey_first800.pcap", "HDL-32E"), ("vlp16_sampleshort.pcap", "VLP-16")]
)
def test_captures_of_other_sensors_are_refused_by_name(data_file, file: str, name: str) -> None:
    payloads = [packet.payload for packet in read_plain_pcap(data_file(file))]
    assert len(payloads) > 250
    with pytest.raises(PacketError, match=f"Velodyne {name}:"):
        identify_stream(payloads)
    for data in payloads[:50]:
        with pytest.raises(PacketError, match=f"Velodyne {name}:"):
            identify(data)


@pytest.mark.parametrize("file", ["hdl64e_s3_atwall.pcap", "kitti_tracking0006_f000-010.pcap.xz"])
def test_every_packet_of_an_hdl64e_is_one(data_file, file: str) -> None:
    payloads = [packet.payload for packet in read_plain_pcap(data_file(file))]
    assert {identify(data) for data in payloads} == {"HDL-64E"}
    assert identify_stream(payloads) == "HDL-64E"


@pytest.mark.parametrize(
    ("model", "name"),
    [(0x21, "HDL-32E"), (0x22, "VLP-16"), (0x24, "Puck Hi-Res"), (0x28, "VLP-32C"), (0x23, "VLP-32A")],
)
@pytest.mark.parametrize("mode", [0x37, 0x38, 0x39])
def test_sensors_that_name_themselves(model: int, name: str, mode: int) -> None:
    with pytest.raises(PacketError, match=name):
        identify(payload(ONE_BANK, RNG, status=bytes([mode, model])))


def test_vls128_sends_four_banks() -> None:
    banks = [0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF]
    single = [(banks[k % 4], k) for k in range(12)]
    dual = [(banks[k // 2], 5) for k in range(8)] + [(0xFFFF, 0)] * 4
    for blocks, mode in ((single, 0x37), (dual, 0x39)):
        with pytest.raises(PacketError, match="VLS-128"):
            identify(payload(blocks, RNG, status=bytes([mode, 0xA1])))


def test_status_bytes_of_an_hdl64e_that_look_like_a_model() -> None:
    regular = [(flag, 18 * k) for k in range(6) for flag in (UPPER, LOWER)]
    for model in (0x21, 0x22, 0x24, 0x28, 0xA1):
        assert identify(payload(regular, RNG, status=bytes([ord("7"), model]))) == "HDL-64E"


def test_an_hdl64e_with_only_its_upper_block_is_known_by_its_stream() -> None:
    status = status_bytes(generic_sensor("HDL-64E S2"), 0, 64)
    status[15] = (ord("7"), 0x22)
    payloads = [payload(ONE_BANK, RNG, status=pair.tobytes()) for pair in status]
    assert identify_stream(payloads) == "HDL-64E"
    with pytest.raises(PacketError, match="VLP-16"):
        identify(payloads[15])


@pytest.mark.parametrize(
    ("size", "what"), [(512, "position packet"), (1248, "Ethernet"), (0, "0 bytes"), (1205, "1205 bytes")]
)
def test_other_lengths_say_what_they_may_be(size: int, what: str) -> None:
    for refuse in (identify, lambda data: identify_stream([data] * 3)):
        with pytest.raises(PacketError, match=what):
            refuse(bytes(size))


def test_position_packets_between_data_packets_do_not_matter() -> None:
    assert identify_stream([bytes(512), *(p.payload for p in turning(3)), bytes(99)]) == "HDL-64E"
    assert identify_stream([]) == "HDL-64E"


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(min_size=1206, max_size=1206), min_size=1, max_size=3))
def test_nonsense_of_the_right_length_passes(payloads: list[bytes]) -> None:
    assert identify_stream(payloads) == "HDL-64E"
