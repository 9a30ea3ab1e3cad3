"""What a user would lose here: the calibration that an S2 or S3 sends by itself, when no file is at hand."""

from __future__ import annotations

import numpy as np
import pytest
import velodyne_decoder as vd
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import CalibrationError, PacketError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors import STATUS_PACKETS, StatusClock, StatusReader, generic_sensor, parameter_bytes, status_bytes
from lidarcodec.sensors.status import STEPS, crc16
from tests.packets import read_plain_pcap
from tests.sweeps import examples

CLOCK = StatusClock(2011, 9, 26, 13, 4, 38, ord("A"), 31, 0x47)
SENSOR = generic_sensor("HDL-64E S3")


def rounded(sensor: SensorModel) -> Calibration:
    """What is left of a calibration after the steps of the status bytes."""
    steps = dict(STEPS.values())
    return Calibration.from_values(
        {name: np.rint(sensor.calibration[name] / steps[name]) * steps[name] for name in CALIBRATION_FIELDS}
    )


def stream(
    count: int, start: int = 0, *, s3: bool = False, interval_us: int = 288, seed_us: int = 3_599_000_000
) -> list[bytes]:
    """Payloads with status bytes and a running clock, which passes the hour."""
    status = status_bytes(SENSOR, start, count, s3=s3, clock=CLOCK)
    stamps = (seed_us + interval_us * np.arange(count)) % 3_600_000_000
    return [
        bytes(1200) + int(us).to_bytes(4, "little") + pair.tobytes() for us, pair in zip(stamps, status, strict=True)
    ]


def read(payloads: list[bytes]) -> StatusReader:
    reader = StatusReader()
    for data in payloads:
        reader.push(data)
    return reader


@pytest.mark.parametrize("s3", [False, True])
@pytest.mark.parametrize("start", [0, 1, 4000])
def test_the_table_is_read_within_two_rounds(s3: bool, start: int) -> None:
    reader = StatusReader()
    done = [reader.push(data) for data in stream(2 * STATUS_PACKETS, start, s3=s3)]
    assert done.count(True) == 1
    assert done.index(True) <= STATUS_PACKETS + (16 if start else 0)
    assert reader.sensor is not None
    assert reader.sensor.name == ("HDL-64E S3" if s3 else "HDL-64E S2")
    assert reader.sensor.origin == "stream"
    assert np.array_equal(reader.sensor.calibration.table, rounded(SENSOR).table)
    assert reader.clock == CLOCK
    assert reader.unit is not None
    assert (reader.unit.rpm, reader.unit.fov_cdeg, reader.unit.hours) == (600, (0, 36000), 100)
    assert (reader.unit.source_ip, reader.unit.destination_ip) == ("192.168.3.43", "192.168.3.255")
    assert (reader.unit.calibrated, reader.unit.power_level) == ((2011, 9, 26, 12, 0, 0), 0xA8)


@pytest.mark.parametrize("s3", [False, True])
def test_velodyne_decoder_reads_the_same_table(s3: bool) -> None:
    info = vd.hdl64e.read_status_info(stream(2 * STATUS_PACKETS, 1234, s3=s3))
    lasers = vd.hdl64e.status_info_to_calib_dict(info)["lasers"]
    sensor = read(stream(2 * STATUS_PACKETS, 1234, s3=s3)).sensor
    assert sensor is not None
    names = {name: name.removesuffix("_rad").removesuffix("_m") for name in CALIBRATION_FIELDS}
    names |= {"vert_offset_m": "vert_offset_correction", "horiz_offset_m": "horiz_offset_correction"}
    for name, theirs in names.items():
        assert np.allclose([laser[theirs] for laser in lasers], sensor.calibration[name], atol=6e-8), name
    assert info["Model"] == ("S3" if s3 else "S2")
    assert str(info["Current Time"]) == "2011-09-26 13:04:38"
    assert (info["RPM"], info["FOV Max"], info["Multiple Return Status"]) == (600, 36000, "Strongest")
    assert (info["IP Source"], info["Power Level Status"]) == ("192.168.3.43", "A8")


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, STATUS_PACKETS - 1), st.booleans())
def test_losses_repeats_and_gaps_never_give_a_wrong_table(seed: int, start: int, clock_runs: bool) -> None:
    rng = np.random.default_rng(seed)
    # of four rounds, one in 1,500 tries loses a value each time
    payloads = stream(6 * STATUS_PACKETS, start, s3=bool(seed & 1), interval_us=288 if clock_runs else 0)
    kept = rng.random(len(payloads)) > 0.02
    if clock_runs:  # only then can a burst of more than fifteen be told
        for at in rng.integers(0, len(payloads), 2):
            kept[at : at + int(rng.integers(16, 400))] = False
    received = [data for data, keep in zip(payloads, kept, strict=True) if keep]
    received = [data for data in received for _ in range(1 + (rng.random() < 0.01))]
    reader = read(received)
    assert reader.failed == 0
    assert reader.sensor is not None
    assert np.array_equal(reader.sensor.calibration.table, rounded(SENSOR).table)


def test_a_clock_that_jumps_costs_a_round_and_no_more() -> None:
    first, second = stream(3000, 50), stream(2 * STATUS_PACKETS, 777, seed_us=5)
    reader = read(first + second)
    assert reader.runs == 1
    assert reader.sensor is not None
    assert np.array_equal(reader.sensor.calibration.table, rounded(SENSOR).table)


def test_a_wrong_checksum_is_no_table() -> None:
    payloads = stream(3 * STATUS_PACKETS, s3=True)
    parameters = parameter_bytes(SENSOR, s3=True)
    place = (300 // 7) * 16 + 9 + 300 % 7
    broken = payloads[place : place + 1][0][:-1] + bytes([parameters[300] ^ 1])
    once = [*payloads[:place], broken, *payloads[place + 1 : STATUS_PACKETS]]
    reader = read(once)
    assert (reader.sensor, reader.failed) == (None, 1)
    for data in payloads[STATUS_PACKETS:]:
        reader.push(data)
    assert reader.sensor is not None
    assert np.array_equal(reader.sensor.calibration.table, rounded(SENSOR).table)


def test_a_sensor_without_a_calibration_in_its_memory_gives_none() -> None:
    payloads = [
        data[:-1] + (b"\xff" if 49 <= data[-2] <= 55 and place % 4160 > 16 else data[-1:])
        for place, data in enumerate(stream(STATUS_PACKETS))
    ]
    assert read(payloads).sensor is None


@pytest.mark.parametrize("file", ["hdl64e_s3_atwall.pcap", "kitti_tracking0006_f000-010.pcap.xz"])
def test_captures_whose_tails_are_something_else_give_no_table(data_file, file: str) -> None:
    reader = read([packet.payload for packet in read_plain_pcap(data_file(file))])
    assert (reader.sensor, reader.failed) == (None, 0)


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(0, 2**32 - 1)), max_size=200))
def test_any_status_bytes_are_taken(values: list[tuple[int, int, int]]) -> None:
    reader = StatusReader()
    for kind, value, gps_us in values:
        assert reader.push_status(kind, value, gps_us) is False
    assert reader.sensor is None


def test_the_clock_is_known_once_all_of_it_was_seen() -> None:
    assert read(stream(5)).clock is None
    assert read(stream(9)).clock == CLOCK


def test_a_wrong_length_and_a_table_that_does_not_fit_are_refused() -> None:
    with pytest.raises(PacketError, match="1206"):
        StatusReader().push(b"x")
    far = SensorModel("x", Calibration.from_values({"dist_correction_m": np.full(64, 40.0)}))
    with pytest.raises(CalibrationError, match="dist_correction_m"):
        parameter_bytes(far)


def test_the_checksum_is_the_published_crc16() -> None:
    assert crc16(b"123456789") == 0xFEE8  # CRC-16/UMTS
