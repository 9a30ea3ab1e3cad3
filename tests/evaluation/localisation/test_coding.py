"""What a target bitrate leaves out did not arrive: a car that waits for it has nothing to find its place by."""

from __future__ import annotations

from lidarcodec import api
from lidarcodec.evaluation.localisation.coding import received
from lidarcodec.settings import StreamSettings


def test_a_frame_that_was_left_out_is_there_without_a_return():
    frames = list(api.read_frames("sim:road?seed=2&frames=12"))
    pinned = StreamSettings(codec="zstd", target_kbps=300, intensity="lossless", reduction="all")
    found = received(frames, pinned, range(len(frames)))
    empty = [at for at, frame in found.frames.items() if not frame.points]
    assert sorted(found.frames) == list(range(len(frames)))
    assert len(empty) == len(frames) - len(found.points) > 0
