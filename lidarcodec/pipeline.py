"""The two tables of contents of the system: frames to messages, and messages to frames. Pure: no clock, no I/O.

>>> from lidarcodec import StreamSettings
>>> StreamEncoder(StreamSettings(codec="zstd"), stream_id=7).settings.codec
'zstd'
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from lidarcodec.assembly import Assembler
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder, Learning, Steered
from lidarcodec.errors import SettingsError
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.lattice import thinned
from lidarcodec.message import Message
from lidarcodec.packet import UNKEPT_POSITIONS, Packet
from lidarcodec.ratecontrol import RateControl
from lidarcodec.ratecontrol.choosing import without_auto
from lidarcodec.reduction.reducing import Reducing
from lidarcodec.reduction.table import check as check_reduction
from lidarcodec.reduction.thinning import Thinning
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.thinned_stream import LatticeNotes, in_own_columns


def frames_of(
    packets: Iterable[Packet], sensor: SensorModel, framing: str = "packets", counts: Counter[str] | None = None
) -> Iterator[Frame]:
    """Frames of a run of packets, the last, partial one included.

    counts: gets the position packets that no frame could hold
    A frame comes with the data packet behind it: position packets after the last one belong to the last frame.
    """
    assembler = Assembler(sensor, framing)
    held: Frame | None = None
    told = 0
    for packet in packets:
        if held is not None and not packet.position:
            yield held
            held = None
        held = assembler.push(packet) or held
        if counts is not None and (lost := assembler.counts[UNKEPT_POSITIONS]) > told:
            counts[UNKEPT_POSITIONS] += lost - told
            told = lost
    last = assembler.flush_onto(held)
    if counts is not None and (lost := assembler.counts[UNKEPT_POSITIONS]) > told:
        counts[UNKEPT_POSITIONS] += lost - told
    yield from last


def check(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if the codec and the reduction that they name can follow them.

    Raises UnknownNameError or SettingsError with the field and the reason.
    """
    check_reduction(table.check(without_auto(settings)))
    return settings


def check_offline(settings: StreamSettings) -> StreamSettings:
    """The settings, if they can be followed where no path is and no time passes; the codec `auto` is replaced by the
    one that it stands for there.

    Raises SettingsError.
    """
    if settings.target_kbps == AUTO:
        raise SettingsError("target_kbps=auto works only in live streams: give a number of kbit/s here", "target_kbps")
    return without_auto(settings)


class StreamEncoder:
    """Reduces and encodes the frames of one stream; settings, the codec among them, may change between two frames.

    settings: those in force; of the codec `auto` the one that shows most, however long it takes (live, the publisher
    chooses by time as well)

    make_encoder: gives the encoder of a codec, as `codecs.table` does; live, some run in a process of their own
    Raises SettingsError or UnknownNameError when settings are not allowed, MissingExtraError for a codec that is not
    installed; nothing has changed then.
    """

    def __init__(
        self,
        settings: StreamSettings | None = None,
        stream_id: int | None = None,
        make_encoder: Callable[[StreamSettings, int], Encoder] = table.make_encoder,
    ) -> None:
        self._make_encoder = make_encoder
        self.settings = without_auto(check(settings or StreamSettings()))
        self.stream_id = secrets.randbits(64) if stream_id is None else stream_id
        self._reducing, self._thinning = Reducing(self.settings), Thinning(self.settings)
        self._encoder = make_encoder(self.settings, self.stream_id)
        self._rate = self._rate_control(self.settings)
        self._steer()
        self._held: list[Message] = []
        self._lattices = LatticeNotes()
        self._last_index = -1
        self._index_again = False
        self.reduced: Frame | None = None
        """The last frame, as it was encoded: with `keep` set where it was reduced."""
        self.left_out = False
        """Whether the last frame was not encoded, because the target bitrate does not carry all frames."""

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """Messages that became complete with this frame; `key` asks for one that needs nothing before it."""
        frame = self._reducing.reduce(measured_only(frame))
        held, self._held = self._held, []
        rate, key = self._rate, key or self._index_again
        self.left_out = rate is not None and not key and rate.leaves_out(frame)
        if self.left_out:
            return held
        messages = self._coded(frame, key=key) if rate is None else self._coded_to_rate(frame, rate, key=key)
        # An index that was there before names two frames: what needs it might go on from the wrong one.
        self._index_again, self._last_index = frame.index <= self._last_index, frame.index
        return held + messages

    def _coded_to_rate(self, frame: Frame, rate: RateControl, *, key: bool) -> list[Message]:
        key_is_due = key or (rate.dear and self._encoder.apply(rate.settings))
        self._encoder.apply(rate.settings_for(frame, key=key_is_due))
        messages = self._coded(self._thinning.thin(frame, rate.step), key=key)
        if rate.spilled(frame, messages):
            self._encoder.apply(rate.settings_for(frame, key=True))
            messages = self._coded(self._thinning.thin(frame, rate.step), key=True)
        rate.sent(frame, messages)
        return messages

    def _coded(self, frame: Frame, *, key: bool) -> list[Message]:
        self.reduced = frame
        messages = self._encoder.encode(thinned(frame), key=key)
        self._lattices.goes_in(frame)
        return [self._lattices.noted(message) for message in messages]

    def apply(self, settings: StreamSettings) -> bool:
        """Use new settings from the next frame on. True: the next message will be a key frame."""
        checked = without_auto(check(settings))
        reducing, thinning = Reducing(checked, self._reducing), Thinning(checked, self._thinning)
        if checked.codec == self.settings.codec:
            key = self._encoder.apply(checked)
            if self._rate is not None and checked.target_kbps is not None:
                self._rate.apply(checked)
            else:
                self._rate = self._rate_control(checked)
        else:
            fresh = self._make_encoder(checked, self.stream_id)
            self._held += self._flushed()
            self._rate = self._rate_control(checked, self._rate)
            self._encoder, key = fresh, True
        self._steer()
        self._reducing, self._thinning, self.settings = reducing, thinning, checked
        return key

    def aim(self, target_kbps: float) -> None:
        """With `target_kbps=auto`: the bitrate to keep to from the next frame on. Nothing otherwise."""
        if self._rate is not None:
            self._rate.aim(target_kbps)

    def flush(self) -> list[Message]:
        """Messages of frames that were held back."""
        held, self._held = self._held, []
        return held + self._flushed()

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        """Have a codec that can learn from what it has coded take at most so many steps, none of them begun after so
        long; how many it took. Another thread may call it. Without such calls nothing is learned: the same frames and
        the same calls give the same bytes."""
        encoder = self._encoder
        return encoder.learn(steps, budget_ms) if isinstance(encoder, Learning) else 0

    @property
    def learn_ms(self) -> float:
        """Milliseconds a frame that a live application may spend on `learn`, by the codec's settings; 0: none."""
        encoder = self._encoder
        return encoder.learn_ms if isinstance(encoder, Learning) else 0.0

    @property
    def learned(self) -> dict[str, Any] | None:
        """What was learned: `steps`, `samples`, `frames_left_out` (whose samples were more than could wait to be
        learned from), `updates` (times that weights were sent), `update_bytes` of the last one, and the bits a return
        that it saves (`gain_bits`); None before `learn` is called."""
        encoder = self._encoder
        return encoder.learned if isinstance(encoder, Learning) else None

    @property
    def rate(self) -> dict[str, Any] | None:
        """How a target bitrate is kept: `auto`, `target_kbps`, `reachable_kbps`, `limited_by`, `reached`, `kbps_5s`,
        and where the codec's knob stands; None without a target."""
        control = self._rate
        return None if control is None else control.report()

    @property
    def reduction(self) -> dict[str, Any] | None:
        """How frames are reduced: `name`, `returns` of the last frame and `kept` of them, what the reducer says, and a
        `note` for who chooses it; None where all returns are sent."""
        return self._reducing.report() if self._rate is None else self._reducing.report() or self._thinning.report()

    def _flushed(self) -> list[Message]:
        messages = [self._lattices.noted(message) for message in self._encoder.flush()]
        if self._rate is not None:
            self._rate.sent(None, messages)
        return messages

    def _steer(self) -> None:
        if isinstance(self._encoder, Steered):
            self._encoder.steer(self._rate)

    @staticmethod
    def _rate_control(settings: StreamSettings, before: RateControl | None = None) -> RateControl | None:
        return None if settings.target_kbps is None else RateControl(settings, before)


class StreamDecoder:
    """Decodes the messages of a stream; follows changes of codec and restarts of the publisher by the headers alone.

    make_decoder: gives the decoder of a codec's number, as `codecs.table` does
    Raises only errors of the DecodeError tree, and WorkerError where a decoder runs in a process of its own; goes on
    with the next message.
    """

    def __init__(self, make_decoder: Callable[[int], Decoder] = table.make_decoder) -> None:
        self._make_decoder = make_decoder
        self._decoder: Decoder | None = None
        self._of: tuple[int, int] | None = None

    def decode(self, message: Message) -> list[Frame]:
        """Frames that became complete with this message."""
        frames: list[Frame] = []
        of = (message.codec, message.stream_id)
        if self._decoder is None or of != self._of:
            fresh = self._make_decoder(message.codec)
            frames = self.flush()
            self._decoder, self._of = fresh, of
        return frames + in_own_columns(self._decoder.decode(message), message)

    def flush(self) -> list[Frame]:
        """Frames that were held back."""
        return [] if self._decoder is None else self._decoder.flush()
