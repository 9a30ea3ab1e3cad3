"""What a user would lose here: points in their true places, because an angle correction file was read wrongly."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors import hesai_csv
from lidarcodec.sensors.models.hesai_packet import HesaiSensor
from lidarcodec.sensors.models.table import block_sensors

HEADER = "Laser id,Elevation,Azimuth\n"
TWO = HEADER + "1,14.882,-1.042\n2,11.032,-1.041\n"

SENSORS = [sensor for sensor in block_sensors() if isinstance(sensor, HesaiSensor)]


def test_angles_come_out_by_channel_with_the_azimuth_subtracted() -> None:
    calibration = hesai_csv.parse(TWO.encode(), 2)
    assert np.degrees(calibration["vert_correction_rad"]) == pytest.approx([14.882, 11.032], abs=1e-6)
    assert np.degrees(calibration["rot_correction_rad"]) == pytest.approx([1.042, 1.041], abs=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        TWO.replace("\n", "\r\n"),
        "\ufeff" + TWO,
        TWO.replace("Laser id", "Channel"),
        "\n" + TWO + "\n\n",
        HEADER + "2, 11.032 , -1.041,\n1,14.882,-1.042,,\n",
    ],
)
def test_forms_of_the_same_file_are_read_alike(text: str) -> None:
    assert np.array_equal(hesai_csv.parse(text.encode(), 2).table, hesai_csv.parse(TWO.encode(), 2).table)


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda sensor: sensor.name)
def test_a_file_that_was_written_gives_the_calibration_back(sensor) -> None:
    table = sensor.generic_sensor.calibration
    assert np.array_equal(sensor.calibration_of(hesai_csv.text(table).encode()).table, table.table)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "its first line is not"),
        ("1,2,3\n", "its first line is not"),
        ("<xml/>", "its first line is not"),
        (HEADER, "it has 0 channels, but this sensor has 2: it belongs to another model"),
        (HEADER + "1,1,1\n", "it has 1 channels, but this sensor has 2"),
        (TWO + "3,1,1\n", "line 4: channel 3 does not exist, this sensor has 1 to 2"),
        (HEADER + "0,1,1\n1,1,1\n", "line 2: channel 0 does not exist"),
        (TWO + "1,1,1\n", "line 4: channel 1 occurs twice"),
        (HEADER + "1,2\n", "line 2 has 2 values instead of channel, elevation and azimuth"),
        (HEADER + "one,1,1\n", "line 2: the channel must be a whole number, not 'one'"),
        (HEADER + "-1,1,1\n", "line 2: the channel must be a whole number"),
        (HEADER + "1" * 5000 + ",1,1\n", "line 2: the channel must be a whole number"),
        (HEADER + "\u00b2,1,1\n", "line 2: the channel must be a whole number"),
        (HEADER + "1,up,1\n", "line 2: the elevation must be degrees within 90, not 'up'"),
        (HEADER + "1,nan,1\n", "line 2: the elevation must be degrees within 90"),
        (HEADER + "1,inf,1\n", "line 2: the elevation must be degrees within 90"),
        (HEADER + "1,91,1\n", "line 2: the elevation must be degrees within 90"),
        (HEADER + "1,1,-361\n", "line 2: the azimuth must be degrees within 360"),
        (HEADER + "1,1,1\n" * 20_000, "it has 120,027 bytes"),
    ],
)
def test_files_that_are_none_are_refused_with_the_reason(text: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message) as error:
        hesai_csv.parse(text.encode(), 2)
    assert len(str(error.value)) < 200
    assert "\n" not in str(error.value)


def test_a_file_that_is_no_text_is_refused() -> None:
    with pytest.raises(CalibrationError, match="it is not text"):
        hesai_csv.parse(b"\xff\xfe\x00", 2)


@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(lambda text: (HEADER + text).encode())))
@settings(deadline=None)
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(CalibrationError):
        assert hesai_csv.parse(data, 2).table.shape == (11, 2)
