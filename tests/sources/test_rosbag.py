"""What a user loses if these fail: the drives that lie in his bags, and the trust that a bad one does no harm."""

from __future__ import annotations

import io
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer

from lidarcodec.errors import LidarCodecError, PacketError, SourceError
from lidarcodec.interop import ros
from lidarcodec.interop.velodyne_scan import scan_of
from lidarcodec.packet import Packet
from lidarcodec.recording import RosbagWriter
from lidarcodec.sources import open_source
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import kind_of
from tests import packets as made
from tests.packets import packets_in
from tests.sweeps import examples

PACKETS = made.turning(90)


def bag(path: Path, frames: int = 3) -> Path:
    """An MCAP file of ours with PACKETS in scans of 30."""
    with path.open("wb") as file, RosbagWriter(file) as writer:
        for at in range(0, 30 * frames, 30):
            writer.write_scan(PACKETS[at : at + 30])
    return path


def database(path: Path, scans: list[bytes], topic: str = "/velodyne_packets") -> Path:
    """A SQLite bag, as rosbag2 lays it out."""
    with sqlite3.connect(path) as made_here:
        made_here.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
        )
        made_here.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
        made_here.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr')", (topic, ros.VELODYNE_SCAN.name))
        rows = [(1, number, data) for number, data in enumerate(scans)]
        made_here.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    made_here.close()
    return path


def scans() -> list[bytes]:
    return [scan_of(PACKETS[at : at + 30], "velodyne") for at in range(0, 90, 30)]


@pytest.mark.parametrize(("storage", "compressed"), [("MCAP", False), ("SQLITE3", False), ("SQLITE3", True)])
def test_a_bag_of_a_public_package_gives_the_very_packets(tmp_path, storage, compressed):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="written by rosbags (extra `bridges`)")
    from tests.interop.test_ros import STORE

    with rosbag2.Writer(tmp_path / "bag", version=8, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
        other = writer.add_connection("/imu", "std_msgs/msg/Header", typestore=STORE)
        scan = writer.add_connection("/lidar/packets", ros.VELODYNE_SCAN.name, typestore=STORE)
        for number, data in enumerate(scans()):
            writer.write(other, number, b"\0\1\0\0" + bytes(12))
            plain = zstandard.ZstdCompressor().compress(data) if compressed else data
            writer.write(scan, number, plain)
    with open_source(tmp_path / "bag") as source:
        assert list(source.packets()) == PACKETS
        assert list(source.packets()) == PACKETS
        assert source.start_ns == PACKETS[0].stamp_ns
        assert not source.counts
        assert source.label == "rosbag bag, /lidar/packets"


def test_what_is_a_bag_its_content_says(tmp_path):
    assert kind_of(parse(bag(tmp_path / "a.bin2"))) == "rosbag"
    assert kind_of(parse(database(tmp_path / "b.dat", scans()))) == "rosbag"
    file = io.BytesIO()
    writer = Writer(file)
    writer.start()  # without the profile of ROS, as other tools copy it
    schema = writer.register_schema(ros.VELODYNE_SCAN.name, "ros2msg", ros.VELODYNE_SCAN.definition.encode())
    channel = writer.register_channel("/p", "cdr", schema)
    for number, data in enumerate(scans()):
        writer.add_message(channel, number, data, number)
    writer.finish()
    (tmp_path / "c.mcap").write_bytes(file.getvalue())
    for name in ("a.bin2", "b.dat", "c.mcap"):
        assert list(open_source(tmp_path / name).packets()) == PACKETS


def test_one_of_several_topics_is_chosen_by_name(tmp_path):
    path = tmp_path / "two.mcap"
    with path.open("wb") as file:
        writer = RosbagWriter(file, packets_topic="/left")
        writer.write_scan(PACKETS[:30])
        writer._packets_topic = "/right"
        writer.write_scan(PACKETS[30:])
        writer.close()
    with pytest.raises(SourceError, match=r"several topics: choose one with \?topic=NAME, of /left, /right"):
        open_source(path)
    assert list(open_source(f"{path}?topic=/right").packets()) == PACKETS[30:]
    with pytest.raises(SourceError, match="on topic /top: choose one of /left, /right"):
        open_source(f"{path}?topic=/top")


def test_a_bag_without_packets_gives_its_clouds(tmp_path):
    path = tmp_path / "points.mcap"
    from tests.contracts.frames import scene

    with path.open("wb") as file, RosbagWriter(file) as writer:
        writer.write_cloud(scene(1))
    with open_source(path) as source:
        assert source.sensor.model == "pointcloud2"
        assert len(list(source.packets())) == 1
    with pytest.raises(SourceError, match=r"has no velodyne_msgs/VelodyneScan"):
        open_source(f"{path}?model=vlp16")


def test_a_bag_of_another_sensor_has_its_packets_and_its_model(tmp_path, data_file):
    path = tmp_path / "small.mcap"
    sent = made.read_plain_pcap(data_file("vlp16_sampleshort.pcap"))[:20]
    with path.open("wb") as file, RosbagWriter(file) as writer:
        writer.write_scan(sent)
    with open_source(path) as source:
        assert source.sensor.model == "vlp16"
        assert [packet.payload for packet in source.packets()] == [packet.payload for packet in sent]


def test_the_packets_of_an_unknown_sensor_are_named(tmp_path):
    path = tmp_path / "small.mcap"
    one = (b"\xff\xee" + bytes(98)) * 12 + bytes(4) + b"\x37\x23"
    with path.open("wb") as file, RosbagWriter(file) as writer:
        writer.write_scan([Packet(one, 10**18 + k) for k in range(20)])
    with pytest.raises(PacketError, match="VLP-32A or VLP-32B, which is not supported"):
        open_source(path)
    with open_source(f"{path}?model=packets") as source:
        assert sum(1 for _ in source.packets()) == 20


def test_a_folder_that_is_no_bag_or_lacks_a_file(tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [../../etc/passwd]}")
    with pytest.raises(SourceError, match="does not contain passwd"):
        open_source(tmp_path)
    for text in ("", "[", "a: b", "rosbag2_bagfile_information: []", "rosbag2_bagfile_information: {}", "x" * 2**21):
        (tmp_path / "metadata.yaml").write_text(text)
        with pytest.raises(SourceError):
            open_source(tmp_path)
    text = "rosbag2_bagfile_information: {relative_file_paths: [a.db3.zstd], compression_mode: file}"
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(SourceError, match="decompress them first"):
        open_source(tmp_path)


def test_a_description_that_would_grow_without_end_is_none(tmp_path):
    """Nine lists of ten times the list before are ten letters, and 10^10 when they are written out."""
    lists = "\n".join(f"  l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 10)}]" for n in range(1, 10))
    text = f"rosbag2_bagfile_information:\n  l0: &l0 [x]\n{lists}\n  relative_file_paths: [*l9]\n"
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(SourceError, match="anchors"):
        open_source(tmp_path)


@pytest.mark.parametrize("name", ["topics", "messages"])
def test_a_database_with_a_view_in_place_of_a_table_is_none(tmp_path, name):
    """A view may have rows without end, and a query that sorts them hears no signal."""
    path = database(tmp_path / "bag.db3", scans())
    with sqlite3.connect(path) as made_here:
        made_here.execute(f"ALTER TABLE {name} RENAME TO other")
        rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        made_here.execute(f"CREATE VIEW {name} AS {rows} SELECT other.* FROM other, n")
    made_here.close()
    with pytest.raises(SourceError, match=f"no table {name}"):
        open_source(path)


def test_a_compressed_message_that_announces_more_than_there_can_be_costs_itself_only(tmp_path):
    bomb = b"\x28\xb5\x2f\xfd\xe0" + (2**40).to_bytes(8, "little") + b"\1\0\0"
    good = scans()
    with open_source(database(tmp_path / "bag.db3", [good[0], bomb, good[1]])) as source:
        assert list(source.packets()) == PACKETS[:60]
        assert source.counts == {"bad scans": 1}


def test_the_calibration_beside_a_bag_is_found(tmp_path):
    from lidarcodec.sensors import write_db_xml

    sensor = made.sensor()
    write_db_xml(sensor, tmp_path / "drive_db.xml")
    assert open_source(bag(tmp_path / "drive.mcap")).sensor.origin == "beside"


def test_a_bad_scan_costs_itself_only(tmp_path):
    good = scans()
    path = database(tmp_path / "bag.db3", [good[0], good[1][:-5], b"", good[2]])
    with open_source(path) as source:
        assert list(source.packets()) == PACKETS[:30] + PACKETS[60:]
        assert source.counts == {"bad scans": 2}


@pytest.mark.parametrize("byte", [20_000, 5], ids=["of one scan", "with rows of the table"])
def test_what_a_damaged_page_costs_is_said(tmp_path, caplog, byte):
    """All behind it were lost without a word."""
    path = database(tmp_path / "bag.db3", scans() * 10)
    data = bytearray(path.read_bytes())
    at = data.rindex(scans()[2][byte : byte + 50]) // 4096 * 4096
    data[at : at + 4096] = b"\xff" * 4096
    path.write_bytes(data)
    with open_source(path) as source:
        found = list(source.packets())
        assert source.counts["damaged"] >= 1
    assert found == (PACKETS * 10)[: len(found)]
    assert 300 < len(found) < 900
    assert "damaged, and a part of it was skipped" in caplog.text


def test_a_damaged_index_hides_no_scan(tmp_path):
    """A wrong bit in it is no error for SQLite, which then finds fewer rows."""
    path = database(tmp_path / "bag.db3", scans() * 4)
    with closing(sqlite3.connect(path)) as made_here:
        made_here.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        (page,) = made_here.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'").fetchone()
        made_here.commit()
    data = bytearray(path.read_bytes())
    assert data[4096 * (page - 1) + 4] == 12
    data[4096 * (page - 1) + 4] = 4
    path.write_bytes(data)
    assert packets_in(path) == PACKETS * 4


def test_fewer_messages_than_the_bag_tells_of_are_said(tmp_path, caplog):
    database(tmp_path / "bag.db3", scans())
    topic = "{topic_metadata: {name: /velodyne_packets}, message_count: 5}"
    about = f"relative_file_paths: [bag.db3], topics_with_message_count: [{topic}]"
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{{about}}}")
    with open_source(tmp_path) as source:
        assert list(source.packets()) == PACKETS
        assert source.counts == {"damaged": 1}
    assert "announces 5 messages of /velodyne_packets, but 3 were found" in caplog.text


def test_messages_in_the_log_of_a_killed_recorder_are_said_to_be_missing(tmp_path, caplog):
    path = database(tmp_path / "bag.db3", scans()[:2])
    with closing(sqlite3.connect(path)) as made_here:
        made_here.execute("PRAGMA journal_mode=WAL")
        made_here.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 9, ?)", (scans()[2],))
        made_here.commit()
        for ending in ("", "-wal"):
            shutil.copy(f"{path}{ending}", tmp_path / f"killed.db3{ending}")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "link.db3").symlink_to(tmp_path / "killed.db3")
    for name in ("killed.db3", "elsewhere/link.db3"):
        with open_source(tmp_path / name) as source:
            assert list(source.packets()) == PACKETS[:60]
            assert source.counts == {"damaged": 1}
    assert "killed.db3-wal beside it was not read" in caplog.text


def test_every_prefix_gives_what_is_whole(tmp_path):
    data = bag(tmp_path / "bag.mcap").read_bytes()
    seen = set()
    for cut in range(0, len(data), len(data) // 50):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        try:
            with open_source(tmp_path / "cut.mcap") as source:
                packets = list(source.packets())
        except SourceError:
            continue
        assert packets == PACKETS[: len(packets)]
        assert len(packets) == 90 or source.counts["truncated"] == 1
        seen.add(len(packets))
    assert 90 in seen


@pytest.mark.drawn
@pytest.mark.parametrize("form", ["mcap", "db3"])
def test_mutated_bags_raise_only_our_errors(tmp_path, form):
    path = bag(tmp_path / "bag.mcap") if form == "mcap" else database(tmp_path / "bag.db3", scans())
    data = path.read_bytes()
    generator = np.random.default_rng(6)
    for number in range(examples(150)):
        mutated = bytearray(data)
        for at in generator.integers(16, len(data) if number % 2 else 4096, int(generator.integers(1, 6))):
            mutated[at] = int(generator.integers(256))
        path.write_bytes(mutated if number % 3 else mutated[: int(generator.integers(20, len(data)))])
        try:
            with open_source(path) as source:
                assert all(len(packet.payload) == 1206 for packet in source.packets())
        except LidarCodecError:
            continue
