"""An operator changes codec and bitrate of a vehicle that drives, and back: nobody loses a frame by it.

A vehicle in a process of its own sends a real drive at 10 Hz; this process receives and decodes every frame, and asks.
"""

from __future__ import annotations

import json
import time
from itertools import pairwise

import pytest

from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.codecs import table
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import unpack
from tests.apps.test_processes import End
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytestmark = [pytest.mark.timeout(240), pytest.mark.data]

CHANGES = (
    {"codec": "jxl", "target_kbps": 4000, "intensity": "off"},
    {"codec": "jpeg", "target_kbps": 3000},
    {"codec": "h264", "target_kbps": 1200, "key_interval": 20},
    {"codec": "jpeg-layered", "target_kbps": 2500},
    {"codec": "h264-log", "target_kbps": None, "intensity": "levels=16"},
    {"codec": "zstd", "target_kbps": 6000, "intensity": "off", "framing": "revolution"},
    {"codec": "pcodec", "target_kbps": "auto", "framing": "packets"},
    {"codec": "pcodec", "target_kbps": None, "max_error_m": 0.0, "intensity": "lossless"},
)
REFUSED = (
    {"codec": "h265"},
    {"codec": "raw", "target_kbps": 3000},
    {"codec": "jxl", "codec_settings": {"quality": 500}, "intensity": "lossless"},
    {"target_kbps": 2000, "max_error_m": -1},
)
KEYS = StreamKeys()


class Viewer:
    """Receives every frame; what came, in order."""

    def __init__(self, port: int) -> None:
        self.decoded: list[int] = []
        self.messages: list[tuple[float, int, int, bool]] = []  # when, first frame, codec, key
        self.sizes: list[tuple[int, int, int]] = []  # codec, frames, bytes
        self.receiver = Receiver(
            KEYS,
            "viewer",
            lambda frame: self.decoded.append(frame.index),
            self._message,
            lambda: None,
            endpoints=Endpoints.of(loopback_port=port),
        )

    def _message(self, data: bytes) -> None:
        message = unpack(data)
        self.messages.append((time.monotonic(), message.frame_index, message.codec, message.key))
        self.sizes.append((message.codec, message.frame_count, len(data)))

    def keeps_to(self, codec: int, kbps: float) -> bool:
        """Whether a codec kept to a bitrate since its first message: the frames that came are not too small for it, and
        not too large in the time that they took, which is longer where some were left out."""

        def of_it() -> list[tuple[int, int, int]]:  # index, frames, bytes
            both = zip(list(self.messages), list(self.sizes), strict=False)
            return [(index, frames, size) for (_, index, *_), (of, frames, size) in both if of == codec]

        assert eventually(lambda: len(of_it()) >= 6, 60)
        (first, its_frames, _), *rest = of_it()
        kbit = sum(size for *_, size in rest) * 8 / 1e3
        frames, span = sum(count for _, count, _ in rest), rest[-1][0] + rest[-1][1] - first - its_frames
        return 0.6 * kbps < kbit / (0.1 * frames) and kbit / (0.1 * span) < 1.5 * kbps

    def first_of(self, codec: int, since: float) -> tuple[float, int] | None:
        """When the first message of a codec came after a time, and its frame."""
        return next(((at, index) for at, index, of, _ in list(self.messages) if of == codec and at >= since), None)


def every_frame_is_accounted_for(decoded: list[int], status: dict) -> None:
    assert decoded == sorted(set(decoded))
    gaps = sum(later - earlier - 1 for earlier, later in pairwise(decoded))
    assert gaps <= status["replaced"] + status["flight"]["unreported"]
    ended = sum(status[name] for name in ("frames", "replaced", "no_receiver", "left_out"))
    on_the_way = status["assembled"] - ended
    assert 0 <= on_the_way <= 2, "one in the mailbox and one in the encoder when it was ended"


@pytest.mark.sweep
def test_codecs_and_bitrates_change_under_way_and_no_frame_is_lost(data_file):
    port = free_port()
    car = End("publish", loopback_port=port, source=str(data_file("kitti_sfnd_f000-049.pcap.xz")), settings={})
    viewer, transport = Viewer(port), open_transport(Endpoints.of(loopback_port=port))
    viewer.receiver.start()
    try:
        assert eventually(lambda: len(viewer.decoded) > 5, 60)

        def ask(changes: dict) -> dict:
            return json.loads(transport.ask(KEYS.control_set, json.dumps(changes).encode(), 20.0))

        def told() -> dict:
            return json.loads(transport.ask(KEYS.control_get, b"", 20.0))

        for changes in CHANGES:
            before, asked = told()["settings"], time.monotonic()
            answer = ask(changes)
            applied = answer["applied"]
            assert {name: applied[name] for name in changes} == changes
            assert told()["settings"] == applied, "what was answered is what is in force"
            codec = table.codec_id(changes["codec"])
            if changes["codec"] != before["codec"]:
                assert answer["key"]
                assert eventually(lambda codec=codec, asked=asked: viewer.first_of(codec, asked))
                at, index = viewer.first_of(codec, asked)
                if "framing" not in changes:  # else the frames that were assembled before have the new codec already
                    assert index >= answer["first_frame"]
                print(f"{changes['codec']:13s} answered and first message after {at - asked:.3f} s")
            begin = max(viewer.decoded)
            assert eventually(lambda begin=begin: max(viewer.decoded) > begin + 8, 60)
            if isinstance(changes["target_kbps"], int) and changes["codec"] != "jpeg-layered":  # one group tells little
                assert viewer.keeps_to(codec, changes["target_kbps"])
        in_force = told()["settings"]
        answers = [ask(changes) for changes in REFUSED]
        assert all(answer["error"] and answer["field"] for answer in answers)
        assert told()["settings"] == in_force, "a refused change changes nothing"
        begin = max(viewer.decoded)
        assert eventually(lambda: max(viewer.decoded) > begin + 3, 60)
    finally:
        car.end()
        assert eventually(lambda: not viewer.receiver.alive)
        viewer.receiver.close()
        transport.close()
    status = car.status
    # what was sent was decoded, in order, and every gap was a frame that gave way before it was encoded
    assert viewer.receiver.errors == {}
    assert status["errors"] == {}
    assert status["messages"] - len(viewer.messages) <= 1 + status["flight"]["unreported"]
    every_frame_is_accounted_for(viewer.decoded, status)
    codecs = [codec for *_, codec, _ in viewer.messages]
    turns = [codec for earlier, codec in pairwise([0, *codecs]) if codec != earlier]
    names = ["pcodec", *(changes["codec"] for changes in CHANGES)]
    assert [table.codec_name(codec) for codec in turns] == [a for a, b in pairwise([*names, ""]) if a != b]
    changed = [later for earlier, later in pairwise(viewer.messages) if earlier[2] != later[2]]
    assert all(key for *_, key in changed), "whoever joins at the change can decode"
