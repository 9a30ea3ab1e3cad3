"""The document is the manual, and what clients are generated from: it has to be there and true."""

from __future__ import annotations

import ast
import json
import shlex
from itertools import pairwise

import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.other_sensors import check_for
from lidarcodec.errors import SettingsError
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import StreamSettings
from lidarcodec_server import openapi, problems
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from tests.conftest import ROOT
from tests.server.conftest import until


def test_the_document_in_the_repository_is_that_of_the_code():
    made = openapi.text(create_app(ServerConfig(database_url="sqlite://")))
    kept = (ROOT / "docs" / "openapi.json").read_text()
    assert made == kept, "write it anew: python -m lidarcodec_server.openapi docs/openapi.json"


def test_every_route_says_what_it_does_and_which_problems_come():
    document = create_app(ServerConfig(database_url="sqlite://")).openapi()
    for path, methods in document["paths"].items():
        for method, about in methods.items():
            assert about.get("description"), f"{method} {path}"
            problems = [
                one for one in about["responses"].values() if "application/problem+json" in one.get("content", {})
            ]
            assert len(problems) >= 10, f"{method} {path}"


def test_every_route_has_its_line_in_the_manual():
    page = (ROOT / "docs" / "server.md").read_text()
    for path, methods in json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"].items():
        for method in methods:
            assert f"`{method.upper()} {path}`" in page, f"{method} {path}"


def given_problems():
    """Name and status, as they are written, of every problem that the server raises by name."""
    for _, status, name in problems.NAMES:
        yield name, str(status)
    for path in (ROOT / "server").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "ProblemError" and len(call.args) > 2:
                status, _, name = call.args[:3]
                if isinstance(name, ast.Constant) and isinstance(status, ast.Constant):
                    yield name.value, str(status.value)


def test_every_problem_has_its_line_in_the_manual_with_its_status():
    page = (ROOT / "docs" / "server.md").read_text().partition("\n## Errors\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1:3] for line in page.splitlines() if line.startswith("|")]
    found = set(given_problems())
    assert ("busy", "409") in found
    for name, status in found:
        assert any(f"`{name}`" in names and status in statuses for names, statuses in rows), f"{name}, {status}"


def shown_requests():
    """Method, path, headers and body of every `curl` of the manual that needs no token."""
    for line in (ROOT / "docs" / "server.md").read_text().splitlines():
        words = shlex.split(line) if line.startswith("curl ") else []
        given = dict(pairwise(words))
        for word in words:
            if word.startswith("http://127.0.0.1:8080"):
                headers = dict([given["-H"].split(": ")]) if "-H" in given else {}
                yield given.get("-X", "GET"), word.removeprefix("http://127.0.0.1:8080"), headers, given.get("-d")


async def test_every_request_that_the_manual_shows_works(serving, vehicle):
    vehicle()
    async with serving() as client:

        async def there():
            return (await client.get("/api/v1/streams")).json()

        await until(there)
        asked = list(shown_requests())
        assert len(asked) >= 7
        for method, path, headers, body in asked:
            answer = await client.request(method, path, headers=headers, content=body)
            assert answer.status_code == 200, (method, path, answer.text)


async def test_every_codec_says_what_it_takes_and_reaches(serving):
    async with serving() as client:
        found = {one["name"]: one for one in (await client.get("/api/v1/codecs")).json()}
    assert set(found) == set(table.names())
    for name, about in found.items():
        codec = table.codec(name)
        its = about["settings_schema"].get("properties", {})
        assert set(its) == set(codec.settings.model_fields)
        assert all(one["description"] for one in its.values()), "a form that does not say what a field does"
        assert about["bound"] == codec.bounded
        if about["clouds"]:
            check_for(cloud_sensor([]), StreamSettings(codec=name))
        else:
            with pytest.raises(SettingsError, match="takes no point clouds"):
                check_for(cloud_sensor([]), StreamSettings(codec=name))
    low, high = found["pcodec"]["reach"]["range_kbps"]
    assert 0 < low < high < 40_000
    assert found["raw"]["reach"] is None


async def test_the_document_names_every_setting_that_can_be_changed(serving):
    async with serving() as client:
        document = (await client.get("/openapi.json")).json()
    patch = document["paths"]["/api/v1/streams/{vehicle}/{sensor}/settings"]["patch"]
    schema = patch["requestBody"]["content"]["application/json"]["schema"]
    assert set(schema["properties"]) == set(StreamSettings.model_fields)
    assert all(one["description"] for one in schema["properties"].values())
    assert schema["additionalProperties"] is False


@pytest.mark.sweep
@pytest.mark.timeout(300)  # it computes all the time, and a busy machine takes its own
def test_hostile_requests_get_answers_that_the_document_allows(tmp_path):
    """`make faults` asks a thousand; these few hold the way open."""
    from tests.server import hostile  # the only one who needs schemathesis, which takes long to import

    with hostile.serving(tmp_path) as (url, vehicle):
        seen = hostile.attack(url, 20, 7)
        assert seen.total() >= 20
        assert seen[422] > 8
        hostile.check_unharmed(url, vehicle)
