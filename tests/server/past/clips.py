"""What tests of clips ask of a server."""

from __future__ import annotations

from tests.apps.streams import START_NS
from tests.server.conftest import STREAM, until

PAST = f"{STREAM}/past"
FETCHES = "/api/v1/fetches"


def span(first, last):
    """Query of a clip from one kept frame to another."""
    return {"from": str(START_NS + first * 100_224_000), "to": str(START_NS + last * 100_224_000)}


async def seen(client):
    async def there():
        return (await client.get(STREAM)).status_code == 200

    await until(there)


async def ended(client, where):
    """The fetch, once it is over."""

    async def over():
        told = (await client.get(where)).json()
        return told if told["state"] != "running" else None

    return await until(over)


async def actions(client):
    return [entry["action"] for entry in (await client.get("/api/v1/audit")).json()]
