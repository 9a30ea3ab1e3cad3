"""Files that are made to be dear, one or several of each kind of `BUDGETS`, and how each is opened."""

import bz2
import gzip
import io
import lzma
import pickle
import sqlite3
import struct
import zipfile
from importlib.util import find_spec

import lz4.frame
import numpy as np
import zstandard

from lidarcodec._native import crc32c
from lidarcodec.commands.certs.command import _read as read_deployment
from lidarcodec.commands.publish.config import read as read_config
from lidarcodec.entropy.varint import put_varint
from lidarcodec.evaluation.detection.detector.network import read_network
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps.file import HEAD, HEAD_BYTES, MAGIC, read_map
from lidarcodec.maps.select.point_net import read_point_net
from lidarcodec.network.weight_file import read_weights
from lidarcodec.sensors import read_calibration
from lidarcodec.sources import open_source
from lidarcodec.sources.kitti.points import find_scans, read_points
from lidarcodec.sources.poses import read_poses
from lidarcodec.training.annotation_folder import AnnotationFolder
from lidarcodec.transport.zenoh_opening import options_in
from lidarcodec.untrusted.npz import read_npy
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.listening import check_tls
from lidarcodec_server.store.passwords import with_password

PCAP = bytes.fromhex("d4c3b2a1020004000000000000000000ffff000001000000")
PCAPNG = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
MIB = 1 << 20
DATABASE = "postgresql://lidarcodec@localhost/lidarcodec"


def empty_records(folder):
    """Two million records of no byte, in 6 kB."""
    path = folder / "records.pcap.xz"
    block = struct.pack("<IIII", 1, 1, 0, 0) * 65536
    with lzma.open(path, "wb", preset=0) as file:
        file.write(PCAP)
        for _ in range(40):
            file.write(block)
    return path


def many_points(folder, count):
    """A map whose first tile says that it has so many points, in 1 MiB of zeros; all checksums are right."""
    tile = bytearray()
    for number in (0, 0, 0, count, 8, 10, 3, 0):
        put_varint(tile, number)
    tile += bytes(MIB - len(tile))
    checked = crc32c(bytes(tile)).to_bytes(4, "little") + bytes(tile)
    index = bytearray()
    for number in (0, 0, len(checked)):
        put_varint(index, number)
    path_at = HEAD_BYTES + len(checked)
    head = HEAD.pack(
        MAGIC, 1, 0, 0, 0, 20_000, 2500, 0, False, 0.0, 0.0, 0.0, 1.0, path_at, 0, path_at + 4, 1, count, 0,
        *[0] * 16,
    )  # fmt: skip
    parts = [head, b"", bytes(index)]
    head, path, end = (part + crc32c(part).to_bytes(4, "little") for part in parts)
    where = folder / "many.lcmap"
    where.write_bytes(head + checked + path + end)
    return where


def plain_records(folder):
    path = folder / "plain.pcap"
    path.write_bytes(PCAP + struct.pack("<IIII", 1, 1, 0, 0) * 65536)
    return path


def empty_blocks(folder):
    path = folder / "blocks.pcapng.zst"
    path.write_bytes(zstandard.compress(PCAPNG + struct.pack("<III", 0x77, 12, 12) * 8_000_000))
    return path


def zeros_gzip(folder):
    path = folder / "zeros.pcap.gz"
    record = struct.pack("<IIII", 1, 1, 200_000, 200_000) + bytes(200_000)
    path.write_bytes(gzip.compress(PCAP + record * 300))
    return path


def zeros_zstd(folder):
    """Records of zeros, thirty thousand times as long as they are on disk."""
    path = folder / "zeros.pcap.zst"
    record = struct.pack("<IIII", 1, 1, 262_144, 262_144) + bytes(262_144)
    member = zstandard.compress(record * 200)
    path.write_bytes(zstandard.compress(PCAP) + member * 60)
    return path


def scan_bomb(folder):
    path = folder / "000000.bin.xz"
    path.write_bytes(lzma.compress(bytes(20 * MIB), preset=0))
    return path


def mcap_record(opcode, data):
    return struct.pack("<BQ", opcode, len(data)) + data


def mcap_chunk(plain_bytes, name, packed):
    head = struct.pack("<QQQII", 0, 0, plain_bytes, 0, len(name)) + name
    return mcap_record(6, head + struct.pack("<Q", len(packed)) + packed)


def mcap(folder, chunk, times):
    path = folder / "bomb.mcap"
    head = b"\x89MCAP0\r\n" + mcap_record(1, struct.pack("<I", 0) * 2)
    path.write_bytes(head + chunk * times)
    return path


def mcap_of_records(folder):
    """Each chunk: three million records that say nothing."""
    plain = struct.pack("<BQ", 99, 0) * 3_000_000
    return mcap(folder, mcap_chunk(len(plain), b"zstd", zstandard.compress(plain)), 20)


def mcap_of_zeros(folder):
    plain = mcap_record(99, bytes(60 * MIB))
    return mcap(folder, mcap_chunk(len(plain), b"lz4", lz4.frame.compress(plain)), 4)


def database(folder, script, rows=()):
    path = folder / "bomb.db3"
    made = sqlite3.connect(path)
    made.executescript(script)
    made.executemany("INSERT INTO messages(id, topic_id, timestamp) VALUES (?, 1, ?)", rows)
    made.commit()
    made.close()
    return path


TOPICS = "CREATE TABLE topics(id, name TEXT, type TEXT);"
SCAN = "INSERT INTO topics VALUES (1, '/p', 'velodyne_msgs/msg/VelodyneScan');"


def computed_column(folder):
    columns = "id, topic_id, timestamp, data GENERATED ALWAYS AS (zeroblob(60000000))"
    return database(folder, f"{TOPICS} CREATE TABLE messages({columns}); {SCAN}", [(k, k) for k in range(200)])


def endless_view(folder):
    rows = (
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, '' AS name, '' AS type FROM n"
    )
    return database(folder, f"CREATE VIEW topics AS {rows}; CREATE TABLE messages(id, topic_id, timestamp, data);")


def rows_without_end(folder):
    """Rows enough that the topics of a file of this size cannot be joined with them."""
    columns = "CREATE TABLE messages(id, topic_id, timestamp, data);"
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 40000)"
    same = f"INSERT INTO topics {numbers} SELECT 1, '/p', 'velodyne_msgs/msg/VelodyneScan' FROM n;"
    return database(folder, TOPICS + columns + same, [(k, k) for k in range(20_000)])


def bag1(folder, plain, times):
    """A bag of ROS 1 of so many chunks that become `plain`."""

    def record(head, data):
        fields = b"".join(struct.pack("<I", len(one)) + one for one in head)
        return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data

    head = (b"op=\5", b"compression=bz2", b"size=" + struct.pack("<I", len(plain)))
    path = folder / "bomb.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + record(head, bz2.compress(plain)) * times)
    return path


def metadata(folder, text):
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n" + text)
    return folder


def laughs(folder):
    steps = zip("abcdefgh", "bcdefghi", strict=True)
    lists = "".join(f"  {c}: &{c} [{','.join([f'*{p}'] * 9)}]\n" for p, c in steps)
    return metadata(folder, f"  a: &a [x,x,x]\n{lists}  relative_file_paths: *i\n")


def text(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def times(folder):
    (folder / "velodyne").mkdir()
    (folder / "velodyne" / "000000.bin").write_bytes(bytes(16))
    text(folder, "times.txt", "1\n" * (9 * MIB))
    return folder


def npz(folder, shape, real, name="T_world_velo", compression=zipfile.ZIP_DEFLATED):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    path = folder / "bomb.npz"
    with zipfile.ZipFile(path, "w", compression) as archive, archive.open(name + ".npy", "w") as member:
        member.write(head.getvalue())
        for _ in range(real // MIB):
            member.write(bytes(MIB))
    return path


def npy(folder):
    path = folder / "bomb.npy"
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    return text(folder, path.name, head.getvalue())


class LongBytes:
    """Pickled as the name `bytearray` and a number."""

    def __reduce__(self):
        return bytearray, (4_400_000_000,)


def checkpoint(folder, values=None, zeros_mib=0):
    """An archive as torch writes one."""
    path = folder / "run.pt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED if zeros_mib else zipfile.ZIP_STORED) as archive:
        archive.writestr("run/data.pkl", pickle.dumps(values, protocol=2))
        archive.writestr("run/version", "3")
        with archive.open("run/data/0", "w") as member:
            for _ in range(zeros_mib):
                member.write(bytes(MIB))
    return path


def endless(folder):
    """A terabyte of zeros that takes no room on the disk."""
    path = folder / "endless"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    return path


def linked_to_zeros(folder):
    (folder / "annotation.json").symlink_to(endless(folder))
    return folder


def load_checkpoint(path):
    from lidarcodec.training.runs import load_checkpoint as load  # imports torch, which takes seconds

    load(path)


def opened(path):
    """Read as far as there is anything."""
    with open_source(path) as source:
        for _ in source.packets():
            pass


BOMBS = {
    "capture, empty records": ("capture", plain_records, opened),
    "compressed, empty records": ("compressed", empty_records, opened),
    "compressed, empty blocks": ("compressed", empty_blocks, opened),
    "compressed, zeros in gzip": ("compressed", zeros_gzip, opened),
    "compressed, zeros in zstd": ("compressed", zeros_zstd, opened),
    "scan, zeros in xz": ("scan", scan_bomb, read_points),
    "mcap, records": ("mcap", mcap_of_records, opened),
    "mcap, zeros": ("mcap", mcap_of_zeros, opened),
    "database, computed column": ("database", computed_column, opened),
    "database, endless view": ("database", endless_view, opened),
    "database, topics times messages": ("database", rows_without_end, opened),
    "rosbag1, empty records": ("rosbag1", lambda f: bag1(f, bytes(60 * MIB), 20), opened),
    "rosbag1, zeros": ("rosbag1", lambda f: bag1(f, struct.pack("<II", 0, 60 * MIB) + bytes(60 * MIB), 20), opened),
    "bag, laughs": ("bag", laughs, opened),
    "bag, fields": ("bag", lambda f: metadata(f, "  a: [" + "x," * 400_000 + "]"), opened),
    "stamps, lines": ("stamps", times, find_scans),
    "poses, long line": ("poses", lambda f: text(f, "p.txt", "1 " * (4 * MIB)), read_poses),
    "poses, no end": ("poses", endless, read_poses),
    "npz, zeros": ("npz", lambda f: npz(f, (MIB, 4, 4), 128 * MIB), read_poses),
    "npz, shape": ("npz", lambda f: npz(f, (10**12, 4, 4), 0), read_poses),
    "npz, lzma": ("npz", lambda f: npz(f, (8, 4, 4), MIB, compression=zipfile.ZIP_LZMA), read_poses),
    "arrays, shape": ("arrays", lambda f: npz(f, (10**12,), 0, "stamps_ns"), Trajectory.load),
    "arrays, npy": ("arrays", npy, read_npy),
    "calibration, laughs": (
        "calibration",
        lambda f: text(f, "a.xml", '<!DOCTYPE l [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><DB>&b;</DB>'),
        read_calibration,
    ),
    "calibration, elements": ("calibration", lambda f: text(f, "b.xml", "<a>" + "<b/>" * 250_000), read_calibration),
    "calibration, base 60": (
        "calibration",
        lambda f: text(f, "a.yaml", "a: " + ":".join(["59"] * 100_000)),
        read_calibration,
    ),
    "calibration, digits": ("calibration", lambda f: text(f, "a.yaml", "a: 0x" + "f" * 500_000), read_calibration),
    "calibration, depth": ("calibration", lambda f: text(f, "a.yaml", "a: " + "[" * 20_000), read_calibration),
    "weights, provenance": (
        "weights",
        lambda f: text(f, "a.lcrw", b"LCRW\x01" + struct.pack("<I", 2**31) + b"[" * (4 * MIB)),
        read_weights,
    ),
    "weights, arrays": ("weights", lambda f: npz(f, (MIB,), 8 * MIB, "about"), read_point_net),
    "weights, detector": ("weights", lambda f: npz(f, (MIB,), 8 * MIB, "about"), read_network),
    "map, points": ("map", lambda f: many_points(f, 500_000), read_map),
    "map, many points": ("map", lambda f: many_points(f, 4_000_000), read_map),
    "config, base 60": ("config", lambda f: text(f, "c.yaml", "vehicle: " + ":".join(["59"] * 100_000)), read_config),
    "config, no end": ("config", endless, read_config),
    "zenoh, depth": ("zenoh", lambda f: text(f, "z.json5", "[" * 400_000), options_in),
    "zenoh, not closed": ("zenoh", lambda f: text(f, "z.json5", "/*" * 400_000), options_in),
    "certificates, depth": (
        "certificates",
        lambda f: text(f, "deployment.json", "[" * 500_000),
        lambda path: read_deployment(path, None, None),
    ),
    "certificates, no end": (
        "certificates",
        endless,
        lambda path: read_deployment(path, None, None),
    ),
    "certificates, TLS without end": (
        "certificates",
        endless,
        lambda path: check_tls(ServerConfig(tls_certificate=path, tls_key=path)),
    ),
    "about, depth": (
        "about",
        lambda f: text(f, "annotation.json", "[" * 500_000).parent,
        lambda folder: AnnotationFolder(folder).about(),
    ),
    "about, no end": ("about", linked_to_zeros, lambda folder: AnnotationFolder(folder).about()),
    "secret, no end": ("secret", endless, lambda path: with_password(DATABASE, path)),
}
if find_spec("torch") is not None:
    BOMBS |= {
        "checkpoint, bytes by a number": ("checkpoint", lambda f: checkpoint(f, LongBytes()), load_checkpoint),
        "checkpoint, compressed": ("checkpoint", lambda f: checkpoint(f, zeros_mib=256), load_checkpoint),
    }
"""What -> kind of budget, what makes the file in a folder, what opens it."""
