"""What Prometheus is told: it wakes somebody at night, so it has to be right, and its memory has to hold it."""

from __future__ import annotations

import json
import re

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.apps.timings import Timings
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet.fleet import Fleet
from lidarcodec_server.metrics.gate import GateMetrics
from lidarcodec_server.metrics.metrics import Metrics
from lidarcodec_server.metrics.spending import gauges_of
from lidarcodec_server.metrics.totals import MAX_SENDERS, Totals
from tests.server.conftest import until

CAR = {"vehicle": "car-7", "sensor": "roof"}


def value(text, name, **labels):
    """A sample's value; None where there is none."""
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            if sample.name == name and labels.items() <= sample.labels.items():
                return sample.value
    return None


async def test_everything_of_a_stream_is_told_and_goes_on_through_a_restart(serving, vehicle, network):
    car = vehicle()
    async with serving() as client:

        async def text_with(name, least, **labels):
            async def enough():
                text = (await client.get("/metrics")).text
                found = value(text, name, **CAR, **labels)
                return found is not None and found >= least and text

            return await until(enough)

        with LiveStream("car-7/roof", transport=network.transport()):
            text = await text_with("lidarcodec_latency_seconds_count", 0)
            text = await text_with("lidarcodec_decode_seconds_count", 5)
            assert value(text, "lidarcodec_stream_alive", **CAR) == 1
            assert value(text, "lidarcodec_stream_codec", codec="pcodec", **CAR) == 1
            for name in ("encode", "put", "decode"):
                count = value(text, f"lidarcodec_{name}_seconds_count", **CAR)
                assert value(text, f"lidarcodec_{name}_seconds_bucket", le="+Inf", **CAR) == count > 0
                assert 0 < value(text, f"lidarcodec_{name}_seconds_sum", **CAR) < 60 * count
            frames = value(text, "lidarcodec_frames_total", **CAR)
            assert value(text, "lidarcodec_bytes_total", **CAR) > 1000 * frames
            assert value(text, "lidarcodec_key_frames_total", **CAR) >= 1
            for name in ("replaced_frames", "decode_errors", "missing_frames", "encode_errors"):
                assert value(text, f"lidarcodec_{name}_total", **CAR) is not None, name
            car.stop()
            vehicle()
            text = await text_with("lidarcodec_frames_total", frames + 5)
        assert value(text, "lidarcodec_http_requests_total", route="/metrics", status="200") > 0


async def test_there_are_no_more_labels_than_routes_and_streams(serving):
    async with serving() as client:
        for number in range(50):
            await client.get(f"/nothing/{number}")
            await client.get(f"/api/v1/streams/car-{number}/roof")
            await client.request(f"M{number}", "/healthz")
        text = (await client.get("/metrics")).text
        assert not re.search(r"car-\d|nothing|M\d", text)
        assert value(text, "lidarcodec_http_requests_total", route="/api/v1/streams/{vehicle}/{sensor}") == 50
        assert value(text, "lidarcodec_http_requests_total", route="/healthz", method="other") is not None


def status(start, frames, **more):
    return {"stream_id": start, "frames": frames, **more}


def begun():
    """Totals of a stream that has sent nothing yet."""
    totals = Totals()
    totals.status(status("a", 0))
    return totals


def test_what_was_before_the_server_started_is_no_increase_of_now():
    """An error of last week, or the frames of a month, would else be told as those of this second."""
    before = {"errors": {"encode errors": 3}, "reports": {"server": {"start": 5, "decode_errors": 9}}}
    totals = Totals()
    totals.status(status("a", 1_000_000, **before))
    assert {name: totals[name] for name in ("frames", "encode errors", "received decode_errors", "restarts")} == {
        "frames": 0, "encode errors": 0, "received decode_errors": 0, "restarts": 0
    }  # fmt: skip
    totals.status(status("a", 1_000_010, **before | {"errors": {"encode errors": 4}}))
    assert (totals["frames"], totals["encode errors"], totals["received decode_errors"]) == (10, 1, 0)
    totals.status(status("b", 7))
    assert (totals["frames"], totals["restarts"]) == (17, 1)


def test_what_a_publisher_counts_in_its_first_second_is_new():
    """It may fail at once: its errors would be in no count."""
    totals = Totals()
    totals.status(status("a", 3, errors={"encode errors": 7}))
    assert (totals["frames"], totals["encode errors"], totals["restarts"]) == (3, 7, 0)


def test_a_full_disk_of_a_vehicle_and_packets_that_it_lost_are_told_to_prometheus():
    fleet, keys = Fleet(), StreamKeys("car-7", "roof")
    metrics = Metrics(fleet)
    fleet.changed(keys, alive=True)

    def told(**more):
        fleet.told(keys, json.dumps(status("a", 1, **more)).encode())
        metrics.told(keys)
        text = metrics.text().decode()
        gauges = ("recording_stopped", "past_stopped")
        counters = ("lost_packets", "kernel_drops", "queue_drops", "unrecorded_frames", "unkept_frames")
        return (
            [value(text, f"lidarcodec_stream_{name}", **CAR) for name in gauges],
            [value(text, f"lidarcodec_{name}_total", **CAR) for name in counters],
        )

    assert told(recording=None, past=None) == ([None, None], [0] * 5)
    well, full = {"stopped": None, "counts": {}}, {"stopped": "No space left on device", "counts": {"dropped": 4}}
    assert told(recording=well, past=well) == ([0, 0], [0] * 5)
    source = {"lost packets": 7, "kernel drops": 5, "queue drops": 3}
    assert told(recording=full, past=well | {"counts": {"not recorded": 2, "dropped": 6}}, source=source) == (
        [1, 0], [7, 5, 3, 4, 8]
    )  # fmt: skip
    assert told(recording=well, past=full, source=source)[0] == [0, 1]


def test_counters_never_go_down():
    totals = begun()
    for given in (status("a", 10), status("a", 12), status("b", 2), status("a", 13), status("b", 5)):
        totals.status(given)
    assert totals["frames"] == 12 + 2 + 1 + 3
    assert totals["restarts"] == 1
    reports = [{"frames": 5}, {"frames": 9}, {"frames": 1}]  # the receiver started again before the third
    for number, report in enumerate(reports):
        totals.status(status("b", 5, reports={"server": report}))
        assert totals["received frames"] == [5, 9, 10][number]


def test_two_servers_that_report_under_one_name_are_counted_once_each():
    totals = begun()
    for frames in range(1, 6):
        for start in (71, 72):
            report = {"start": start, "frames": 100 * start + frames}
            totals.status(status("a", 1, reports={"server": report}))
    assert totals["received frames"] == 7105 + 7205


def test_what_is_no_count_is_left_out():
    totals = begun()
    timings = Timings()
    timings.add(3.0)
    good = timings.summary(buckets=True)
    for frames in (True, -1, 2**64, float("nan"), "9", None, [1]):
        totals.status(status("a", frames))
    for encode in (
        None,
        5,
        [],
        {"buckets": 3},
        {"buckets": {"1": 1}},
        good | {"buckets": {**good["buckets"], "2": -1}},
    ):
        totals.status(status("a", 1, encode_ms=encode, errors="many", reports=[1]))
    totals.status({"stream_id": 5, "frames": 100})
    totals.status(
        status("a", 1, reports={"x": {"decode_buckets": [1, 2]}, "y": 5, "z": {"decode_buckets": ["1"] * 18}})
    )
    assert totals["frames"] == 1
    assert totals.histogram("encode")[0][-1] == ("+Inf", 0.0)
    assert totals.histogram("decode")[0][-1] == ("+Inf", 0.0)
    totals.status(status("a", 1, encode_ms=good))
    buckets, seconds = totals.histogram("encode")
    assert dict(buckets)["0.002"] == 0
    assert dict(buckets)["0.005"] == dict(buckets)["+Inf"] == 1
    assert seconds == 0.003


def test_memory_is_bounded_whoever_reports():
    totals = Totals()
    for number in range(1000):
        totals.status(status(f"start {number}", 1, reports={f"r{number}": {"frames": 1}}))
    assert len(totals._last) == MAX_SENDERS
    fleet = Fleet(max_streams=4)
    metrics = Metrics(fleet)
    for number in range(100):
        keys = StreamKeys(f"car-{number}", "roof")
        fleet.changed(keys, alive=True)
        fleet.told(keys, b'{"stream_id": "a", "frames": 1}')
        metrics.told(keys)
        fleet.changed(keys, alive=False)
    assert len(metrics._totals) <= 5
    assert metrics.text().count(b"lidarcodec_frames_total{") == 4


RATE = {
    "target_kbps": 800.0,
    "reached": True,
    "limited_by": "target",
    "max_error_m": 0.04,
    "intensity": "levels=8",
    "step": 4,
}


@pytest.mark.parametrize(
    ("status", "settings", "codec", "told"),
    [
        ({"rate": RATE}, StreamSettings(), "riddle",
         {"target_kbps": 800, "target_missed": 0, "bound_meters": 0.04, "kept_ratio": 0.25, "intensity_levels": 8}),
        ({"rate": RATE | {"reached": False, "limited_by": "floor"}}, None, "riddle", {"target_missed": 1}),
        ({"rate": RATE | {"reached": False, "limited_by": "codec"}}, None, "riddle", {"target_missed": 0}),
        ({"rate": RATE | {"intensity": "off"}}, None, "riddle", {"intensity_levels": 0}),
        ({"rate": {"target_kbps": 800.0, "quality": 40, "intensity": "lossless", "step": 1}}, StreamSettings(), "jpeg",
         {"target_kbps": 800, "kept_ratio": 1, "intensity_levels": 256}),
        ({"rate": None, "reduction": None}, StreamSettings(max_error_m=0.02, intensity="levels=16"), "pcodec",
         {"bound_meters": 0.02, "kept_ratio": 1, "intensity_levels": 16}),
        ({}, StreamSettings(base_error_m=0.05), "pcodec",
         {"bound_meters": 0.05, "kept_ratio": 1, "intensity_levels": 256}),
        ({}, StreamSettings(), "pcodec", {"bound_meters": 0, "kept_ratio": 1, "intensity_levels": 256}),
        ({}, StreamSettings(codec="pcodec", base_error_m=0.05), "pcodec",
         {"bound_meters": 0.05, "kept_ratio": 1, "intensity_levels": 256}),
        ({}, StreamSettings(codec="jpeg"), "jpeg", {"kept_ratio": 1, "intensity_levels": 256}),
        ({"reduction": {"name": "voxel", "returns": 100_000, "kept": 9000}}, StreamSettings(), "zstd",
         {"kept_ratio": 0.09}),
        ({"rate": RATE | {"intensity": "many", "step": 0, "max_error_m": "x"}, "reduction": 5}, None, "of tomorrow",
         {"target_kbps": 800}),
        ({"path": {"capacity_kbps": 9000.0, "sustained_kbps": 2000.0, "share": 0.65}}, None, None,
         {"path_kbps": 9000, "path_sustained_kbps": 2000}),
        ({"path": {"capacity_kbps": None, "sustained_kbps": None}}, None, None, {"kept_ratio": 1}),
    ],
)  # fmt: skip
def test_what_bits_are_spent_on_is_told_as_far_as_it_is_known(status, settings, codec, told):
    found = gauges_of(status, settings, codec)
    assert told.items() <= found.items()
    assert {name for name in found if name.startswith("path_")} == {name for name in told if name.startswith("path_")}
    if settings is not None or codec == "of tomorrow":
        assert set(found) - set(told) <= {"target_missed"} or "reduction" in status


async def test_a_target_that_cannot_be_kept_is_told_to_prometheus(serving, vehicle, network):
    vehicle(StreamSettings(codec="pcodec", target_kbps=300.0, intensity="lossless", reduction="all"))
    async with serving() as client:

        async def missed():
            text = (await client.get("/metrics")).text
            return value(text, "lidarcodec_stream_target_missed", **CAR) == 1 and text

        with LiveStream("car-7/roof", transport=network.transport()):
            text = await until(missed)
        assert value(text, "lidarcodec_stream_target_kbps", **CAR) == 300
        assert value(text, "lidarcodec_stream_kept_ratio", **CAR) == 1
        assert value(text, "lidarcodec_stream_intensity_levels", **CAR) == 256
        assert value(text, "lidarcodec_stream_bound_meters", **CAR) > 0


def test_the_gate_in_front_of_tls_is_counted_and_without_one_there_is_nothing():
    state = {"open": 2, "unfinished": 3, "barred": 1, "running": True, "sessions": 9, "failed": 8, "restarts": 0}
    registry = CollectorRegistry()
    registry.register(GateMetrics(lambda: state | {"refused": {"barred": 7}}))
    text = generate_latest(registry).decode()
    assert {"lidarcodec_gate_open 2.0", "lidarcodec_gate_running 1.0", "lidarcodec_gate_failed_total 8.0"} <= set(
        text.splitlines()
    )
    assert 'lidarcodec_gate_refused_total{cause="barred"} 7.0' in text
    assert list(GateMetrics(lambda: None).collect()) == []
