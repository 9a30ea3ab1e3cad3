"""A target bitrate kept: from what frames took to the setting of the next one. Pure arithmetic on sizes and stamps."""

from lidarcodec.ratecontrol.control import RateControl

__all__ = ["RateControl"]
