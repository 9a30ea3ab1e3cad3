"""RefinableFrame: what an encoder keeps of a frame whose base was sent, to code refinements of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from lidarcodec._native import crc32c
from lidarcodec.codecs.base import Encoder, Layered
from lidarcodec.entropy import columns_in_turn
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.layers.intensities import encode_exact
from lidarcodec.layers.message import Refinement, pack
from lidarcodec.layers.ranges import LayerSteps, encode_refined
from lidarcodec.layers.sectors import columns_of, nearest_ahead, part_of
from lidarcodec.planes.intensity import Quality
from lidarcodec.settings import StreamSettings

_LONGEST_TURN = 65535


def checksum_of_base(base: Frame) -> int:
    """CRC-32C of what refinements need of a decoded base: ranges (64 x W u16), azimuths (2 x W u16), and what fired
    (2 x W u8), row after row."""
    found = crc32c(base.range_u16.tobytes())
    return crc32c(base.fired.tobytes(), crc32c(base.azimuth.tobytes(), found))


@dataclass(frozen=True, eq=False)
class RefinableFrame:
    """A frame that was sent as a base.

    frame: as it was measured; ranges: (64, W) uint16, as a receiver decodes the base
    stream_id: of the base's message
    base_step, step: quantiser widths in range steps, of the base and of what is reached
    intensity: whether refinements bring exact intensities, which the base has not
    """

    frame: Frame
    ranges: npt.NDArray[np.uint16]
    stream_id: int
    base_step: int
    step: int
    intensity: bool

    @property
    def sectors(self) -> list[int]:
        """The sectors to send, those that look ahead first."""
        return nearest_ahead(self.frame.azimuth)

    def code(self, sector: int) -> bytes:
        """The message of a sector; 4 ms for 10,000 returns."""
        columns = columns_of(self.frame.azimuth, sector)
        given, base = part_of(self.frame, columns), part_of(self._base, columns)
        ranges = encode_refined(given.range_u16, base, LayerSteps(self.base_step, self.step, self._turn))
        return pack(
            Refinement(
                stream_id=self.stream_id,
                frame_index=self.frame.index,
                stamp_ns=self.frame.stamp_ns,
                sector=sector,
                base=self._checksum,
                base_step=self.base_step,
                step=self.step,
                turn=self._turn,
                columns=len(columns),
                ranges=ranges,
                intensity=encode_exact(given, self._turn) if self.intensity else None,
            )
        )

    @cached_property
    def _base(self) -> Frame:
        return self.frame.with_(range=self.ranges, side=None)

    @cached_property
    def _checksum(self) -> int:
        return checksum_of_base(self._base)

    @cached_property
    def _turn(self) -> int:
        return min(columns_in_turn(self.frame.azimuth) or self.frame.width, _LONGEST_TURN)


def check_layers(encoder: Encoder, settings: StreamSettings) -> None:
    """Raise SettingsError for layers of an encoder that does not tell what a decoder gets."""
    if settings.base_error_m is not None and not isinstance(encoder, Layered):
        raise SettingsError("base_error_m needs a codec in this process: leave out isolate=always", "base_error_m")


def refinable_of(encoder: Encoder, frame: Frame, settings: StreamSettings, stream_id: int) -> RefinableFrame | None:
    """The frame that the encoder just coded as a base, to code refinements of it; None if there can be none."""
    ranges = encoder.decoded_ranges() if isinstance(encoder, Layered) else None
    if ranges is None or frame.keep is not None:  # refinements bring all returns
        return None
    exact = settings.step == 1 and not Quality.of(settings).lossless
    return RefinableFrame(frame, ranges, stream_id, settings.base.step, settings.step, exact)
