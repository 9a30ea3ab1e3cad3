"""`info` of bags with very many messages without points, which a small file may have: it ends, and counts them."""

import time

from lidarcodec.commands.info.source import inspect_source
from lidarcodec.recording import RecordingReader, RosbagWriter
from lidarcodec.recording.rosbag import CLOUDS_TOPIC, ENCODING
from tests.point_clouds import STAMP_NS, message, velodyne

MANY = 10_000


def test_messages_without_points_cost_little_more_than_reading_them(tmp_path):
    """Each was made a frame, and a bag of 1 MB kept `info` busy for minutes."""
    path, cloud = tmp_path / "many.mcap", message(velodyne(60))
    with path.open("wb") as file, RosbagWriter(file, points_topic=CLOUDS_TOPIC) as writer:
        writer.write_message(STAMP_NS, cloud)
        for n in range(1, MANY):
            writer.write_message(STAMP_NS + n * 10**6, b"")
        writer.write_message(STAMP_NS + MANY * 10**6, cloud)
    began_s = time.process_time()
    with path.open("rb") as file:
        assert len(list(RecordingReader(file).others(ENCODING, CLOUDS_TOPIC))) == MANY + 1
    read_s = time.process_time() - began_s
    found = inspect_source(str(path), None)
    assert time.process_time() - began_s - read_s < 8 * read_s + 0.2
    assert (found["frames"], found["packets"]) == (MANY + 1, MANY + 1)
    assert found["noticed"] == {"no clouds": MANY - 1, "repeated packets": MANY - 2}
    assert found["points"] > 0
