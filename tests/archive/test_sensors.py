"""A real drive of every sensor family through `archive run` and `archive get`: the same packets come back."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from lidarcodec.sources import open_source
from tests.command_line import run

LONG_S = 1200.0
"""For the work on all drives, on a machine that is busy with other things."""

pytestmark = [pytest.mark.sweep, pytest.mark.data, pytest.mark.timeout(2 * LONG_S)]

DRIVES = {
    "hdl64e-s2": ["kitti_sfnd_f000-049.pcap.xz", "kitti_hdl64e_s2_recovered_db.xml"],
    "hdl64e-s3": ["hdl64e_s3_atwall.pcap", "hdl64e_s3_atwall_db.xml"],
    "hdl32e": ["hdl32e_monterey_first800.pcap"],
    "vlp16": ["sensors/velodyne/vlp16.pcap.xz"],
    "vlp32": ["sensors/velodyne/vlp32.pcap.xz"],
    "vls128": ["sensors/velodyne/vls128.pcap.xz"],
    "pandar40p": ["sensors/hesai/pandar_40p.pcap.xz"],
    "pandar64": ["sensors/hesai/pandar_64.pcap.xz"],
    "qt128": ["sensors/hesai/pandar_qt128.pcap.xz"],
    "xt16": ["sensors/hesai/pandar_xt16.pcap.xz"],
    "xt32m": ["sensors/hesai/pandar_xt32m.pcap.xz"],
    "os0": ["sensors/ouster/OS-0-32-U1_v2.2.0_1024x10.pcap.xz", "sensors/ouster/OS-0-32-U1_v2.2.0_1024x10.json"],
    "os1": ["sensors/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap.xz", "sensors/ouster/OS-1-128_v2.3.0_1024x10.json"],
    "os2": ["sensors/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap.xz", "sensors/ouster/OS-2-128-U1_v2.3.0_1024x10.json"],
}
BAG = "hdl64e_s3_atwall.pcap"
"""This capture is also converted to a bag of ROS 2."""


@pytest.fixture(scope="module")
def archived(tmp_path_factory):
    """Folders with the inputs and with their archive."""
    from tests.conftest import data_folder

    root = tmp_path_factory.mktemp("fleet")
    for sensor, names in DRIVES.items():
        paths = [data_folder() / name for name in names]
        if not all(path.exists() for path in paths):
            pytest.skip(f"needs {', '.join(names)} in LIDARCODEC_DATA")
        (root / "in" / "car-7" / sensor).mkdir(parents=True)
        for path in paths:
            shutil.copy2(path, root / "in" / "car-7" / sensor)
    (root / "in" / "car-7" / "bag").mkdir()
    done = run("convert", data_folder() / BAG, root / "in" / "car-7" / "bag" / "drive", "--as", "rosbag")
    assert done.returncode == 0, done.stderr
    done = run("archive", "run", root / "in", root / "out", "--seconds", "2", "--processes", "2", limit_s=LONG_S)
    assert done.returncode == 0, done.stderr
    return root


def packets(spec: Path | str) -> list[tuple[bytes, bool]]:
    with open_source(spec) as source:
        return [(packet.payload, packet.position) for packet in source.packets()]


@pytest.mark.parametrize("sensor", DRIVES)
def test_packets_come_back(archived, tmp_path, sensor):
    done = run("archive", "get", archived / "out", tmp_path / "back.pcap", "--vehicle", "car-7", "--sensor", sensor)
    assert done.returncode == 0, done.stderr
    name = Path(DRIVES[sensor][0]).name
    back = f"{tmp_path / 'back.pcap'}?position=8308"  # where written captures have position packets of every sensor
    assert packets(back) == packets(archived / "in" / "car-7" / sensor / name)


def test_packets_of_a_bag_come_back(archived, tmp_path):
    done = run("archive", "get", archived / "out", tmp_path / "back.pcap", "--vehicle", "car-7", "--sensor", "bag")
    assert done.returncode == 0, done.stderr
    assert packets(tmp_path / "back.pcap") == packets(archived / "in" / "car-7" / "bag" / "drive")


def test_every_recording_keeps_its_promises(archived):
    done = run(
        "archive", "run", archived / "in", archived / "out", "--job", "verify", "--processes", "2", limit_s=LONG_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
