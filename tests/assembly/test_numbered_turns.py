"""What a user would lose here: whole turns of a sensor that numbers them, though it sends a part of each only."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.assembly.any_sensor import MAX_LATE, TurnWatch
from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.ouster.sensor import OusterSensor
from tests.sensors.ouster_packets import LAYOUTS, likely_packets


@pytest.mark.parametrize("name", ["RNG15_RFL8_NIR8 16", "FUSA_RNG15_RFL8_NIR8_DUAL 16", "LEGACY 16"])
def test_a_turn_begins_with_its_number(name: str) -> None:
    layout = LAYOUTS[name]
    watch = TurnWatch(OusterSensor(layout).generic_sensor)
    turns = [65533, 65533, 65534, 65534, 65535, 0, 65535, 65534, 0, 1, 1, 3, 2, 3, 40, 10]
    images = layout.split(likely_packets(layout, len(turns)))
    kind = images.series["frame_id"].dtype
    ids = np.repeat(np.array(turns, kind), len(images.series["frame_id"]) // len(turns))
    packets = layout.join(Images(images.planes, {**images.series, "frame_id": ids}))
    begins = [number for number, packet in enumerate(packets) if watch.begins(packet.tobytes())]
    assert [turns[number] for number in begins] == [65534, 65535, 0, 1, 3, 40, 10]
    watch.forget()
    assert not watch.begins(packets[0].tobytes())


def test_a_sensor_that_begins_anew_a_turn_earlier_is_not_late_for_ever() -> None:
    layout = LAYOUTS["RNG15_RFL8_NIR8 16"]
    watch = TurnWatch(OusterSensor(layout).generic_sensor)
    turns = [7] * 80 + [6] * 80
    images = layout.split(likely_packets(layout, len(turns)))
    kind = images.series["frame_id"].dtype
    ids = np.repeat(np.array(turns, kind), len(images.series["frame_id"]) // len(turns))
    packets = layout.join(Images(images.planes, {**images.series, "frame_id": ids}))
    begins = [number for number, packet in enumerate(packets) if watch.begins(packet.tobytes())]
    assert begins == [80 + MAX_LATE]
