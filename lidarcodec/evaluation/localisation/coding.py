"""A drive as its receiver gets it: every frame is encoded, packed, unpacked and decoded.

The encoder applies the reducer of the stream's settings. Reducers use the motion of the car, so each frame has its
pose, with typical errors of odometry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from lidarcodec.errors import DecodeError
from lidarcodec.evaluation.localisation.drive import Drive
from lidarcodec.evaluation.localisation.reference import Reference, pose_of
from lidarcodec.evaluation.rigid import invert
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack

ODOMETRY_M: Final = 0.05
ODOMETRY_DEG: Final = 0.1
ODOMETRY_S: Final = 0.9
"""Error of wheel odometry and gyroscopes over all axes, after so long. It grows like a random walk."""
Choose = Callable[[Frame], Frame]
Show = Callable[[int, Frame], None]


@dataclass
class Received:
    """frames: the requested decoded frames, by number; a frame that was skipped has no return
    sizes: bytes of each frame's message; points: number of sent returns of each frame; sent: number of its returns
    """

    frames: dict[int, Frame] = field(default_factory=dict)
    sizes: list[int] = field(default_factory=list)
    points: list[int] = field(default_factory=list)
    sent: int = 0

    @property
    def frame_bytes(self) -> float:
        """Mean bytes of a frame, all data included."""
        return float(np.sum(self.sizes) / max(len(self.points), 1))

    @property
    def frame_points(self) -> float:
        """Mean number of sent returns of a frame."""
        return float(np.mean(self.points)) if self.points else 0.0


def with_odometry(drive: Drive, reference: Reference, seed: int) -> list[Frame]:
    """The drive's frames, each with T_world_sensor at its stamp from simulated odometry."""
    random = np.random.default_rng((seed, 3))
    before = pose = reference.at(0, (drive.frames[0].stamp_ns - int(drive.stamps_ns[0])) * 1e-9)
    frames = [drive.frames[0].with_(pose=pose)]
    for at in range(1, len(drive.frames)):
        frame = drive.frames[at]
        true = reference.at(at, (frame.stamp_ns - int(drive.stamps_ns[at])) * 1e-9)
        walked = np.sqrt(max(frame.stamp_ns - drive.frames[at - 1].stamp_ns, 0) * 1e-9 / ODOMETRY_S / 3)
        turn, step = walked * random.normal(size=(2, 3))
        pose = pose @ invert(before) @ true @ pose_of(np.radians(ODOMETRY_DEG) * turn, ODOMETRY_M * step)
        before = true
        frames.append(frame.with_(pose=pose))
    return frames


def received(
    frames: Iterable[Frame],
    settings: StreamSettings,
    wanted: Iterable[int],
    choose: Choose | None = None,
    tick: Callable[[], None] = lambda: None,
    show: Show = lambda at, frame: None,
) -> Received:
    """Encode and decode frames one after the other, and return those with a position in `wanted`.

    choose: selects the returns to send, instead of the reducer of the settings; show: called with each decoded frame
    and its position, but not for frames that were skipped
    Raises DecodeError if a codec cannot decode its own messages, SettingsError, UnknownNameError.
    """
    encoder, decoder, found = StreamEncoder(settings), StreamDecoder(), Received()
    wanted_frames, place = set(wanted), dict[int, int]()

    def take(decoded: list[Frame]) -> None:
        for frame in decoded:
            at = place.pop(frame.index)
            found.points.append(frame.points)
            show(at, frame)
            if at in wanted_frames:
                found.frames[at] = frame

    def decode(messages: Iterable[bytes]) -> None:
        for data in messages:
            found.sizes.append(len(data))
            take(decoder.decode(unpack(data)))

    for at, frame in enumerate(frames):
        place[frame.index] = at
        found.sent += frame.points
        messages = encoder.encode(frame if choose is None else choose(frame))
        if encoder.left_out:
            del place[frame.index]
            if at in wanted_frames:
                found.frames[at] = frame.with_(
                    range=np.zeros_like(frame.range), intensity=np.zeros_like(frame.intensity), keep=None, side=None
                )
        decode(map(pack, messages))
        tick()
    decode(map(pack, encoder.flush()))
    take(decoder.flush())
    if place:
        raise DecodeError(f"the decoder did not return {len(place)} frames")
    return found
