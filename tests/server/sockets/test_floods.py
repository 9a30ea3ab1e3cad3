"""A client that sends frames without end costs nobody else anything, with a token or without, whatever they are."""

from __future__ import annotations

import contextlib
import signal
import socket
import time

import pytest

from lidarcodec_server.live.incoming import Frames
from lidarcodec_server.live.protocol import FRAME_RATE, PARTS, PATIENCE_S, ViewerProtocol
from tests.faults.serving import Server
from tests.server.floods import flood, longest_answer_s, sending, upgrade, ws_frame
from tests.sweeps import sampled
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

STREAM = "vehicle/lidar"
KINDS = {
    "texts": (b"", ws_frame(1, b"ack")),
    "fragments": (ws_frame(1, b"a", final=False), ws_frame(0, b"", final=False)),
    "pings": (b"", ws_frame(9)),
    "pongs": (b"", ws_frame(10)),
}
LONG_S = 1.5
"""Long for a health check, on a busy machine too; it took 1.5 to 15 s, for as long as a flood went on."""


@pytest.mark.sweep
def test_frames_before_the_socket_is_accepted_hold_up_nobody(server):
    """Nobody needs a token to ask for a socket, and to send before the answer."""
    blob = 40_000 * ws_frame(2)
    with flood(6, lambda over: sending(over, server.port, upgrade("nobody/lidar/frames"), blob)):
        assert longest_answer_s(server.port, 4.0) < LONG_S


@pytest.mark.parametrize("kind", sampled(KINDS, ["fragments"]))
@pytest.mark.sweep
def test_frames_of_a_viewer_hold_up_nobody_and_end_its_socket(server, vehicle, kind):
    first, tiny = KINDS[kind]
    before = ViewerProtocol.held.ended["flood"]
    begin, blob = upgrade(f"{STREAM}/cloud?max_points=10"), first + 20_000 * tiny
    with flood(3, lambda over: sending(over, server.port, begin, blob, wait=True)):
        assert longest_answer_s(server.port, 4.0) < LONG_S
        assert eventually(lambda: ViewerProtocol.held.ended["flood"] >= before + 3)


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (2000 * ws_frame(9), f"more than {FRAME_RATE} frames a second"),
        (600 * ws_frame(1, b"9" * 20), f"more than {FRAME_RATE} frames a second"),
        (
            ws_frame(1, b"a", final=False) + 70 * ws_frame(0, b"", final=False),
            f"a message has at most {PARTS} fragments",
        ),
    ],
)
def test_a_socket_that_is_ended_for_its_frames_is_told_why(server, vehicle, caplog, sent, reason):
    abuse = server.hub.counts["abuse"]
    with socket.create_connection(("127.0.0.1", server.port), 20) as one:
        one.sendall(upgrade(f"{STREAM}/frames"))
        got = one.recv(1024)
        one.sendall(sent)
        with contextlib.suppress(ConnectionResetError):
            while data := one.recv(65536):
                got = got[-1000:] + data
        assert (1008).to_bytes(2, "big") + reason.encode() in got
    assert eventually(lambda: server.hub.counts["abuse"] == abuse + 1)


@pytest.mark.sweep
def test_a_short_burst_is_read_more_slowly_and_forgiven(server, vehicle):
    before = ViewerProtocol.held.ended["flood"]
    with socket.create_connection(("127.0.0.1", server.port), 20) as one:
        one.sendall(upgrade(f"{STREAM}/frames"))
        got = one.recv(1024)
        for number in range(3):
            one.sendall(120 * ws_frame(9) + ws_frame(9, b"number %d" % number))
            begin = time.monotonic()
            while b"number %d" % number not in got:
                got = got[-1000:] + one.recv(65536)
            time.sleep(PATIENCE_S / 2)
        assert time.monotonic() - begin < 20
    assert ViewerProtocol.held.ended["flood"] == before


@pytest.mark.timeout(120)
@pytest.mark.sweep
def test_a_server_under_a_flood_ends_when_it_is_told_to(tmp_path):
    server = Server(tmp_path, free_port(), free_port())
    with contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        server.start()
        begin, blob = upgrade("nobody/lidar/frames"), 40_000 * ws_frame(2)
        stack.enter_context(flood(10, lambda over: sending(over, server.port, begin, blob)))
        time.sleep(2.0)
        asked = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(60) == 0
        assert time.monotonic() - asked < 20


def test_frames_are_cut_the_same_however_they_come():
    """A client may send a byte a packet, and lengths of any form."""
    sent = [ws_frame(1, b"ack"), ws_frame(9, b"x" * 125), bytes([0x82, 0xFE, 2, 0]) + b"mask" + b"y" * 512]
    sent += [bytes([0x02, 0xFF]) + (700).to_bytes(8, "big") + b"mask" + b"z" * 700, bytes([0x00, 0x81]) + b"maskq"]
    wire = b"".join(sent)
    for step in (1, 2, 7, len(wire)):
        frames, pieces = Frames(), []
        for begin in range(0, len(wire), step):
            frames.feed(wire[begin : begin + step])
            while (piece := frames.take()) is not None:
                pieces.append(piece)
        assert b"".join(piece.data for piece in pieces) == wire
        assert [piece.cost for piece in pieces if piece.cost] == [1, 1, 2, 2, 1]
        assert [piece.part for piece in pieces if piece.cost] == [False] * 4 + [True]
    assert Frames().take() is None
