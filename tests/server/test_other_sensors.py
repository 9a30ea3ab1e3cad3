"""If these fail, a viewer sees wrong points of another sensor than an HDL-64E, or an operator breaks its stream."""

from __future__ import annotations

import asyncio

import httpx
import numpy as np
import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests.sensors.captures import CAPTURES
from tests.server.conftest import until
from tests.server.live import client_module, event, frame, running
from tests.sweeps import sampled

STREAM = "vehicle/lidar"


class Again:
    """A capture again and again."""

    def __init__(self, path) -> None:
        self._source = open_source(path)
        self.sensor, self.live, self.label, self.counts = (
            self._source.sensor, False, str(path), self._source.counts,
        )  # fmt: skip
        self._packets = list(self._source.packets())
        self._closed = False

    def packets(self):
        while not self._closed:
            yield from self._packets

    def finish(self):
        self._closed = True

    def close(self):
        self._closed = True
        self._source.close()


@pytest.fixture(params=sampled(["vlp16", "pandar40p"], ["vlp16"]))
def path(request, data_file):
    return data_file(CAPTURES[request.param])


@pytest.mark.data
async def test_viewers_get_the_points_pictures_and_model_of_the_sensor(path, tmp_path):
    with open_source(path) as source:
        # Three times: one frame begins in one round of the capture and ends in the next.
        frames = list(frames_of(iter(3 * list(source.packets())), source.sensor))
        name = source.sensor.name
    clouds = {len(one.cloud()): one.cloud() for one in frames}
    with (
        running(tmp_path) as server,
        Publisher(Again(path), StreamSettings(), transport=server.network.transport(), rate=10.0),
    ):
        assert server.seen()
        async with server.socket(f"{STREAM}/cloud?attributes=intensity,ring") as socket:
            sensor = await event(socket, "sensor")
            head, arrays = client_module().read_message(await frame(socket))
        assert sensor["name"] == name
        assert head["count"] in clouds
        cloud = clouds[head["count"]]
        points = client_module().points_of(head, arrays)
        for number, axis in enumerate("xyz"):
            assert np.abs(points[:, number] - cloud[axis]).max() <= head["scale_m"] * 0.51
        assert np.array_equal(arrays["ring"], cloud["ring"])
        assert np.array_equal(arrays["intensity"], np.minimum(cloud["intensity"], 255))
        async with server.socket(f"{STREAM}/cloud?form=range") as socket:
            head, arrays = client_module().read_message(await frame(socket))
        assert head["rings"] == frames[0].sensor.rows
        async with httpx.AsyncClient(base_url=f"{server.url}/api/v1/streams/", timeout=30.0) as client:
            for view in ("cloud", "range"):
                answer = await client.get(f"{STREAM}/snapshot.png", params={"view": view})
                assert (answer.status_code, answer.content[:4]) == (200, b"\x89PNG"), answer.text[:300]

            async def told() -> bool:  # once a second
                return name in str((await client.get(STREAM)).json())

            assert await until(told)
            answer = await client.patch(f"{STREAM}/settings", json={"base_error_m": 0.1})
            assert answer.status_code == 422, answer.text
            assert "HDL-64E" in answer.text
            asked = {"codec": "predictive", "target_kbps": 2000.0, "intensity": "levels=8", "reduction": "lattice:2"}

            async def carried() -> bool:  # what was learned of the settings before is no measure of these
                answer = await client.patch(f"{STREAM}/settings", json=asked)
                assert answer.status_code == 200, answer.text
                return answer.json()["warnings"] == [] or await asyncio.sleep(1.0)

            assert await until(carried)
            answer = await client.patch(f"{STREAM}/settings", params={"strict": True}, json={"target_kbps": 2.0})
            assert answer.status_code == 422, answer.text
            assert "cannot carry every frame" in answer.json()["detail"]
