"""Hostile requests at a running server: made from the OpenAPI document by schemathesis, and bodies of our own.

    python -m tests.server.hostile --cases 1000 --seed 1

Each answer has to be one that the document allows, no error of the server may come, and afterwards the server and the
vehicle behind it have to work as before.
"""

from __future__ import annotations

import argparse
import json
import logging
import random
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import requests
import schemathesis
import uvicorn
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.listening import listen
from tests.apps.streams import Loop

CHECKS = [status_code_conformance, content_type_conformance, response_schema_conformance]
PATCH = "/api/v1/streams/car-7/roof/settings?prepare=true"
START_S = 30.0


@contextmanager
def serving(folder: Path) -> Iterator[tuple[str, Publisher]]:
    """A server on loopback, with a vehicle car-7/roof behind it; its address, and the vehicle."""
    network = MemoryNetwork()
    config = ServerConfig(database_url=f"sqlite:///{folder / 'server.db'}", changes_per_second=1e6, burst=1_000_000)
    app = create_app(config, transport=network.transport())
    listener = listen("127.0.0.1", 0)
    server = uvicorn.Server(uvicorn.Config(app, http="h11", log_config=None, log_level="critical", lifespan="on"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    with Publisher(Loop(), vehicle="car-7", sensor="roof", transport=network.transport()) as vehicle:
        thread.start()
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        for _ in range(int(START_S / 0.05)):
            if server.started:
                break
            threading.Event().wait(0.05)
        try:
            yield url, vehicle
        finally:
            server.should_exit = True
            thread.join(10)
            listener.close()


def own_bodies(count: int, number: int) -> Iterator[bytes]:
    """Bodies that no generator of JSON makes."""
    rng = random.Random(number)
    fields = ["codec", "max_error_m", "target_kbps", "codec_settings", "framing", "key_interval", "follow", "x" * 5000]
    values = [
        "1e999",
        "-1e999",
        "NaN",
        "Infinity",
        "1" * 5000,
        "-0.0",
        '"\\ud800"',
        '"\\u0000"',
        "[" * 2000,
        "null",
        "true",
    ]
    values += [
        '{"quality":' * 500,
        '{"level": 1e308}',
        '"packets:99999999999"',
        '"levels=0"',
        "[]",
        '"../../etc"',
        "0.1e-400",
    ]
    for turn in range(count):
        kind = turn % 4
        if kind == 0:
            yield rng.randbytes(rng.randrange(300))
        elif kind == 1:
            yield f'{{"{rng.choice(fields)}": {rng.choice(values)}}}'.encode()
        elif kind == 2:
            pairs = ", ".join(f'"{rng.choice(fields)}": {rng.choice(values)}' for _ in range(rng.randrange(40)))
            yield f"{{{pairs}}}".encode()
        else:
            whole = json.dumps({rng.choice(fields): rng.choice(values) for _ in range(3)}).encode()
            yield whole[: rng.randrange(len(whole))]


def attack(url: str, cases: int, number: int) -> Counter[int]:
    """Ask, check every answer, and count the statuses.

    Raises AssertionError, or schemathesis' failures, for an answer that the document does not allow.
    """
    seen: Counter[int] = Counter()
    session = requests.Session()
    document = session.get(f"{url}/openapi.json", timeout=60).json()
    schema = schemathesis.openapi.from_dict(document)
    operations = [found.ok() for found in schema.get_all_operations()]
    patch = next(one for one in operations if one.method == "patch")
    plan = [(one, GenerationMode.NEGATIVE) for one in operations for _ in range(1)]
    plan += [(patch, GenerationMode.NEGATIVE)] * len(operations) + [(patch, GenerationMode.POSITIVE)] * 2
    each = -(-cases * 3 // 4 // len(plan))
    for turn, (operation, mode) in enumerate(plan):
        try:
            _ask_many(operation, mode, each, number + turn, url, session, seen)
        except Unsatisfiable:  # nothing can be wrong with a request that has no parameters
            _ask_many(operation, GenerationMode.POSITIVE, 1, number, url, session, seen)
    for body in own_bodies(cases - seen.total(), number):
        answer = session.patch(url + PATCH, data=body, headers={"Content-Type": "application/json"}, timeout=30)
        assert answer.status_code in (200, 413, 422), (answer.status_code, body[:200])
        seen[answer.status_code] += 1
    return seen


def _ask_many(operation, mode, count, number, url, session, seen):
    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def ask(case):
        if case.path_parameters and mode is GenerationMode.POSITIVE:
            case.path_parameters = {"vehicle": "car-7", "sensor": "roof"}
        answer = case.call(base_url=url, session=session, timeout=30)
        seen[answer.status_code] += 1
        assert answer.status_code not in (500, 502, 504), answer.text
        case.validate_response(answer, checks=CHECKS)

    ask()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given_words = parser.parse_args()
    logging.basicConfig(level=logging.ERROR)
    with TemporaryDirectory() as folder, serving(Path(folder)) as (url, vehicle):
        seen = attack(url, given_words.cases, given_words.seed)
        check_unharmed(url, vehicle)
    print(json.dumps({"requests": seen.total(), "statuses": dict(sorted(seen.items()))}))


def check_unharmed(url: str, vehicle: Publisher) -> None:
    """The server and the vehicle do what they are asked, as before."""
    answer = requests.patch(url + PATCH, json={"codec": "zstd", "max_error_m": None, "target_kbps": None}, timeout=30)
    assert answer.status_code == 200, answer.text
    assert vehicle.settings.codec == "zstd"
    assert requests.get(f"{url}/readyz", timeout=60).json() == {"zenoh": True, "store": True}
    assert "lidarcodec_stream_alive" in requests.get(f"{url}/metrics", timeout=60).text


if __name__ == "__main__":
    main()
