"""The two tables of contents of the system: frames to messages, and messages to frames. Pure: no clock, no I/O.

>>> from lidarcodec import StreamSettings
>>> StreamEncoder(StreamSettings(codec="zstd"), stream_id=7).settings.codec
'zstd'
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Iterator

from lidarcodec.assembly import Assembler
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings


def frames_of(packets: Iterable[Packet], sensor: SensorModel, framing: str = "packets") -> Iterator[Frame]:
    """Frames of a run of packets, the last, partial one included."""
    assembler = Assembler(sensor, framing)
    for packet in packets:
        frame = assembler.push(packet)
        if frame is not None:
            yield frame
    last = assembler.flush()
    if last is not None:
        yield last


class StreamEncoder:
    """Encodes the frames of one stream; settings, the codec among them, may change between two frames.

    Raises SettingsError or UnknownNameError when settings are not allowed; nothing has changed then.
    """

    def __init__(self, settings: StreamSettings | None = None, stream_id: int | None = None) -> None:
        self.settings = table.check(settings or StreamSettings())
        self.stream_id = secrets.randbits(64) if stream_id is None else stream_id
        self._encoder = table.make_encoder(self.settings, self.stream_id)
        self._held: list[Message] = []

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """Messages that became complete with this frame; `key` asks for one that needs nothing before it."""
        held, self._held = self._held, []
        return held + self._encoder.encode(frame, key=key)

    def apply(self, settings: StreamSettings) -> bool:
        """Use new settings from the next frame on. True: the next message will be a key frame."""
        checked = table.check(settings)
        if checked.codec == self.settings.codec:
            key = self._encoder.apply(checked)
        else:
            fresh = table.make_encoder(checked, self.stream_id)
            self._held += self._encoder.flush()
            self._encoder, key = fresh, True
        self.settings = checked
        return key

    def flush(self) -> list[Message]:
        """Messages of frames that were held back."""
        held, self._held = self._held, []
        return held + self._encoder.flush()


class StreamDecoder:
    """Decodes the messages of a stream; follows changes of codec and restarts of the publisher by the headers alone.

    Raises only errors of the DecodeError tree, and goes on with the next message.
    """

    def __init__(self) -> None:
        self._decoder: Decoder | None = None
        self._of: tuple[int, int] | None = None

    def decode(self, message: Message) -> list[Frame]:
        """Frames that became complete with this message."""
        frames: list[Frame] = []
        of = (message.codec, message.stream_id)
        if self._decoder is None or of != self._of:
            fresh = table.make_decoder(message.codec)
            frames = self.flush()
            self._decoder, self._of = fresh, of
        return frames + self._decoder.decode(message)

    def flush(self) -> list[Frame]:
        """Frames that were held back."""
        return [] if self._decoder is None else self._decoder.flush()
