"""What a user would lose here: the numbers in a packet, read as the sensor sent them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import PacketError
from lidarcodec.sensors import BlockFlag, build, parse
from tests.packets import payload, turning
from tests.sweeps import examples

WHOLE = st.lists(st.binary(min_size=1206, max_size=1206), max_size=4)


@settings(max_examples=examples(60), deadline=None)
@given(WHOLE)
def test_any_payloads_come_back_from_their_numbers(payloads: list[bytes]) -> None:
    assert build(parse(payloads)) == payloads


def test_every_number_is_where_the_manual_says() -> None:
    rng = np.random.default_rng(5)
    data = payload([(0xDDFF, 7), *[(0xEEFF, 100 + k) for k in range(11)]], rng, gps_us=3_599_999_999, status=b"G\x41")
    packets = parse([data, data])
    assert packets.flags[1].tolist() == [BlockFlag.LOWER] + [BlockFlag.UPPER] * 11
    assert packets.azimuth[0].tolist() == [7, *range(100, 111)]
    assert packets.gps_us.tolist() == [3_599_999_999] * 2
    assert packets.status.tolist() == [[ord("G"), 0x41]] * 2
    for block, laser in ((0, 0), (3, 31), (11, 17)):
        at = block * 100 + 4 + laser * 3
        assert packets.distances[0, block, laser] == int.from_bytes(data[at : at + 2], "little")
        assert packets.intensities[0, block, laser] == data[at + 2]


def test_what_parse_gives_cannot_be_written_to() -> None:
    packets = parse([p.payload for p in turning(2)])
    with pytest.raises(ValueError, match="read-only"):
        packets.azimuth[0, 0] = 1


@pytest.mark.parametrize("size", [0, 1205, 1207, 512])
def test_a_payload_of_another_length_is_refused(size: int) -> None:
    with pytest.raises(PacketError, match=f"this one {size}"):
        parse([bytes(1206), bytes(size)])


def test_build_refuses_what_does_not_fit() -> None:
    packets = parse([bytes(1206)])
    with pytest.raises(PacketError, match="azimuth holds a value outside"):
        build(packets._replace(azimuth=np.full((1, 12), 65536)))
    with pytest.raises(PacketError, match="distances of 1 packets"):
        build(packets._replace(distances=np.zeros((1, 12, 31), np.uint16)))
    with pytest.raises(PacketError, match="intensities"):
        build(packets._replace(intensities=np.zeros((1, 12, 32), np.float32)))
