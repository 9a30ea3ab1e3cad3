"""Ten thousand messages of somebody who means ill, on every key of a stream that runs."""

from __future__ import annotations

import json
import random
import struct
import time
from collections.abc import Callable, Iterator

from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.base import Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from tests.faults.outcome import Outcome, await_frames, ends, outage_s
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

MESSAGES = 10_000
PACE_S = 0.001
TEXTS = (
    b"", b"{}", b"[]", b"null", b'"', b"{" * 5000, b"[" * 100_000, b'{"codec": null}', b'{"codec": "mp3"}',
    b'{"max_error_m": 1e999}', b'{"max_error_m": NaN}', b'{"key_interval": -1}', b'{"framing": "packets:0"}',
    b'{"codec_settings": {"level": 10000000000000000000000}}', b'{"ping": {"a": [1, 2, {"b": null}]}}', b"\xff\xfe\x00",
    b'{"follow": "../../etc/passwd"}', b'{"target_kbps": true}', b'{"reduction": "nothing of the kind"}',
    b'{"frames": 1e308, "rtt_ms": -1}', b'{"rtt_ms": "soon", "latency_p50_ms": []}',
    json.dumps({"x" * 300: 1}).encode(),
)  # fmt: skip


def hostile(seed: int, sample: bytes) -> Iterator[bytes]:
    """Endless: mutations of a good message, random bytes, texts that are nearly right, and long nothing."""
    rng = random.Random(seed)
    while True:
        kind = rng.randrange(6)
        if kind == 0:
            yield rng.choice(TEXTS)
        elif kind == 1:
            yield rng.randbytes(rng.randrange(200))
        elif kind == 2:
            yield sample[: rng.randrange(len(sample))]
        elif kind == 3:
            yield struct.pack("<QqQ", rng.getrandbits(64), rng.getrandbits(63), rng.getrandbits(64))[
                : rng.randrange(25)
            ]
        elif kind == 4:
            changed = bytearray(sample)
            for _ in range(rng.randrange(1, 9)):
                changed[rng.randrange(min(len(changed), rng.choice((64, len(changed)))))] = rng.getrandbits(8)
            yield bytes(changed)
        else:
            yield bytes(rng.choice((1, 4096, 1 << 20, (1 << 20) + 1)) if rng.random() < 0.02 else 64)


def run(messages: int = MESSAGES) -> Outcome:
    keys, port = StreamKeys(), free_port()
    with ends() as start:
        car, office = start("publish", loopback_port=port), start("subscribe", loopback_port=port)
        await_frames(office, 5)
        before = len(car.all("status"))
        with open_transport(Endpoints(loopback_port=port)) as enemy:
            inbox = enemy.inbox(keys.frame)
            sample = inbox.receive() or b"x"
            inbox.close()
            await_frames(office, 5)
            begin_s = time.monotonic()
            refused = attack(enemy, keys, sample, messages)
            step_s = outage_s(office, begin_s)
            took_s = time.monotonic() - begin_s
        end_s = time.monotonic()
        await_frames(office, 10)
        after_s = outage_s(office, end_s)
        wrong = [] if eventually(lambda: len(car.all("status")) > before) else ["the publisher says nothing any more"]
        status = car.status
        car.end()
        office.end()
    summary = office.all("summary")[0]
    wrong += [f"{who.process.returncode} was the exit code" for who in (car, office) if who.process.returncode]
    wrong += [f"errors of the publisher: {status['errors']}"] if status["errors"] else []
    wrong += (
        [f"settings were changed to {status['settings']['codec']}"] if status["settings"]["codec"] != "pcodec" else []
    )
    seen = summary["errors"].get("decode_errors", 0)
    wrong += [] if seen else ["no bad message was counted"]
    return Outcome(
        f"{messages:,} hostile Zenoh messages in {took_s:.0f} s, on frame, arrived, report and control keys",
        step_s,
        "frames that a bad message took the place of on its way to the decoder",
        f"receiver: {seen} `decode_errors`, each kind logged once; {refused} queries were answered with the reason",
        {"note": f"afterwards {after_s} s once, because one of them claimed to be the server"},
        wrong,
    )


def attack(enemy: Transport, keys: StreamKeys, sample: bytes, messages: int) -> int:
    """Send them; how many queries were refused with a reason."""
    endless = hostile(1, sample)
    puts: list[Sender] = [
        enemy.sender(keys.frame, Priority.FRAMES),
        enemy.sender(keys.arrived("enemy"), Priority.REAL_TIME),
        enemy.sender(keys.arrived("server"), Priority.REAL_TIME),
        enemy.sender(keys.report("enemy"), Priority.STATUS),
    ]
    controls = (keys.control_set, keys.control_get, keys.control_keyframe)
    acts: list[Callable[[bytes], object]] = [put.put for put in puts]
    refused = 0
    for number in range(messages):
        data = next(endless)
        if number % 5 == 4:
            answer = enemy.ask(controls[number // 5 % 3], data, 2.0)
            refused += answer is not None and b'"error"' in answer
        else:
            acts[number % 5](data)
        time.sleep(PACE_S)
    return refused
