"""Functions for offline work: read frames of a source, encode, decode. For live streams use `subscribe`.

>>> import lidarcodec
>>> frames = lidarcodec.read_frames("sim:city?frames=2")
>>> messages = lidarcodec.encode(frames, codec="pcodec", max_error_m=0.01)
>>> for frame in lidarcodec.decode(messages):
...     cloud = frame.cloud()
...     print(frame.index, frame.range.shape, cloud.dtype.names[:3])
0 (64, 2154) ('x', 'y', 'z')
1 (64, 2154) ('x', 'y', 'z')
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Unpack

from lidarcodec.frame import Frame, several
from lidarcodec.layers import RefinedFrame, can_be_base, is_refinement
from lidarcodec.layers import unpack as unpack_refinement
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, check_offline, frames_of
from lidarcodec.settings import SettingChanges, StreamSettings, settings_from
from lidarcodec.sources import open_source
from lidarcodec.sources.base import Source
from lidarcodec.sources.posed import with_poses
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.wire import pack, unpack


def read_frames(
    source: Source | str | Path, framing: str = "revolution", *, calibration: str | Path | None = None
) -> Iterator[Frame]:
    """Frames of a source. A path or URL is opened with `open_source`, and closed at the end; a warning (logging) then
    says what could not be read. Of a source that you opened, `counts` has it.

    framing: as of StreamSettings. With `revolution` the first and the last frame of a capture may be parts of a turn.
    Frames of a recording have the poses that its messages carry, and its mounting.
    Raises SourceError, CalibrationError or PacketError when the source cannot be read.
    """
    if isinstance(source, str | Path):
        with open_source(source, calibration=calibration) as opened:
            yield from read_frames(opened, framing)
            say_unkept(str(source), opened.counts)
        return
    cut = frames_of(source.packets(), source.sensor, framing, current=lambda: source.sensor)
    yield from with_poses(cut, getattr(source, "carried", None), getattr(source, "mount", None))


def encode(
    frames: Iterable[Frame], settings: StreamSettings | None = None, **changes: Unpack[SettingChanges]
) -> Iterator[bytes]:
    """Encoded messages of frames as bytes. changes: fields of StreamSettings, applied on top of `settings`. With
    `base_error_m` the refinements of a frame follow its message.

    Raises SettingsError or UnknownNameError when a setting is not allowed, before the first frame is read.
    """
    several(frames, "encode", "frames")
    chosen = settings.changed(**changes) if settings else settings_from(dict(changes))
    encoder = StreamEncoder(check_offline(chosen))

    def messages() -> Iterator[bytes]:
        for frame in frames:
            yield from map(pack, encoder.encode(frame))
            if (refinable := encoder.refinable) is not None:
                yield from map(refinable.code, refinable.sectors)
        yield from map(pack, encoder.flush())

    return messages()


def decode(messages: Iterable[bytes], *, layered: bool = False) -> Iterator[Frame]:
    """Decoded frames of messages. Refinements among them are left out.

    layered: take refinements, too; they follow the message of their frame, which is given when the next message comes
    Raises DecodeError at the first message that cannot be decoded. To continue after errors use a StreamDecoder.
    """
    several(messages, "decode", "messages")
    decoder = StreamDecoder()
    refined: RefinedFrame | None = None
    for data in messages:
        if is_refinement(data):
            if refined is not None:
                refined.add(unpack_refinement(data))
            continue
        if refined is not None:
            yield refined.frame()
            refined = None
        message = unpack(data)
        frames = decoder.decode(message)
        if layered and can_be_base(message):
            refined = RefinedFrame(frames[0], message)
        else:
            yield from frames
    if refined is not None:
        yield refined.frame()
    yield from decoder.flush()
