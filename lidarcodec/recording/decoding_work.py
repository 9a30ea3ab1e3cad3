"""DecodingWork: what the messages of a recording may decode to, measured by the size of the file.

Equal messages in a compressed chunk take twenty bytes of a file each, and a tenth of a second to decode: hours for a
file of a megabyte. A recording of ours never has as many returns for a byte, even if all its frames are the same wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from lidarcodec.budgets import DECODED_BASE, DECODED_PER_BYTE, Allowance
from lidarcodec.frame import Frame
from lidarcodec.recording.reader import RecordingReader
from lidarcodec.units import LASERS

COLUMN: Final = 2
"""What a column costs without any return, in returns."""


class DecodingWork:
    """Counts returns and columns that were decoded. One for each reading of a file, from its beginning to its end."""

    def __init__(self, reader: RecordingReader) -> None:
        self._reader = reader
        self._allowed = Allowance(DECODED_BASE, DECODED_PER_BYTE)

    def goes_on(self, width: int, frames: Sequence[Frame] | None) -> bool:
        """Whether there may be more messages after this one; if not, that is counted and said as damage.

        width: columns of the message;  frames: what it gave; None: it failed, which may come at its very end
        """
        cost = COLUMN * width + (LASERS * width if frames is None else sum(frame.points for frame in frames))
        if self._allowed.spend(cost, self._reader.size):
            return True
        self._reader.leave_out_rest(f"it decodes to more than {DECODED_PER_BYTE} returns for each of its bytes")
        return False
