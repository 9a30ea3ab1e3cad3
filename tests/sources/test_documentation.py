"""What a user would lose here: trust in docs/sources.md, whose examples and options must be what the code does."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from lidarcodec.errors import UnknownNameError
from lidarcodec.sources import open_source
from lidarcodec.sources.table import TABLE
from tests.sources.test_contract import EXAMPLES

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sources.md"
ROWS = {
    "capture": "capture",
    "udp": "live sensor",
    "ros2": "topic of ROS 2",
    "folder": "KITTI",
    "recording": "recording",
    "rosbag": "rosbag2",
    "sim": "simulator",
}


def test_the_examples_of_the_page_run():
    assert doctest.testfile(str(PAGE), module_relative=False, raise_on_error=True).attempted > 3


@pytest.mark.parametrize("kind", TABLE)
def test_the_page_lists_every_option(tmp_path, kind):
    row = re.search(rf"^\| {ROWS[kind]} \|.*\|(.*)\|$", PAGE.read_text(), re.MULTILINE)
    assert row is not None
    with EXAMPLES[kind](tmp_path) as spec, pytest.raises(UnknownNameError) as caught:
        open_source(f"{spec.partition('?')[0]}?nonsense=1")
    assert set(re.findall(r"`(\w+)`", row[1])) == set(caught.value.known)
