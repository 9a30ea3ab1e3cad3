"""An operator thins the stream of a moving vehicle for localisation, and takes all of it again: nothing is lost."""

from __future__ import annotations

import importlib.util
import time
from itertools import pairwise
from pathlib import Path

import httpx
import pytest

from benchmarks.link_ends import looped
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from tests.server.live import running
from tests.transport.test_contract import eventually

pytestmark = [pytest.mark.timeout(240), pytest.mark.data]
STREAM = "/api/v1/streams/vehicle/lidar"


@pytest.mark.sweep
def test_a_stream_is_thinned_and_made_whole_again_by_rest(data_file, tmp_path: Path) -> None:
    decoded: list[tuple[int, int]] = []  # frame, returns
    with running(tmp_path) as server:
        source = looped(data_file("kitti_sfnd_f000-049.pcap.xz"))
        settings = StreamSettings(codec="predictive", intensity="off")
        car = Publisher(source, settings, rate=10, transport=server.network.transport())
        viewer = Receiver(
            StreamKeys(),
            "viewer",
            lambda frame: decoded.append((frame.index, frame.points)),
            lambda data: None,
            lambda: None,
            transport=server.network.transport(),
        )
        viewer.start()
        with httpx.Client(base_url=server.url, timeout=60) as client, car:
            assert server.seen()

            def patch(**changes: object) -> int:
                answer = client.patch(f"{STREAM}/settings", json=changes)
                assert answer.status_code == 200, answer.text
                assert {name: answer.json()["applied"][name] for name in changes} == changes
                return answer.json()["first_frame"]

            def status() -> dict:
                return client.get(STREAM).json()["status"] or {}

            def more_than(index: int) -> bool:
                return eventually(lambda: bool(decoded) and decoded[-1][0] > index, 60)

            assert more_than(3)
            thinned = patch(reduction="voxel-seen", keep_points=9000)
            assert more_than(thinned + 15)
            assert eventually(lambda: (status().get("reduction") or {}).get("kept") == 9000, 60)
            told = status()["reduction"]
            assert told["name"] == "voxel-seen"
            assert "localisation only" in told["note"]
            assert told["seen_before"] in (True, False)
            fewer = patch(keep_points=4500)
            assert more_than(fewer + 3)
            changes = [(0, None), (thinned, 9000), (fewer, 4500)]
            if importlib.util.find_spec("onnxruntime"):  # the extra `poconet`
                scored = patch(reduction="poconet", keep_points=9000)
                assert more_than(scored + 10)
                poconet = {"name": "poconet", "kept": 9000}.items()
                assert eventually(lambda: poconet <= (status().get("reduction") or {}).items(), 60)
                assert more_than(patch(reduction="voxel-seen") + 3)
                assert eventually(lambda: (status().get("reduction") or {}).get("name") == "voxel-seen", 60)
                changes.append((scored, 9000))
            for wrong in ({"reduction": "voxel-sen"}, {"reduction": "all"}, {"keep_fraction": 0.5}, {"keep_points": 0}):
                assert client.patch(f"{STREAM}/settings", json=wrong).status_code == 422, wrong
            whole = patch(reduction="all", keep_points=None)
            assert more_than(whole + 3)
            assert eventually(lambda: "reduction" in status() and status()["reduction"] is None, 60)
            time.sleep(0.1)
            car.interrupt()
        viewer.close()
        final = car.status()
    assert viewer.errors == {}
    assert final["errors"] == {}
    frames = [index for index, _ in decoded]
    assert frames == sorted(set(frames))
    gaps = sum(later - earlier - 1 for earlier, later in pairwise(frames))
    assert gaps <= final["replaced"] + final["flight"]["unreported"]
    for index, points in decoded:
        expected = [kept for first, kept in [*changes, (whole, None)] if first <= index][-1]
        # The last turn of the capture is cut short, each time it is played.
        assert points == expected if expected else points > 80_000 or index % 50 == 49, index
