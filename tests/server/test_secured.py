"""The server in a secured deployment: what an operator's certificate allows it, and what a viewer's does not."""

from __future__ import annotations

import httpx
import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.transport import Endpoints
from lidarcodec_server.app import create_app
from tests.apps.streams import Loop
from tests.server.conftest import STREAM, until
from tests.transport.secured import Secured

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    """A router that knows everybody by certificate, with the vehicle car-7 behind it."""
    made = Secured(tmp_path_factory.mktemp("certificates"), "certificate")
    endpoints = Endpoints.of(config=made.folder / "vehicle-car-7.json5")
    with Publisher(Loop(), vehicle="car-7", sensor="roof", endpoints=endpoints) as vehicle:
        made.vehicle = vehicle
        yield made
    made.close()


@pytest.mark.parametrize(("name", "status"), [("viewer-anna", 202), ("operator-olga", 200)])
async def test_a_server_changes_streams_as_an_operator_and_cannot_as_a_viewer(secured, config, name, status):
    endpoints = Endpoints.of(config=secured.folder / f"{name}.json5")
    app = create_app(config.model_copy(update={"endpoints": endpoints, "answer_s": 10.0 if status == 200 else 0.5}))
    wire = httpx.ASGITransport(app, client=("127.0.0.1", 50_000))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=wire, base_url="http://127.0.0.1") as client,
    ):

        async def told():
            found = await client.get(STREAM)
            return found.status_code == 200 and found.json()["alive"] and found.json()["status"]

        await until(told, 60)
        answer = await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
        assert answer.status_code == status
        assert (await client.post(f"{STREAM}/keyframe")).status_code == 200
        assert secured.vehicle.settings.codec == ("zstd" if status == 200 else "pcodec")
