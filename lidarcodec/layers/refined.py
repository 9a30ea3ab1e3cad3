"""RefinedFrame: a decoded base, and the refinements of it that came."""

from __future__ import annotations

from typing import Final

from lidarcodec.codecs.table import codec, codec_name
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.layers.intensities import decode_exact
from lidarcodec.layers.message import Refinement
from lidarcodec.layers.ranges import LayerSteps, decode_refined
from lidarcodec.layers.refinable import checksum_of_base
from lidarcodec.layers.sectors import columns_of, nearest_ahead, part_of
from lidarcodec.message import Message, SectionType
from lidarcodec.planes.intensity import FORM_FEW, MODELLED

_STEP_BYTES: Final = 2


class OtherBaseError(SectionError):
    """A refinement of another base than the one it was put on."""


class RefinedFrame:
    """Refinements in any order, each at most once, on the frame of a base.

    sectors: all that the frame has; taken: those that were refined
    coded_bytes: of the refinements in a recording, as far as its reader counted them
    """

    def __init__(self, base: Frame, message: Message) -> None:
        """base: as decoded from `message`, which holds this frame alone

        Raises SectionError for a message that is no base: of another sensor than an HDL-64E, without a bound, or
        lossless.
        """
        if not can_be_base(message):
            raise SectionError(f"frame {base.index} cannot be refined, because it was not sent with base_error_m")
        self.base: Final = base
        self._stream: Final = message.stream_id
        self._checksum: Final = checksum_of_base(base)
        self._base_step: Final = _step_of(message)
        self._exact_intensity: Final = _has_exact_intensity(message)
        self.sectors: Final = frozenset(nearest_ahead(base.azimuth))
        self.taken: set[int] = set()
        self.coded_bytes = 0
        self._ranges, self._intensity = base.range_u16.copy(), base.intensity.copy()
        self._step = 1
        self._with_intensity: set[int] = set()

    def add(self, one: Refinement) -> bool:
        """Refine the columns of a sector. False: it was there already.

        Raises OtherBaseError, or SectionError, TruncatedError for damage; nothing has changed then.
        """
        if (one.stream_id, one.frame_index, one.base) != (self._stream, self.base.index, self._checksum):
            raise OtherBaseError(
                f"a refinement of frame {one.frame_index}, sector {one.sector}, does not fit this base: it "
                "belongs to another stream or frame"
            )
        if one.sector in self.taken:
            return False
        if one.base_step != self._base_step:
            raise SectionError(f"a refinement from step {one.base_step} of a base with step {self._base_step}")
        columns = columns_of(self.base.azimuth, one.sector)
        if one.columns != len(columns):
            raise SectionError(f"a refinement of {one.columns} columns for a sector of {len(columns)}")
        base = part_of(self.base, columns)
        ranges = intensity = None
        if one.ranges is not None:
            ranges = decode_refined(one.ranges, base, LayerSteps(one.base_step, one.step, one.turn))
        if one.intensity is not None:
            intensity = decode_exact(one.intensity, base)
        if ranges is not None:
            self._ranges[:, columns] = ranges
        if intensity is not None:
            self._intensity[:, columns] = intensity
            self._with_intensity.add(one.sector)
        self._step = max(self._step, one.step)
        self.taken.add(one.sector)
        return True

    def frame(self) -> Frame:
        """The frame with what came so far; the base itself before that."""
        if not self.taken:
            return self.base
        return self.base.with_(range=self._ranges.copy(), intensity=self._intensity.copy())

    @property
    def whole(self) -> bool:
        """Whether all sectors are refined."""
        return self.taken == self.sectors

    @property
    def step(self) -> int | None:
        """The quantiser width that all sectors have reached, in range steps; None while one is missing."""
        return self._step if self.whole else None

    @property
    def exact_intensity(self) -> bool:
        """Whether all intensities are those of the sensor."""
        return self._exact_intensity or self._with_intensity == self.sectors


def can_be_base(message: Message) -> bool:
    """Whether a message can be a base: it holds one frame of an HDL-64E, with all its columns and a bound above 0."""
    first = codec_name(message.codec)
    if message.planes or message.frame_count > 1 or not codec(first).layered:
        return False
    return not message.has(SectionType.LATTICE) and _step_of(message) > 1


def _step_of(message: Message) -> int:
    """The quantiser width of its ranges; 0 where the section is too short."""
    head = message.section(SectionType.RANGE)[:_STEP_BYTES]
    return int.from_bytes(head, "little") if len(head) == _STEP_BYTES else 0


def _has_exact_intensity(message: Message) -> bool:
    forms = [section.data[:1] for section in message.sections if section.type == SectionType.INTENSITY]
    return len(forms) == 1 and bool(forms[0]) and forms[0][0] % MODELLED != FORM_FEW
