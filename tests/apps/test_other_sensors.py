"""If these fail, a vehicle with another sensor than an HDL-64E cannot be watched: its packets or points differ."""

from __future__ import annotations

import json
import logging
import random
import socket
import threading
import time
from contextlib import contextmanager

import pytest

import lidarcodec
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.pipeline import frames_of
from lidarcodec.reduction.table import example_of, names
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.test_udp_out import Driver
from tests.codecs.test_other_sensors import FILES, disturbed, opened
from tests.command_line import run, start, the_one_line
from tests.packets import payloads_in
from tests.sensors.captures import CAPTURES
from tests.sweeps import sampled, spread
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

SENSORS = ["vlp16", "vlp32c", "pandar40p", "xt32m", "OS-1-128"]


@pytest.fixture
def driver():
    one = Driver()
    yield one
    one.close()


@contextmanager
def sensor(payloads, port, host="127.0.0.1", pace_s=0.0005, *, once=False):
    """A sensor that sends these packets again and again, or once."""
    stop = threading.Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind((host, 0))
            while not stop.is_set():
                for payload in payloads:
                    sock.sendto(payload, ("127.0.0.1", port))
                    if stop.wait(pace_s):
                        return
                if once:
                    return

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.mark.data
@pytest.mark.parametrize(("name", "codec"), spread(SENSORS, ["pcodec", "predictive", "riddle"]))
def test_every_payload_of_a_capture_arrives(data_file, name, codec):
    path, network = data_file(CAPTURES[name]), MemoryNetwork()
    with (
        subscribe(newest=False, until_end=True, transport=network.transport()) as stream,
        open_source(path) as source,
        Publisher(source, lidarcodec.StreamSettings(codec=codec), rate="max", transport=network.transport()) as car,
    ):
        received = [packet.payload for frame in stream for packet in packets_of(frame)]
        assert received == payloads_in(path)
        assert car.status()["errors"] == stream.summary()["errors"] == {}
        assert car.status()["sensor_model"]["model"] == source.sensor.model != "hdl64e"


class BadLine(PacketSource):
    """A capture whose packets are cut, doubled, shuffled and mixed with others."""

    def __init__(self, name):
        sensor, packets = opened(FILES[name])
        super().__init__(sensor)
        self.sent = disturbed(packets, random.Random(name))

    def packets(self):
        yield from self.sent


@pytest.mark.data
@pytest.mark.parametrize("name", sampled(FILES, ["pandar40p"]))
@pytest.mark.parametrize("codec", sampled(["pcodec", "jxl", "riddle"], ["pcodec"]))
def test_every_payload_of_a_bad_line_arrives(name, codec):
    network, source = MemoryNetwork(), BadLine(name)
    with (
        subscribe(newest=False, until_end=True, transport=network.transport()) as stream,
        Publisher(source, lidarcodec.StreamSettings(codec=codec), rate="max", transport=network.transport()) as car,
    ):
        received = [(packet.payload, packet.position) for frame in stream for packet in packets_of(frame)]
        assert received == [(packet.payload, packet.position) for packet in source.sent]
        assert car.status()["errors"] == stream.summary()["errors"] == {}


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "codec"),
    sampled(
        [("vlp16", "jpeg"), ("pandar40p", "h264-log"), ("OS-1-128", "jpeg-layered"), ("xt32m", "jxl")],
        [("xt32m", "jxl")],
    ),
)
def test_every_return_of_a_capture_arrives_as_a_picture(data_file, name, codec):
    path, network = data_file(CAPTURES[name]), MemoryNetwork()
    if codec not in table.installed():
        pytest.skip(f"codec {codec} is not installed")
    with open_source(path) as source:
        returns = [frame.points for frame in frames_of(source.packets(), source.sensor)]
    with (
        subscribe(newest=False, until_end=True, transport=network.transport()) as stream,
        open_source(path) as source,
        Publisher(source, lidarcodec.StreamSettings(codec=codec), rate="max", transport=network.transport()) as car,
    ):
        assert [frame.points for frame in stream] == returns
        assert car.status()["errors"] == stream.summary()["errors"] == {}


@pytest.mark.data
@pytest.mark.parametrize("name", sampled(["vlp16", "pandar40p", "OS-1-128"], ["pandar40p"]))
def test_a_live_sensor_is_recognised_and_a_driver_at_the_far_end_gets_its_packets(data_file, driver, name):
    payloads = payloads_in(data_file(CAPTURES[name]))
    listening, endpoint = free_port(), f"tcp/127.0.0.1:{free_port()}"
    receiving = start("subscribe", "car/roof", "--listen", endpoint, "--json", "--udp", driver.address)
    where = f"udp://127.0.0.1:{listening}?src=127.0.0.1"
    try:
        with sensor(payloads, listening), sensor(payloads_in(data_file(CAPTURES["xt16"])), listening, "127.0.0.2"):
            sending = start("publish", where, "--vehicle", "car", "--sensor", "roof", "--connect", endpoint)
            try:
                assert eventually(lambda: len(driver.payloads) > 300)
            finally:
                sending.terminate()
                _, said = sending.communicate(timeout=60)
        assert set(driver.payloads) <= set(payloads)
        assert "refused" in said
    finally:
        receiving.terminate()
        out, complaints = receiving.communicate(timeout=60)
    assert json.loads(out)["errors"] == {}, complaints


@pytest.mark.data
def test_settings_that_such_a_sensor_cannot_have_are_refused_by_name(data_file):
    path = data_file(CAPTURES["vlp16"])
    for words in (["codec=jpeg", "max_error_m=0.1"], ["codec=pcodec", "base_error_m=0.1"]):
        told = run("publish", path, *(part for word in words for part in ("--set", word)))
        assert told.returncode == 2
        assert "bound" in the_one_line(told) or "HDL-64E" in the_one_line(told)
    network = MemoryNetwork()
    with open_source(path) as source, Publisher(source, transport=network.transport()) as car:
        with pytest.raises(SettingsError, match=r"only .*an HDL-64E"):
            car.change(base_error_m=0.1)
        assert car.settings.codec == "pcodec"
        for reduction in names():  # every reducer takes every spinning sensor
            car.change(reduction=example_of(reduction))
            assert car.settings.reduction == example_of(reduction)


@pytest.mark.data
def test_a_target_is_followed_while_the_stream_runs(data_file):
    path, network = data_file(CAPTURES["vlp16"]), MemoryNetwork()
    settings = lidarcodec.StreamSettings(codec="auto", target_kbps=300)
    with (
        subscribe(transport=network.transport()) as stream,
        open_source(path, loop=True) as source,
        Publisher(source, settings, transport=network.transport()) as car,
    ):
        frames = iter(stream)
        assert eventually(lambda: next(frames) and (car.status()["rate"] or {}).get("reachable_kbps"))
        status = car.status()
        assert status["images"]["spacing"] == 1.2
        low, high = status["rate"]["reachable_kbps"]
        assert low < 300 < high
        car.change(intensity="levels=4", reduction="random", keep_fraction=0.5, target_kbps=200)
        assert eventually(lambda: next(frames).points < 9000)
        assert car.status()["errors"] == {}


@pytest.mark.data
def test_codec_auto_becomes_one_that_takes_such_frames(data_file, caplog):
    path, network = data_file(CAPTURES["pandar40p"]), MemoryNetwork()
    settings = lidarcodec.StreamSettings(codec="auto")
    with (
        subscribe(newest=False, until_end=True, transport=network.transport()) as stream,
        open_source(path) as source,
        Publisher(source, settings, rate="max", transport=network.transport()) as car,
    ):
        assert len(list(stream)) >= 4
        assert eventually(lambda: (car.status()["codec_choice"] or {}).get("because"))
        assert car.status()["codec"] in ("riddle", "predictive", "pcodec")
        assert car.status()["errors"] == {}
    assert "could not encode" not in caplog.text


@pytest.mark.data
def test_another_model_takes_the_place_of_one_that_fell_silent(data_file, caplog):
    caplog.set_level(logging.INFO)
    vlp16, xt32m = (payloads_in(data_file(CAPTURES[name])) for name in ("vlp16", "xt32m"))
    with open_source("udp://127.0.0.1:0?wait=1&idle=10") as source:
        port, models = source.address[1], []
        packets = source.packets()
        with sensor(vlp16, port, pace_s=0.0013, once=True):  # as a sensor sends: no jump of time, no other pace
            while len(models) < 500:
                models.append((next(packets).payload in set(vlp16), source.sensor.model))
        assert source.sensor.model == "vlp16"
        end = time.monotonic() + 60
        with sensor(xt32m, port, "127.0.0.2"):
            while source.sensor.model != "xt32m" and time.monotonic() < end:
                next(packets)
        assert source.sensor.model == "xt32m"
    assert "fell silent" in caplog.text
    assert "XT32M" in caplog.text


@pytest.mark.data
@pytest.mark.parametrize(("wanted", "other"), [("vlp16", "HDL-64E S3"), ("xt16", "vlp16"), ("vlp16", "xt32m")])
def test_a_sensor_whose_model_is_given_is_not_replaced_by_a_louder_one(data_file, wanted, other):
    own, louder = payloads_in(data_file(CAPTURES[wanted])), payloads_in(data_file(CAPTURES[other]))
    with open_source(f"udp://127.0.0.1:0?model={wanted}") as source:
        port = source.address[1]
        with sensor(louder, port, "127.0.0.2", 0.00025), sensor(own, port, pace_s=0.001):
            packets, came, end = source.packets(), [], time.monotonic() + 2.0
            while time.monotonic() < end or (source.counts["strangers"] <= 1000 and time.monotonic() < end + 60):
                came.append(next(packets).payload)
        assert set(came[len(came) // 2 :]) <= set(own)
        assert source.counts["strangers"] > 1000


@pytest.mark.parametrize("name", ["xt16", "vlp16", "OS-1-128"])
def test_a_sensor_that_is_switched_on_late_loses_no_packet_and_shows_no_other_sensor(data_file, name):
    sent = payloads_in(data_file(CAPTURES[name]))
    payloads = [one for one in sent if len(one) > 48][:400]  # without an inertial unit's
    port = free_port()
    with open_source(f"udp://127.0.0.1:{port}?idle=3&wait=0.1") as source:
        assert source.sensor.is_hdl64e  # as long as nobody knows better

        def send():
            time.sleep(0.5)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                for payload in payloads:
                    sock.sendto(payload, ("127.0.0.1", port))
                    time.sleep(0.0005)

        thread = threading.Thread(target=send)
        thread.start()
        frames = list(lidarcodec.read_frames(source, framing="revolution"))
        thread.join()
    assert {frame.sensor.is_hdl64e for frame in frames} == {False}
    assert [packet.payload for frame in frames for packet in packets_of(frame)] == payloads


def test_so_few_packets_that_only_the_end_tells_their_sensor_come_out_too(data_file):
    payloads = payloads_in(data_file(CAPTURES["vlp16"]))[:5]
    port = free_port()
    with open_source(f"udp://127.0.0.1:{port}?idle=1&wait=0") as source:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for payload in payloads:
                sock.sendto(payload, ("127.0.0.1", port))
        assert [packet.payload for packet in source.packets()] == payloads
        assert source.sensor.model == "vlp16"
