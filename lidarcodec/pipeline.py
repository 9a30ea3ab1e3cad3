"""The two halves of the codec: frames to messages, and messages to frames. Pure: no clock, no I/O.

>>> from lidarcodec import StreamSettings
>>> StreamEncoder(StreamSettings(codec="zstd"), stream_id=7).settings.codec
'zstd'
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Set
from typing import Any

from lidarcodec.assembly import Assembler
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Choosing, Decoder, Encoder, Learning, Steered
from lidarcodec.codecs.other_sensors import KINDS, check_for, other_decoder, other_encoder
from lidarcodec.errors import SettingsError
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.lattice import thinned
from lidarcodec.layers.refinable import RefinableFrame, check_layers, refinable_of
from lidarcodec.message import Message, SectionType
from lidarcodec.mounting.stream import MountMemory, MountNotes, mounted
from lidarcodec.packet import UNKEPT_POSITIONS, Packet
from lidarcodec.ratecontrol import RateControl
from lidarcodec.ratecontrol.choosing import without_auto
from lidarcodec.ratecontrol.image_curve import PROBED, PROBED_BOUND_M, PROBED_CODEC, ImageKind, kind_of
from lidarcodec.reduction.reducing import Reducing
from lidarcodec.reduction.table import check as check_reduction
from lidarcodec.reduction.thinning import Thinning
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec.thinned_stream import LatticeNotes, in_own_columns


def frames_of(
    packets: Iterable[Packet],
    sensor: SensorModel,
    framing: str = "revolution",
    counts: Counter[str] | None = None,
    *,
    current: Callable[[], SensorModel] | None = None,
) -> Iterator[Frame]:
    """Frames of packets. The first and the last one may be parts of a turn: a capture can begin and end within one.

    framing: as of StreamSettings
    counts: counts position packets that no frame could hold
    current: the sensor of the packet read last, for a live source, in which another sensor can take the place of one
    A frame is given when the next data packet arrives, so that position packets at the end join the last frame.
    """
    assembler = Assembler(sensor, framing)
    held: Frame | None = None
    told = 0
    for packet in packets:
        if held is not None and not packet.position:
            yield held
            held = None
        if current is not None and (before := assembler.follow(current())) is not None:
            yield before
        held = assembler.push(packet) or held
        if counts is not None and (lost := assembler.counts[UNKEPT_POSITIONS]) > told:
            counts[UNKEPT_POSITIONS] += lost - told
            told = lost
    last = assembler.flush_onto(held)
    if counts is not None and (lost := assembler.counts[UNKEPT_POSITIONS]) > told:
        counts[UNKEPT_POSITIONS] += lost - told
    yield from last


def check(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if their codec and their reduction support them.

    Raises UnknownNameError, or SettingsError with the field and the reason.
    """
    check_reduction(table.check(without_auto(settings)))
    return settings


def check_offline(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if they are for work without a network and without a clock.

    Raises SettingsError for a setting that only a live stream can have.
    """
    if settings.target_kbps == AUTO:
        raise SettingsError("target_kbps=auto works only with live streams: give a number of kbit/s", "target_kbps")
    without_auto(settings)
    return settings


class StreamEncoder:
    """Reduces and encodes the frames of one stream; settings, the codec among them, may change between two frames.

    settings: the current ones. `auto` as codec becomes the codec with the best picture, at any speed (in a live stream
    the publisher also considers speed)

    make_encoder: gives the encoder of a codec, as `codecs.table` does; live, some run in a process of their own
    make_other: the same for frames of other sensors than the HDL-64E, as `codecs.other_sensors` does
    Raises SettingsError or UnknownNameError when settings are not allowed, MissingExtraError for a codec that is not
    installed; nothing has changed then.
    """

    def __init__(
        self,
        settings: StreamSettings | None = None,
        stream_id: int | None = None,
        make_encoder: Callable[[StreamSettings, int], Encoder] = table.make_encoder,
        make_other: Callable[[StreamSettings, int], Encoder] = other_encoder,
    ) -> None:
        self._make_encoder, self._make_other = make_encoder, make_other
        self._asked = check(settings or StreamSettings())
        self._hdl64e = True
        """Whether frames of an HDL-64E are coded now."""
        self.settings = self._resolved(self._asked)
        self.stream_id = secrets.randbits(64) if stream_id is None else stream_id
        self._reducing, self._thinning = Reducing(self.settings), Thinning(self.settings)
        self._encoder = self._made(self.settings)
        self._rate = self._rate_control(self.settings)
        self._other: Encoder | None = None
        """Codes frames of other sensors than the HDL-64E."""
        self._steer()
        self._held: list[Message] = []
        self._sensor: SensorModel | None = None
        """The sensor whose frames that codes."""
        self._images: ImageKind | None = None
        self._lattices, self._mounts = LatticeNotes(), MountNotes()
        self._last_index = -1
        self._index_again = False
        self.reduced: Frame | None = None
        """The last frame, as it was encoded: with `keep` set where it was reduced."""
        self.left_out = False
        """Whether the last frame was not encoded, because the target bitrate does not carry all frames."""
        self.refinable: RefinableFrame | None = None
        """With `base_error_m`: the last frame, to code refinements of it. They can be coded at any later time, in any
        thread."""

    def prepare(self, sensor: SensorModel) -> bool:
        """Be ready for frames of this sensor; `encode` does so by itself. True: a key message comes next.

        Raises SettingsError if this sensor cannot have the settings, MissingExtraError for a codec that is not
        installed; nothing has changed then.
        """
        if sensor.is_hdl64e:
            if self._hdl64e:
                return False
            settings, other = without_auto(self._asked), None
        else:
            if self._sensor is not None and self._sensor.hash == sensor.hash:
                return False
            settings = check_for(sensor, without_auto(self._asked, KINDS))
            other = self._make_other(settings, self.stream_id)
        fresh = self._encoder
        if settings.codec != self.settings.codec:
            fresh = self._made(settings)
        self._held += self._flushed()
        self._encoder = fresh
        self._hdl64e, self._other, self.settings = sensor.is_hdl64e, other, settings
        self._sensor, self._images = None if self._hdl64e else sensor, None
        self._thinning = Thinning(settings, self._thinning)
        self._rate = self._rate_control(settings)
        self._steer()
        return True

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """Messages that became complete with this frame; `key` asks for a key frame.

        Raises SettingsError for settings that a frame of its sensor cannot be coded with.
        """
        if self.prepare(frame.sensor):
            key = True
        if not self._hdl64e and self._images is None:
            self._look_at(frame)
        frame = self._reducing.reduce(measured_only(frame))
        if self._mounts.differs(frame):  # what was held back has the mounting of before
            self._held += self._flushed() if self._last_index >= 0 else []
            self._mounts.take(frame)
            key = True
        held, self._held = self._held, []
        rate, key = self._rate, key or self._index_again
        self.left_out = rate is not None and not key and rate.leaves_out(frame)
        if self.left_out:
            return held
        messages = self._coded(frame, key=key) if rate is None else self._coded_to_rate(frame, rate, key=key)
        # A repeated index names two frames, and an inter frame could refer to the wrong one: the next is a key frame.
        self._index_again, self._last_index = frame.index <= self._last_index, frame.index
        return held + messages

    def _coded_to_rate(self, frame: Frame, rate: RateControl, *, key: bool) -> list[Message]:
        coder = self._coder
        key_is_due = key or (rate.dear and coder.apply(rate.settings))
        coder.apply(rate.settings_for(frame, key=key_is_due))
        messages = self._coded(self._thinning.thin(frame, rate.step), key=key)
        if rate.spilled(frame, messages):
            coder.apply(rate.settings_for(frame, key=True))
            messages = self._coded(self._thinning.thin(frame, rate.step), key=True)
        rate.sent(frame, messages)
        return messages

    def _coded(self, frame: Frame, *, key: bool) -> list[Message]:
        self.reduced, self.refinable = frame, None
        if self._other is not None:  # its messages hold the lattice themselves
            return [self._mounts.noted(message) for message in self._other.encode(frame, key=key)]
        messages = self._encoder.encode(thinned(frame), key=key)
        if self.settings.base_error_m is not None:
            self.refinable = refinable_of(self._encoder, frame, self.settings, self.stream_id)
        self._lattices.goes_in(frame)
        return [self._noted(message) for message in messages]

    def _noted(self, message: Message) -> Message:
        return self._mounts.noted(self._lattices.noted(message))

    def _made(self, settings: StreamSettings) -> Encoder:
        made = self._make_encoder(settings.base, self.stream_id)
        check_layers(made, settings)
        return made

    def apply(self, settings: StreamSettings) -> bool:
        """Use new settings from the next frame on. True: the next message will be a key frame."""
        checked = self._resolved(check(settings))
        if self._sensor is not None:
            check_for(self._sensor, checked)
        if checked.target_kbps is not None and self.settings.target_kbps is None:
            self._images = None
        reducing = Reducing(checked, self._reducing)
        thinning = Thinning(checked, self._thinning)
        other, key_of_other = self._other_for(checked)
        if other is not self._other and self._other is not None:
            self._held += self._flushed()
        if checked.codec == self.settings.codec:
            check_layers(self._encoder, checked)
            key = self._encoder.apply(checked.base)
            if self._rate is not None and checked.target_kbps is not None:
                self._rate.apply(checked)
            else:
                self._rate = self._rate_control(checked, images=self._images)
        else:
            fresh = self._made(checked)
            self._held += self._flushed()
            self._rate = self._rate_control(checked, self._rate, self._images)
            self._encoder, key = fresh, True
        self._asked = settings
        self._reducing, self._thinning, self.settings, self._other = reducing, thinning, checked, other
        self._steer()
        return key if other is None else key_of_other

    def _other_for(self, settings: StreamSettings) -> tuple[Encoder | None, bool]:
        """The encoder of frames of other sensors with these settings, and whether its next message is a key message.

        A codec of pictures goes on with its group or its video; the others begin anew."""
        if self._hdl64e:
            return None, False
        goes_on = self._other is not None and settings.codec == self.settings.codec and settings.codec not in KINDS
        if goes_on and self._other is not None:
            return self._other, self._other.apply(settings)
        return self._make_other(settings, self.stream_id), True

    def aim(self, target_kbps: float) -> None:
        """With `target_kbps=auto`: set the target bitrate from the next frame on. Without a target: does nothing."""
        if self._rate is not None:
            self._rate.aim(target_kbps)

    def refer_to(self, indices: Set[int] | None) -> bool:
        """Refer to the newest of these frames from now on, to none if none of them is kept. None: to the frame before,
        as without a call. False: the codec's frames refer to none, or only to the frame before."""
        coder = self._coder
        return isinstance(coder, Choosing) and coder.refer_to(indices)

    def flush(self) -> list[Message]:
        """Messages of frames that were held back."""
        held, self._held = self._held, []
        return held + self._flushed()

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        """Train a codec that learns from the frames it coded; returns the number of steps taken.

        steps: most training steps; budget_ms: no step begins after this time. Another thread may call it. The codec
        trains in these calls alone: the same frames and the same calls give the same bytes."""
        encoder = self._encoder
        return encoder.learn(steps, budget_ms) if isinstance(encoder, Learning) else 0

    @property
    def learn_ms(self) -> float:
        """Milliseconds a frame that a live application may spend on `learn`, from the codec's settings; 0: none."""
        encoder = self._encoder
        return encoder.learn_ms if isinstance(encoder, Learning) else 0.0

    @property
    def learned(self) -> dict[str, Any] | None:
        """State of the training: `steps`, `samples`, `frames_left_out` (their samples did not fit the queue),
        `updates` (number of weight updates sent), `update_bytes` of the last one, and `gain_bits` (bits a return that
        training saves); None before `learn` is called."""
        encoder = self._encoder
        return encoder.learned if isinstance(encoder, Learning) else None

    @property
    def rate(self) -> dict[str, Any] | None:
        """State of rate control: `auto`, `target_kbps`, `reachable_kbps`, `limited_by`, `reached`, `kbps_5s`, and the
        value of the codec's quality setting; None without a target."""
        control = self._rate
        return None if control is None else control.report()

    @property
    def images(self) -> ImageKind | None:
        """What rate control knows of the sensor; None before its first frame, and of an HDL-64E."""
        return self._images

    @property
    def reduction(self) -> dict[str, Any] | None:
        """How frames are reduced: `name`, number of `returns` in the last frame, how many are `kept`, figures of the
        reducer, and a `note` for people who choose it; None where all returns are sent."""
        return self._reducing.report() if self._rate is None else self._reducing.report() or self._thinning.report()

    def _flushed(self) -> list[Message]:
        messages = [self._noted(message) for message in self._encoder.flush()]
        messages += [] if self._other is None else [self._mounts.noted(message) for message in self._other.flush()]
        if self._rate is not None:
            self._rate.sent(None, messages)
        return messages

    def _steer(self) -> None:
        encoders: tuple[object, ...] = (self._encoder, self._other)
        for encoder in encoders:
            if isinstance(encoder, Steered):
                encoder.steer(self._rate)

    @property
    def _coder(self) -> Encoder:
        """What codes the frames of the sensor that sends now."""
        return self._encoder if self._other is None else self._other

    def _look_at(self, frame: Frame) -> None:
        """Find out what rate control has to know of a sensor, at its first frame; with a target that takes two more
        encodings, which tell what ranges and attributes take."""
        if self.settings.target_kbps is None:
            self._images = kind_of(frame)
            return
        bits = []
        tried = self.settings.codec in KINDS
        probed = {} if tried else {"codec": PROBED_CODEC, "codec_settings": {}}
        for intensity in ("off", f"levels={PROBED}"):
            chosen = {"intensity": intensity, "max_error_m": PROBED_BOUND_M} | probed
            settings = self.settings.model_copy(update=chosen)
            (message,) = other_encoder(settings, self.stream_id).encode(frame)
            bits.append(8.0 * sum(len(one.data) for one in message.sections if one.type == SectionType.PLANES))
        self._images = kind_of(frame, bits[1] - bits[0])
        self._rate = self._rate_control(self.settings, images=self._images)
        if self._rate is not None and frame.points:
            self._rate.begin_with(bits[0] / frame.points, self.settings.codec if tried else PROBED_CODEC)

    def _resolved(self, settings: StreamSettings) -> StreamSettings:
        """The settings with a codec that takes the sensor's frames in place of `auto`."""
        return without_auto(settings) if self._hdl64e else without_auto(settings, KINDS)

    @staticmethod
    def _rate_control(
        settings: StreamSettings, before: RateControl | None = None, images: ImageKind | None = None
    ) -> RateControl | None:
        return None if settings.target_kbps is None else RateControl(settings, before, images)


class StreamDecoder:
    """Decodes the messages of a stream. It sees changes of codec and restarts of the publisher in the headers.

    make_decoder: makes the decoder of a codec number, as `codecs.table` does
    make_other: the same for messages of other sensors than the HDL-64E, as `codecs.other_sensors` does
    Raises only DecodeError and its subclasses, and WorkerError where a decoder runs in a process of its own. After an
    error it can decode the next message.
    """

    def __init__(
        self,
        make_decoder: Callable[[int], Decoder] = table.make_decoder,
        make_other: Callable[[int], Decoder] = other_decoder,
    ) -> None:
        self._make_decoder, self._make_other = make_decoder, make_other
        self._decoder: Decoder | None = None
        self._of: tuple[int, int, bool] | None = None
        self._mounts = MountMemory()

    def decode(self, message: Message) -> list[Frame]:
        """Frames that became complete with this message."""
        frames: list[Frame] = []
        of = (message.codec, message.stream_id, message.planes)
        if self._decoder is None or of != self._of:
            fresh = (self._make_other if message.planes else self._make_decoder)(message.codec)
            frames = self.flush()
            self._decoder, self._of = fresh, of
        mount = self._mounts.read(message)
        decoded = self._decoder.decode(message)
        return frames + mounted(decoded if message.planes else in_own_columns(decoded, message), mount)

    def flush(self) -> list[Frame]:
        """Frames that were held back."""
        return [] if self._decoder is None else self._decoder.flush()
