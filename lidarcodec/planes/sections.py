"""What all codecs send beside ranges: mask, intensity, azimuth, side information, position packets, pose. One section
each.

A frame that was not reduced sends its no-return mask (MASK). A reduced frame sends the mask of kept returns (KEEP)
instead, because a dropped return decodes as no return.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import entropy
from lidarcodec._native import has_free_processor
from lidarcodec.entropy import IntensityMemory
from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.motion import is_rigid
from lidarcodec.planes.beside import beside
from lidarcodec.planes.intensity import Quality, encode_intensity
from lidarcodec.sensor_model import SensorModel
from lidarcodec.side import SideInfo
from lidarcodec.units import LASERS, LASERS_PER_BLOCK

Mask = npt.NDArray[np.bool_]

EncodeMask = Callable[[Frame], bytes]
"""Codes the mask of a frame in a stream whose masks refer to earlier ones."""
_POSE_BYTES = 12 * 8
WORTH_A_THREAD: Final = 12_000
"""Intensities of so many returns take a millisecond, and a thread a tenth of that."""
DecodeSide = Callable[[bytes, int], SideInfo]
"""Reads a SIDE section, of its bytes and the number of packets. Raises SectionError or TruncatedError."""


def fired_cells(fired: Mask, sensor: SensorModel) -> Mask:
    """(64, W) bool, cells whose half of the column was fired. fired: (2, W)."""
    if fired.all():
        return np.ones((LASERS, fired.shape[1]), np.bool_)
    return fired[(sensor.laser_of_ring >= LASERS_PER_BLOCK).astype(np.intp)]


def check_unfired(frame: Frame, cells: Mask) -> None:
    """Refuse a frame with a return or an intensity in a cell that was not fired: it would be lost silently.

    Raises LidarCodecError.
    """
    unfired = ~cells
    if unfired.any() and (frame.range[unfired].any() or frame.intensity[unfired].any()):
        raise LidarCodecError(f"frame {frame.index} has returns in cells that did not fire")


@contextmanager
def planes_beside(
    frame: Frame,
    quality: Quality,
    previous: Mask | None = None,
    *,
    grouped_intensity: bool = False,
    encode_mask: EncodeMask | None = None,
    memory: IntensityMemory | None = None,
) -> Iterator[Callable[[], list[Section]]]:
    """Sections of a frame beside calibration and range, by the call that the block is given. Intensities are coded
    while the block runs, which codes the ranges.

    quality: of intensity; previous: mask that the mask coder may look at
    grouped_intensity: code intensities quickly instead of small; encode_mask: of streams that code masks with memory
    memory: what intensities go on from

    Raises LidarCodecError for a frame that contradicts itself.
    """
    cells = fired_cells(frame.fired, frame.sensor)
    if not frame.fired.all():
        check_unfired(frame, cells)
    turn = entropy.columns_in_turn(frame.azimuth) if frame.fired[0].all() else None
    coded = lambda: encode_intensity(  # noqa: E731
        frame, cells, quality, turn=turn, grouped=grouped_intensity, memory=memory
    )
    with beside(coded, pays=frame.points >= WORTH_A_THREAD and has_free_processor()) as intensity:
        first = [
            Section(SectionType.AZIMUTH, entropy.encode_azimuth(frame.azimuth, frame.fired)),
            _mask_section(frame, previous, turn, encode_mask),
        ]
        last = [] if (side := frame.blocks) is None else [Section(SectionType.SIDE, entropy.encode_side(side))]
        last += position_sections(frame) + pose_sections(frame)

        def sections() -> list[Section]:
            data = intensity()
            return [*first, *([] if data is None else [Section(SectionType.INTENSITY, data)]), *last]

        yield sections


def encode_planes(frame: Frame, quality: Quality, previous: Mask | None = None) -> list[Section]:
    """The sections of `planes_beside`, at once. Raises LidarCodecError for a frame that contradicts itself."""
    with planes_beside(frame, quality, previous) as sections:
        return sections()


def _mask_section(frame: Frame, previous: Mask | None, turn: int | None, encode_mask: EncodeMask | None) -> Section:
    given, sensor, valid = frame.fired, frame.sensor, frame.valid
    if frame.keep is None and encode_mask is not None:
        return Section(SectionType.MASK, encode_mask(frame))
    if frame.keep is None:
        return Section(SectionType.MASK, entropy.encode_mask(valid, given, sensor, previous, turn=turn))
    return Section(SectionType.KEEP, entropy.encode_keep(valid, frame.azimuth, given, sensor, previous, turn=turn))


def position_sections(frame: Frame) -> list[Section]:
    """The POSITION section, or nothing where the frame has no position packets."""
    if frame.side is None or not frame.side.positions:
        return []
    return [Section(SectionType.POSITION, entropy.encode_positions(frame.side.positions))]


def pose_sections(frame: Frame) -> list[Section]:
    """The POSE section, twelve float64 in row order, or nothing."""
    if frame.pose is None:
        return []
    if not is_rigid(frame.pose):
        raise LidarCodecError(f"frame {frame.index} has a pose that is not a rigid transform")
    return [Section(SectionType.POSE, frame.pose[:3].astype("<f8").tobytes())]


def pose_of(message: Message) -> npt.NDArray[np.float64] | None:
    """(4, 4) float64 T_world_sensor of a message, without decoding it; None if it has none.

    Raises SectionError for what is no rigid transform.
    """
    if not any(section.type == SectionType.POSE for section in message.sections):
        return None
    data = message.section(SectionType.POSE)
    if len(data) != _POSE_BYTES:
        raise SectionError(f"a pose of {len(data)} bytes: it has {_POSE_BYTES}")
    pose = np.vstack([np.frombuffer(data, "<f8").reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    if not is_rigid(pose):
        raise SectionError("a pose that is no rigid transform")
    return pose


def side_of(message: Message, decode: DecodeSide = entropy.decode_side) -> SideInfo | None:
    """Side information of a message, position packets included; None if it has none.

    Raises SectionError, also where it does not describe the columns of the message; TruncatedError.
    """
    if not message.has(SectionType.SIDE):
        if message.packets or message.has(SectionType.POSITION):
            raise SectionError(f"a message of {message.packets} packets without side information")
        return None
    side = decode(message.section(SectionType.SIDE), message.packets)
    if side.columns != message.width:
        raise SectionError(f"side information of {side.columns} columns in a message of {message.width}")
    if not message.has(SectionType.POSITION):
        return side
    return replace(side, positions=entropy.decode_positions(message.section(SectionType.POSITION), message.packets))
