"""What a user loses if these fail: boxes that lie beside the objects, and a labels file from elsewhere that harms."""

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.detection.labels import read_labels

CAMERA = """P2: 7 0 6 4 0 7 1 2 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 -0.3
"""
"""The camera looks along x of the sensor, 0.3 m in front of it."""
LINE = "3 7 Car 0 0 -1.5 1 2 3 4 1.5 1.8 4.2 {x} {y} {z} {turn}\n"
TRACKLETS = """<?xml version="1.0"?><boost_serialization><tracklets><count>1</count><item><objectType>Van</objectType>
<h>2</h><w>1.9</w><l>5</l><first_frame>4</first_frame><poses><count>2</count>
<item><tx>10</tx><ty>3</ty><tz>-1.7</tz><rz>1.5707963</rz></item>
<item><tx>9</tx><ty>3</ty><tz>-1.7</tz><rz>1.5707963</rz></item></poses></item></tracklets></boost_serialization>
"""


def written(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


def test_a_label_of_tracking_comes_into_the_frame_of_the_sensor(tmp_path):
    camera = written(tmp_path, "calib.txt", CAMERA)
    text = LINE.format(x=-2, y=1.65, z=12, turn=-np.pi / 2) + LINE.format(x=0, y=1, z=5, turn=0).replace(
        "Car", "DontCare"
    )
    labels = read_labels(written(tmp_path, "0000.txt", text), camera)
    assert list(labels) == [3]
    boxes = labels[3]
    assert (boxes.kinds, boxes.tracks) == (("car",), (7,))
    assert np.allclose(boxes.middle, [[12.3, 2.0, -1.65 + 0.75]])
    assert np.allclose(boxes.axes[0], np.eye(3), atol=1e-9)  # it drives away from the camera
    assert boxes.size.tolist() == [[4.2, 1.8, 1.5]]


def test_tracklets_stand_where_they_are_said_to_stand(tmp_path):
    labels = read_labels(written(tmp_path, "tracklet_labels.xml", TRACKLETS))
    assert sorted(labels) == [4, 5]
    assert np.allclose(labels[5].middle, [[9, 3, -0.7]])
    assert np.allclose(labels[5].axes[0, 0], [0, 1, 0], atol=1e-6)
    assert labels[5].kinds == ("van",)


@pytest.mark.parametrize(
    "line",
    ["", "no label\n", LINE.format(x="nan", y=0, z=1, turn=0), LINE.format(x=1e9, y=0, z=1, turn=0), "3 7 Car 0 0\n",
     LINE.format(x=1, y=0, z=1, turn=0).replace("4.2", "-4.2"),
     LINE.format(x=1, y=0, z=1, turn=0).replace("3 7", "9" * 30 + " 7", 1),
     "\x00\xff" * 40],
)  # fmt: skip
def test_what_is_no_label_is_refused(tmp_path, line):
    camera = written(tmp_path, "calib.txt", CAMERA)
    with pytest.raises(SourceError, match=r"labels\.txt"):
        read_labels(written(tmp_path, "labels.txt", line), camera)


@pytest.mark.parametrize(
    ("old", "new"),
    [("<?xml", '<!DOCTYPE b [<!ENTITY a "ha">]><!--'), ("<l>5</l>", ""), ("<l>5</l>", "<l>inf</l>"),
     ("<tx>10", "<tx>1e99"), ("</poses>", ""), ("<first_frame>4", "<first_frame>ten"),
     ("<objectType>Van", "<objectType>Misc")],
)  # fmt: skip
def test_damaged_tracklets_are_refused(tmp_path, old, new):
    with pytest.raises(SourceError, match=r"labels\.xml"):
        read_labels(written(tmp_path, "labels.xml", TRACKLETS.replace(old, new, 1)))


@pytest.mark.parametrize(
    "text", ["", "R0_rect: 1 0 0\n", CAMERA.replace("-0.3", "nan"), CAMERA.replace("0 -1 0", "0 -2 0")]
)
def test_what_is_no_camera_is_refused(tmp_path, text):
    labels = written(tmp_path, "0.txt", LINE.format(x=0, y=1, z=5, turn=0))
    with pytest.raises(SourceError, match="camera"):
        read_labels(labels, written(tmp_path, "calib.txt", text))


def test_a_missing_camera_and_a_missing_file_are_named(tmp_path):
    with pytest.raises(SettingsError, match="--camera"):
        read_labels(written(tmp_path, "0.txt", LINE))
    with pytest.raises(SourceError, match=r"none\.txt"):
        read_labels(tmp_path / "none.txt", tmp_path)
