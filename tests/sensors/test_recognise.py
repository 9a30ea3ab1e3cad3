"""What a user would lose here: the right model without any option, and a sentence where a sensor is not known."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import PacketError, SourceError, UnknownNameError
from lidarcodec.sensors import generic_sensor, status_bytes
from lidarcodec.sensors.models.table import PACKETS, detect, names
from lidarcodec.sensors.recognise import check_recognised, recognised, takes
from lidarcodec.sources import open_source
from tests.packets import LOWER, UPPER, payload, turning
from tests.sensors.captures import CAPTURES, model_of, payloads
from tests.sources import captures as c
from tests.sweeps import examples

RNG = np.random.default_rng(3)
ONE_BANK = [(UPPER, 20 * k) for k in range(12)]
MODELS = {name: "hdl64e" if name.startswith("HDL-64E") else model_of(name) for name in CAPTURES}
MODELS["OS-1-128"] = "ouster-128-rng15_rfl8_nir8"


@pytest.mark.parametrize("capture", CAPTURES)
def test_every_capture_is_recognised_with_its_evidence(data_file, capture: str) -> None:
    found = recognised(payloads(data_file(CAPTURES[capture])))
    assert found is not None
    assert found.model == MODELS[capture]
    assert found.evidence
    assert "\n" not in found.evidence


@pytest.mark.parametrize("capture", CAPTURES)
def test_no_other_model_takes_the_packets_of_a_capture(data_file, capture: str) -> None:
    found = payloads(data_file(CAPTURES[capture]))
    able = {name for name in names() if takes(name, found)}
    assert PACKETS in able
    # Any 1206 bytes can be carried as those of an HDL-64E; the packets of an Ouster fit each of its families.
    named = {name for name in able if name != PACKETS and not name.startswith("os")} - {"hdl64e"}
    assert named == {MODELS[capture]} - {"hdl64e", MODELS["OS-1-128"]}
    if capture == "OS-1-128":
        assert {name for name in able if name.startswith("os")} == {"os0-128", "os1-128", "os2-128", "osdome-128"}


def test_a_name_that_is_none_is_refused_with_all_that_are() -> None:
    with pytest.raises(UnknownNameError, match="vlp16"):
        takes("vlp17", [bytes(1206)])


@pytest.mark.parametrize(("model", "name"), [(0x21, "hdl32e"), (0x22, "vlp16"), (0x24, "puck_hires"), (0x28, "vlp32c")])
@pytest.mark.parametrize("mode", [0x37, 0x38, 0x39])
def test_sensors_that_name_themselves(model: int, name: str, mode: int) -> None:
    found = recognised([payload(ONE_BANK, RNG, status=bytes([mode, model]))])
    assert found is not None
    assert found.model == name
    assert f"{mode:02x} {model:02x}" in found.evidence


@pytest.mark.parametrize(("model", "name"), [(0x23, "VLP-32A or VLP-32B"), (0x31, "Velarray")])
def test_a_sensor_that_is_not_known_is_named(model: int, name: str) -> None:
    packets = [payload(ONE_BANK, RNG, status=bytes([0x37, model]))] * 3
    assert recognised(packets) is None
    with pytest.raises(PacketError, match=f"Velodyne {name}, which is not supported: to take"):
        check_recognised(packets)


def test_status_bytes_of_an_hdl64e_that_look_like_a_model() -> None:
    regular = [(flag, 18 * k) for k in range(6) for flag in (UPPER, LOWER)]
    for model in (0x21, 0x22, 0x23, 0x24, 0x28, 0xA1):
        found = recognised([payload(regular, RNG, status=bytes([ord("7"), model]))])
        assert found is not None
        assert found.model == "hdl64e"


def test_an_hdl64e_with_only_its_upper_block_is_known_by_its_stream() -> None:
    status = status_bytes(generic_sensor("HDL-64E S2"), 0, 64)
    status[15] = (ord("7"), 0x22)
    packets = [payload(ONE_BANK, RNG, status=pair.tobytes()) for pair in status]
    found = recognised(packets)
    assert found is not None
    assert found.model == "hdl64e"
    alone = recognised(packets[15:16])
    assert alone is not None
    assert alone.model == "vlp16"


@pytest.mark.parametrize(("size", "what"), [(512, "position packets"), (1248, "1248 bytes"), (0, "0 bytes")])
def test_other_sizes_say_what_they_are(size: int, what: str) -> None:
    assert recognised([bytes(size)] * 3) is None
    with pytest.raises(PacketError, match=what):
        check_recognised([bytes(size)] * 3)


def test_position_packets_between_data_packets_do_not_matter() -> None:
    found = recognised([bytes(512), *(packet.payload for packet in turning(3)), bytes(99)])
    assert found is not None
    assert found.model == "hdl64e"
    assert recognised([]) is None


def frames_of(file, port: int, count: int = 300) -> list[bytes]:
    """Ethernet frames with the first payloads of a capture, to one port."""
    return [c.frame(one, port=port) for one in payloads(file)[:count]]


def test_of_two_sensors_in_one_capture_each_can_be_chosen(data_file, tmp_path) -> None:
    velodyne = frames_of(data_file(CAPTURES["vlp16"]), 2368)
    hesai = frames_of(data_file(CAPTURES["xt16"]), 2369)
    path = tmp_path / "both.pcap"
    path.write_bytes(c.pcap([one for pair in zip(velodyne, hesai, strict=True) for one in pair]))
    for option, model in (("port=2368", "vlp16"), ("port=2369", "xt16"), ("model=xt16", "xt16")):
        with open_source(f"{path}?{option}") as source:
            assert source.sensor.model == model
            assert sum(1 for _ in source.packets()) == 300
    with open_source(path) as source:
        assert source.sensor.model == "vlp16"  # it sends more bytes
        assert sum(1 for _ in source.packets()) == 300
        assert source.counts == {"other datagrams": 300}


def test_a_stream_of_an_unknown_sensor_is_carried_when_it_is_asked_for(tmp_path) -> None:
    rng = random.Random(4)
    sent = [rng.randbytes(rng.randrange(1, 1000)) for _ in range(40)]
    path = tmp_path / "unknown.pcap"
    path.write_bytes(c.pcap(map(c.frame, sent)))
    with pytest.raises(SourceError, match="to take packets of any sensor, add --model packets"):
        open_source(path)
    with open_source(f"{path}?model=packets") as source:
        assert source.sensor.model == PACKETS
        assert [packet.payload for packet in source.packets()] == sent


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.binary(min_size=1206, max_size=1206), min_size=1, max_size=3))
def test_nonsense_of_the_right_length_counts_as_an_hdl64e(packets: list[bytes]) -> None:
    found = recognised(packets)
    assert found is None or found.model in names()


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.binary(max_size=1300), max_size=8))
def test_any_payloads_are_recognised_or_not(packets: list[bytes]) -> None:
    found = detect(packets)
    assert found is None or found.evidence
