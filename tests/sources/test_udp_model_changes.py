"""If these fail, a live sensor that is replaced or set otherwise at the same address gives no points, or wrong ones."""

from __future__ import annotations

import json
import socket
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise

import pytest

from lidarcodec.sensors import find_sensor
from lidarcodec.sources import open_source
from lidarcodec.sources.udp.watch import LOOK_EVERY, MOST_IN_A_ROW, ODD_IN_A_ROW, ModelWatch
from tests.packets import payloads_in
from tests.sensors.captures import CAPTURES

METADATA = "sensors/ouster/OS-1-128_v2.3.0_1024x10.json"
NEEDED = LOOK_EVERY * ODD_IN_A_ROW


def sent(source, payloads):
    """The packets that come out when one sender sends these, and the models that they are given as."""
    came, models = [], []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sender = threading.Thread(target=lambda: send(sock, payloads, source.address[1]))
        sender.start()
        for packet in source.packets():
            came.append(packet.payload)
            models.append(source.sensor.model)
        sender.join()
    return came, models


def send(sock, payloads, port):
    for number, payload in enumerate(payloads):
        sock.sendto(payload, ("127.0.0.1", port))
        if number % 32 == 31:
            threading.Event().wait(0.01)


@pytest.mark.data
@pytest.mark.parametrize(("first", "then"), [("vlp16", "pandar40p"), ("HDL-64E S3", "vlp32c"), ("xt32m", "HDL-64E S3")])
def test_another_model_at_the_same_address_is_recognised_and_no_packet_is_lost(data_file, caplog, first, then):
    before, after = (payloads_in(data_file(CAPTURES[name])) for name in (first, then))
    payloads = before[:400] + (after * 3)[: NEEDED + 600]
    with open_source("udp://127.0.0.1:0?wait=0.3&idle=1") as source:
        came, models = sent(source, payloads)
    assert came == payloads
    changes = [models[0], *(b for a, b in pairwise(models) if a != b)]
    assert changes == [name.split()[0].replace("-", "").lower() for name in (first, then)]
    assert models.index(models[-1]) <= 400 + NEEDED + 100
    assert "the packets are now those of a" in caplog.text


@pytest.mark.data
def test_nonsense_in_between_changes_no_model_and_costs_ever_fewer_looks(data_file):
    vlp16 = payloads_in(data_file(CAPTURES["vlp16"]))
    payloads = vlp16[:300] + [bytes([number % 251]) * 1248 for number in range(NEEDED + 200)] + vlp16[300:]
    with open_source("udp://127.0.0.1:0?wait=0.3&idle=1") as source:
        came, models = sent(source, payloads)
        assert set(models) == {"vlp16"}
        assert [one for one in came if len(one) == 1206] == vlp16
    watch, looks = ModelWatch(source.sensor), 0
    for _ in range(20 * MOST_IN_A_ROW):
        if watch.push(bytes(1206)):
            looks += 1
            watch.found_the_same()
    assert looks <= 5


@contextmanager
def metadata_server(bodies):
    """What an Ouster at 127.0.0.1 tells over HTTP, one body after the other, the last again and again."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            body = bodies.pop(0) if len(bodies) > 1 else bodies[0]
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format, *args):
            pass

    try:
        server = ThreadingHTTPServer(("127.0.0.1", 80), Handler)
    except PermissionError:
        pytest.skip("port 80 of this machine needs privileges")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.data
def test_an_ouster_that_starts_anew_is_asked_for_its_metadata_again(data_file):
    packets = [one for one in payloads_in(data_file(CAPTURES["OS-1-128"])) if len(one) > 1000]
    other = [one[:4] + bytes([one[4] ^ 1]) + one[5:] for one in packets]
    payloads = packets[:100] + (other * 8)[: NEEDED + 100]
    metadata = data_file(METADATA).read_bytes()
    turned = json.loads(metadata)
    angles = turned.get("beam_intrinsics", turned)["beam_altitude_angles"]
    angles[0] += 0.25
    with (
        metadata_server([metadata, json.dumps(turned).encode()]),
        open_source("udp://127.0.0.1:0?wait=0.3&idle=1") as source,
    ):
        first = source.sensor
        came, _ = sent(source, payloads)
        assert came == payloads
        assert source.sensor.hash != first.hash
        before, after = (one.calibration["vert_correction_rad"][0] for one in (first, source.sensor))
        assert after != before


@pytest.mark.data
@pytest.mark.parametrize(
    ("first", "calibration", "then"),
    [("vlp16", "vlp16_db.xml", "HDL-64E S3"), ("OS-1-128", METADATA, "vlp32c")],
)
def test_packets_of_another_model_do_not_end_a_source_whose_calibration_was_given(
    data_file, caplog, first, calibration, then
):
    """Else who sends them from the sensor's address ends a recording, or a live stream."""
    before, after = (payloads_in(data_file(CAPTURES[name])) for name in (first, then))
    before, after = ([one for one in part if len(one) > 1000] for part in (before, after))
    long = (after * (2 + NEEDED // len(after)))[: NEEDED + 100]
    payloads = before[:100] + long + (before * (2 + NEEDED // len(before)))[: NEEDED + 100]
    with open_source("udp://127.0.0.1:0?wait=0.3&idle=1", calibration=data_file(calibration)) as source:
        came, models = sent(source, payloads)
        assert came == payloads
        assert len(set(models)) == 2
        again = find_sensor(None, data_file(calibration), before, models[0])
        assert (source.sensor.hash, source.sensor.origin) == (again.hash, "given")
    assert "so the given calibration is not used" in caplog.text
