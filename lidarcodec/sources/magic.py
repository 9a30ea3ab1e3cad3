"""First bytes by which kinds of files are recognised."""

from __future__ import annotations

from typing import Final

MCAP_MAGIC: Final = b"\x89MCAP"
SQLITE_MAGIC: Final = b"SQLite format 3\0"
BAG_MAGIC: Final = b"#ROSBAG V2.0\n"
"""Of a bag of ROS 1."""
