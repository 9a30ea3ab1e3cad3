"""A client that asks a publisher without end costs others nothing: changes are counted, statuses made now and then."""

from __future__ import annotations

import json
import time

from lidarcodec.apps.publisher.desk import CHANGES_AT_ONCE, CHANGES_PER_S, STATUS_HOLDS_S
from lidarcodec.transport.keys import StreamKeys
from tests.apps.in_memory import publisher

KEYS = StreamKeys()


def test_changes_beyond_what_is_allowed_are_refused_with_a_time_and_counted(network):
    with publisher(network) as car:
        end, begin = network.end(), time.monotonic()
        asked = [{"key_interval": 1 + number % 100} for number in range(300)]
        answers = [json.loads(end.ask(KEYS.control_set, json.dumps(one).encode(), 10.0)) for one in asked]
        took_s = time.monotonic() - begin
        refused = [answer for answer in answers if "error" in answer]
        assert len(answers) - len(refused) <= CHANGES_AT_ONCE + CHANGES_PER_S * took_s + 1
        assert refused
        for answer in refused:
            assert 0.0 < answer["retry_s"] <= 1 / CHANGES_PER_S
            assert "try again in" in answer["error"]
        assert car.status()["errors"] == {"changes refused": len(refused)}
        time.sleep(2 / CHANGES_PER_S)
        assert "applied" in json.loads(end.ask(KEYS.control_set, b'{"key_interval": 7}', 10.0))
        assert car.settings.key_interval == 7


def test_the_status_is_made_up_at_most_so_often_and_settings_are_those_in_force(network, monkeypatch):
    with publisher(network) as car:
        made, status = [], car.status
        monkeypatch.setattr(car, "status", lambda: made.append(time.monotonic()) or status())
        end, begin = network.end(), time.monotonic()
        for number in range(1, 90):
            if number % 20 == 0:
                car.change(key_interval=number)
            answer = json.loads(end.ask(KEYS.control_get, b"{}", 10.0))
            assert answer["settings"]["key_interval"] == car.settings.key_interval
        took_s = time.monotonic() - begin
        assert len(made) <= took_s / STATUS_HOLDS_S + took_s + 2, "and once a second for everybody"


def test_questions_beyond_what_is_answered_are_refused_and_pings_are_not(network):
    with publisher(network) as car:
        end = network.end()
        answers = [json.loads(end.ask(KEYS.control_get, b"{}", 10.0)) for _ in range(600)]
        refused = sum("retry_s" in answer for answer in answers)
        assert refused > 0
        assert car.status()["errors"] == {"questions refused": refused}
        assert "time_ns" in json.loads(end.ask(KEYS.control_get, b'{"ping": 1}', 10.0))


def test_a_question_of_megabytes_is_not_even_read(network):
    with publisher(network) as car:
        end = network.end()
        assert end.ask(KEYS.control_set, b"[" * (2 << 20), 1.0) is None
        assert "at most 65,536 are allowed" in json.loads(end.ask(KEYS.control_set, b"[" * (1 << 19), 10.0))["error"]
        assert car.status()["errors"] == {}
