"""Publisher and subscriber on a network in memory."""

from __future__ import annotations

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from tests.apps.streams import Loop

KEY = "vehicle/lidar"


def publisher(network, frames=None, settings=None, **options):
    """A publisher on the network."""
    options.setdefault("rate", 40.0)
    return Publisher(Loop(frames), settings, transport=network.end(), **options)


def live(network, **options):
    """A subscriber on the network."""
    return subscribe(KEY, transport=network.end(), **options)
