"""Scans as KITTI publishes them, native and compensated for motion: old clouds are thinned as a live sensor's."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from lidarcodec import api
from lidarcodec.frame import Frame
from lidarcodec.reduction import make_reducer, names, reduction
from lidarcodec.settings import StreamSettings
from tests.contracts.reducer import settings_of

pytestmark = pytest.mark.data
ODOMETRY = [f"kitti_odometry_00_{index:06d}.bin.xz" for index in (0, 1, 2)]
RAW = ["kitti_sfnd_f000.bin.xz", "kitti_sfnd_f024.bin.xz"]


def scans_of(paths: list[str], data_file, calibration: str | None) -> Iterator[Frame]:
    given = data_file(calibration) if calibration else None
    for index, path in enumerate(paths):
        kind = "raw" if calibration else "odometry"
        for frame in api.read_frames(f"{data_file(path)}?kind={kind}", calibration=given):
            if frame.points > 50_000:  # what is left over of a packet is a frame of its own
                yield frame.with_(index=index, stamp_ns=frame.stamp_ns + index * 103_000_000)


@pytest.mark.parametrize(
    ("files", "calibration"),
    [(ODOMETRY, None), pytest.param(RAW, "kitti_hdl64e_s2_recovered.yaml", marks=pytest.mark.sweep)],
)
def test_the_budget_is_kept_of_published_scans(files: list[str], calibration: str | None, data_file) -> None:
    scans = list(scans_of(files, data_file, calibration))
    assert len(scans) == len(files)
    for name in names():
        settings: StreamSettings = settings_of(name, keep_points=9000)
        reducer = make_reducer(settings)
        for scan in scans:
            reduced = reducer.reduce(scan)
            assert not (reduced.valid & ~scan.valid).any()
            if reduction(name).budgeted:
                assert reduced.valid.sum() == 9000, name
