"""A town of a street in a file, and two ends of a network in memory."""

from __future__ import annotations

from functools import cache
from io import BytesIO

import pytest

from lidarcodec.maps.file import read_map, write_map
from lidarcodec.maps.served import tiles
from lidarcodec.transport import asking
from lidarcodec.transport.memory import MemoryNetwork
from tests.maps.towns import street


@cache
def coded(length_m, seed):
    """The bytes of a map of a street."""
    file = BytesIO()
    write_map(file, street(length_m, seed=seed, per_m2=0.3))
    return file.getvalue()


def write(path, length_m=220.0, seed=1):
    """Put a street in place of a file, in one step."""
    path.with_suffix(".new").write_bytes(coded(length_m, seed))
    path.with_suffix(".new").rename(path)
    return path


def changed(path, place):
    """Put a map in place of a file that differs in one tile only."""
    points = read_map(path)
    inside = (points.steps[:, :2] // 2500 == place).all(axis=1)
    keep = ~inside
    keep[inside.nonzero()[0][::2]] = True
    with path.with_suffix(".new").open("w+b") as file:
        write_map(file, points.taken(keep.nonzero()[0]))
    path.with_suffix(".new").rename(path)


@pytest.fixture
def town(tmp_path):
    return write(tmp_path / "town.lcmap")


@pytest.fixture
def ends():
    """Two transports on one network."""
    network = MemoryNetwork()
    with network.transport() as server, network.transport() as vehicle:
        yield server, vehicle


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(asking, "ANSWER_S", 0.5)
    monkeypatch.setattr(asking, "FIRST_WAIT_S", 0.02)
    monkeypatch.setattr(tiles, "LOOK_S", 0.1)
    monkeypatch.setattr(tiles, "LEAST_S", 0.02)
    monkeypatch.setattr(tiles, "AGAIN_S", 0.1)
