"""Maps for other programs lie where they are, however far from zero, or are refused."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.maps.export import export
from lidarcodec.maps.points import MapFrame, MapPoints

NORTH = 5_427_629.217


def points_at(*places):
    """A map of points on the y axis, in millimetres."""
    steps = np.zeros((len(places), 3), np.int64)
    steps[:, 1] = np.rint(np.array(places) * 1000)
    return MapPoints(0.001, steps)


def test_a_map_whose_poses_were_in_utm_is_exported_to_the_millimetre(tmp_path):
    """Without --origin it counts as local, and PCD had northings in steps of half a metre."""
    for begin, width in ((0.0, 4), (NORTH, 8)):
        path = tmp_path / f"{width}.pcd"
        export(points_at(begin, begin + 0.123), path, ".pcd")
        data = path.read_bytes()
        assert f"SIZE {width} {width} {width}\n".encode() in data
        rows = np.frombuffer(data[data.index(b"DATA binary\n") + 12 :], f"<f{width}").reshape(-1, 3)
        assert np.abs(rows[:, 1] - (begin, begin + 0.123)).max() < 1e-6


def test_points_that_are_too_far_apart_for_las_are_refused(tmp_path):
    """Poses that begin at zero and go on in UTM: places went round, and the points lay anywhere."""
    laspy = pytest.importorskip("laspy")
    path = tmp_path / "map.las"
    with pytest.raises(SettingsError, match="too far apart"):
        export(points_at(0.0, NORTH), path, ".las")
    assert not path.exists()
    export(points_at(NORTH, NORTH + 2000), path, ".las")
    assert np.abs(laspy.read(path).y - (NORTH, NORTH + 2000)).max() < 1e-3


@pytest.mark.parametrize(("south", "code", "northing"), [(False, "32632", "0"), (True, "32732", "10000000")])
def test_a_map_in_utm_says_in_las_in_which_zone_it_is(tmp_path, south, code, northing):
    """Else a program for maps asks where the points are, or draws them elsewhere."""
    laspy = pytest.importorskip("laspy")
    path, local = tmp_path / "map.las", tmp_path / "local.las"
    points = points_at(NORTH, NORTH + 2)
    export(replace(points, frame=MapFrame(32, south)), path, ".las")
    export(points, local, ".las")
    las = laspy.read(path)
    assert las.header.global_encoding.wkt
    [found] = las.header.vlrs.get("WktCoordinateSystemVlr")
    assert found.string.startswith(f'PROJCS["WGS 84 / UTM zone 32{"S" if south else "N"}",GEOGCS["WGS 84",')
    assert found.string.endswith(f'AUTHORITY["EPSG","{code}"]]')
    assert 'PARAMETER["central_meridian",9],' in found.string
    assert f'PARAMETER["false_northing",{northing}],' in found.string
    assert found.string.count("[") == found.string.count("]")
    assert laspy.read(local).header.vlrs.get("WktCoordinateSystemVlr") == []
