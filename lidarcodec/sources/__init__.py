"""Sources of packets: captures, live UDP, KITTI folders, recordings, the simulator. `open_source` opens any of them."""

from lidarcodec.sources.base import PacketSource, Source
from lidarcodec.sources.table import open_source

__all__ = ["PacketSource", "Source", "open_source"]
