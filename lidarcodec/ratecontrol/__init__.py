"""Rate control: sets the next frame from the sizes of earlier frames, to keep a target bitrate. Pure arithmetic."""

from lidarcodec.ratecontrol.control import RateControl

__all__ = ["RateControl"]
