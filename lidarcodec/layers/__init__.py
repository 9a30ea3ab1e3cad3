"""Layers: a base with a bound, and refinements of its sectors up to the exact packets (docs/wire-format-layers.md).

A base is a message as any other. `RefinableFrame` codes the refinements of its frame, a message for each sector of 30
degrees. `RefinedFrame` puts any of them, in any order, on the decoded base.
"""

from lidarcodec.layers.message import Refinement, is_refinement, pack, peek_refinement, unpack
from lidarcodec.layers.refinable import RefinableFrame
from lidarcodec.layers.refined import OtherBaseError, RefinedFrame, can_be_base
from lidarcodec.layers.sectors import SECTORS

__all__ = [
    "SECTORS",
    "OtherBaseError",
    "RefinableFrame",
    "RefinedFrame",
    "Refinement",
    "can_be_base",
    "is_refinement",
    "pack",
    "peek_refinement",
    "unpack",
]
