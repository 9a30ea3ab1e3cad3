"""What a publisher reads from receivers comes from the network: known fields are taken, the rest never hurts."""

from __future__ import annotations

import json

import pytest

from lidarcodec.apps.control import settings_with
from lidarcodec.apps.reports import STATUS_FIELDS, Arrival, pack_arrival, read_arrival, read_report, read_status
from lidarcodec.apps.timings import RECENT, Timings
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.answering import answered, object_of
from lidarcodec.untrusted.json import JsonRefusedError
from tests.apps.in_memory import publisher

NESTED = b'{"frames":' + b"[" * 300 + b"]" * 300 + b"}"
HOSTILE = [
    b"",
    b"{",
    b"[]",
    b"null",
    b"7",
    b'"x"',
    b"\xff\xfe",
    b"[" * 100_000,
    b'{"frames": NaN}',
    b"x" * 5000,
    NESTED,
]


def test_an_arrival_report_may_grow_and_is_none_without_its_checksum():
    said = Arrival(2**63, -5, 7, 2**32 - 1, 2**64 - 2)
    assert not said.has(2**63 - 1)
    assert said.has(2**63 - 2)
    assert not said.has(2**63)
    data = pack_arrival(said)
    assert len(data) == 36
    assert read_arrival(data) == read_arrival(data + b"later") == said
    assert read_arrival(data[:35]) is None


def test_known_fields_of_a_report_are_taken_and_others_left_out():
    report = read_report(json.dumps({"frames": 5, "rtt_ms": None, "fps": 9.9, "x" * 100: 1, "gaps": "many"}).encode())
    assert report["frames"] == 5
    assert report["fps"] == 9.9
    assert report["rtt_ms"] is None
    assert "gaps" not in report
    assert len(report) <= 15


@pytest.mark.parametrize("data", HOSTILE)
def test_what_is_no_report_is_none(data):
    assert read_report(data) is None


@pytest.mark.parametrize("data", HOSTILE[1:])
def test_a_query_that_is_no_object_is_answered_with_an_error(data):
    answer = json.loads(answered(lambda query: query)(data))
    if data != b'{"frames": NaN}':
        assert set(answer) == {"error", "field"}


def test_an_error_names_the_setting():
    def change(query):
        settings_with(StreamSettings(), query)
        return {}

    for query, field in (
        ({"codec": "mp3"}, "codec"),
        ({"max_error_m": -1}, "max_error_m"),
        ({"self": 1}, "self"),
        ({"framing": "packets:0"}, "framing"),
        ({"codec_settings": {"no_such": 1}}, "codec_settings"),
    ):
        answer = json.loads(answered(change)(json.dumps(query).encode()))
        assert answer["error"]
        assert str(answer["field"]).startswith(field), answer


def test_settings_change_as_a_whole_or_not_at_all():
    before = StreamSettings()
    with pytest.raises(SettingsError):
        settings_with(before, {"max_error_m": 0.1, "key_interval": 0})
    with pytest.raises(UnknownNameError):
        settings_with(before, {"codec": "none"})
    assert settings_with(before, {"max_error_m": 0.1}).max_error_m == 0.1


def test_an_empty_query_is_an_empty_object_and_a_giant_one_is_refused():
    assert object_of(b"") == {}
    with pytest.raises(SettingsError):
        object_of(b"{" + b" " * 70_000 + b"}")


def test_timings_stay_small_however_long_a_stream_runs():
    timings = Timings()
    for number in range(10 * RECENT):
        timings.add(float(number % 50))
    assert len(timings.recent()) == RECENT
    summary = timings.summary(buckets=True)
    assert summary["count"] == 10 * RECENT == sum(summary["buckets"].values())
    assert (summary["p50"], summary["max"]) == (25.0, 49.0)


@pytest.mark.parametrize(
    "data", [NESTED, b'{"fps": NaN}', b'{"fps": 1e999}', b'{"x": "' + b"A" * 70_000 + b'"}', b"[]"]
)
def test_a_status_beyond_the_limits_is_refused(data):
    with pytest.raises(JsonRefusedError):
        read_status(data)


def test_of_a_status_known_fields_are_taken_and_no_others(network):
    with publisher(network, 1) as car:
        assert set(car.status()) == STATUS_FIELDS
        told = car.status()  # once: the source runs on meanwhile
    assert read_status(json.dumps({**told, "evil": 1}).encode()) == told
