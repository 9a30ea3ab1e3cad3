"""RoundTrip: decodes new messages at once, and compares the result with the original frames.

A faulty encoder does not report lost data; only decoding its messages shows it. So recorded messages are decoded again
before they are relied on.

>>> from lidarcodec import StreamSettings
>>> RoundTrip(StreamSettings(codec="zstd")).compared
0
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from lidarcodec.codecs import table
from lidarcodec.errors import LidarCodecError, RoundTripError
from lidarcodec.evaluation.plane_difference import plane_difference, told_of_planes
from lidarcodec.evaluation.verify import bound_of, promise_of
from lidarcodec.frame import Frame
from lidarcodec.lattice import thinned
from lidarcodec.layers import RefinableFrame
from lidarcodec.message import Message, SectionType
from lidarcodec.packet_rest import PacketRest
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.planes.attribute_values import AttributeQuality
from lidarcodec.planes.clouds.comparison import same_but_near
from lidarcodec.planes.intensity import FORM_FEW, LOSSLESS_LEVELS, MODELLED, Quality, reduced
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.settings import AUTO, StreamSettings, step_of
from lidarcodec.side import SideInfo
from lidarcodec.wire import unpack

CLOCK_NS = 500
"""Host times of packets are coded with an error of at most half a microsecond."""


class RoundTrip:
    """Decodes one stream again. The first message must not refer to another one.

    settings: settings of the stream from now on; may change between two frames
    joining: the first message may have frames that were encoded earlier; they are skipped
    compared: number of compared frames
    """

    def __init__(
        self,
        settings: StreamSettings,
        *,
        joining: bool = False,
        compared: Callable[[Frame, Frame], object] = lambda sent, decoded: None,
    ) -> None:
        """compared: called with each pair of frames that agree: as it was sent, as it was decoded"""
        self.settings = settings
        self._pair = compared
        self.compared = 0
        self._joining = joining
        self._decoder = StreamDecoder()
        self._sent: deque[tuple[Frame, StreamSettings]] = deque()

    @property
    def waiting(self) -> int:
        """Number of frames that were encoded but not decoded yet."""
        return len(self._sent)

    def sent(self, frame: Frame) -> None:
        """Add a frame that is encoded. `keep` must be set if it was reduced."""
        self._sent.append((frame, self.settings.base))

    def message(self, data: bytes) -> list[Frame]:
        """Decode a message and compare its frames with the originals. Returns the decoded frames.

        Raises RoundTripError if it cannot be decoded, or a frame differs more than the settings allow.
        """
        try:
            message = unpack(data)
            frames = self._decoder.decode(message)
            step, told = promise_of(message).step, told_of(message)
        except LidarCodecError as error:
            raise _fault(
                f"{self._named()} cannot be decoded after {self.settings.codec} encoded it ({error})"
            ) from None
        for frame in frames:
            self._compare(frame, step, told)
        return frames

    def end(self) -> list[Frame]:
        """The frames that the decoder still holds. Also raises RoundTripError if a frame is missing."""
        frames = self._decoder.flush()
        for frame in frames:
            self._compare(frame, None)
        if self._sent:
            others = f", nor did {self.waiting - 1} more" * (self.waiting > 1)
            raise _fault(f"the decoder of {self.settings.codec} did not return {self._named()}{others}")
        return frames

    def _compare(self, came: Frame, step: int | None, told: Quality | AttributeQuality | None = None) -> None:
        if not self._sent or self._sent[0][0].index != came.index:
            if self._joining:
                return
            raise _fault(
                f"the decoder of {self.settings.codec} returned frame {came.index}, which was not encoded at this point"
            )
        sent, settings = self._sent.popleft()
        self._joining = False
        if settings.intensity != AUTO or settings.target_kbps is None:
            told = None
        wrong = difference(came, sent, settings, step, told)
        if wrong is not None:
            raise _fault(f"{settings.codec} did not keep frame {came.index}: it was decoded with {wrong}")
        self.compared += 1
        self._pair(sent, came)

    def _named(self) -> str:
        return f"frame {self._sent[0][0].index}" if self._sent else "a message"


def check_refined(came: Frame, refinable: RefinableFrame) -> None:
    """Compare a frame with all its refinements with what was measured.

    Raises RoundTripError if a range is further away than refinements reach, or exact intensities differ.
    """
    sent, most = refinable.frame, refinable.step // 2
    off = int(np.abs(came.range.astype(np.int64) - sent.range.astype(np.int64)).max(initial=0))
    exact = not refinable.intensity or np.array_equal(came.intensity, sent.intensity)
    if off > most or not exact:
        what = f"a range error of {bound_of(2 * off):g} m" if off > most else "other intensities"
        raise _fault(f"refinements did not keep frame {came.index}: it was decoded with {what}")


def _fault(what: str) -> RoundTripError:
    return RoundTripError(f"{what}: please report this, and use another codec or other settings")


def told_of(message: Message) -> Quality | AttributeQuality:
    """The quality of intensities according to a message: all, none, or few values (their number is unknown)."""
    if message.planes:
        return told_of_planes(message)
    coded = next((section.data for section in message.sections if section.type == SectionType.INTENSITY), None)
    if coded is None:
        return Quality(0)
    few = bool(coded) and coded[0] % MODELLED == FORM_FEW
    return Quality(LOSSLESS_LEVELS - few)


def difference(
    came: Frame,
    sent: Frame,
    settings: StreamSettings,
    step: int | None,
    told: Quality | AttributeQuality | None = None,
) -> str | None:
    """A text about a difference that the settings do not allow; None if there is none.

    step: quantiser step in the message, None if it has none;  told: quality of intensities according to the message,
    None: as in the settings
    """
    if sent.sensor.is_cloud:
        return _cloud_difference(came, sent, settings)
    if came.range.shape != sent.range.shape:
        return f"{came.width} columns instead of {sent.width}"
    if sent.lattice is not None or came.lattice is not None:
        if not np.array_equal(came.lattice, sent.lattice):  # type: ignore[arg-type]
            return "different columns"
        if not _same_side(came.side, sent.side):
            return "other packets"
        if not np.array_equal(came.fired, sent.fired):
            return "different halves of columns that fired"
        if sent.sensor.is_hdl64e:
            came, sent = thinned(came), thinned(sent)
    valid = sent.valid
    if not np.array_equal(came.range > 0, valid):
        return f"{came.points} returns instead of {int(np.count_nonzero(valid))}, or others"
    same = (
        came.stamp_ns == sent.stamp_ns
        and np.array_equal(came.azimuth, sent.azimuth)
        and np.array_equal(came.fired, sent.fired)
        and came.sensor.hash == sent.sensor.hash
        and (came.pose is None if sent.pose is None else np.array_equal(came.pose, sent.pose))  # type: ignore[arg-type]
    )
    if not same:
        return "a different time, pose or calibration, or different azimuths"
    if not _same_side(came.side, sent.side):
        return "other packets"
    if not sent.sensor.is_hdl64e:
        allowed = _allowed(sent, settings, step) if table.codec(settings.codec).bounded else None
        few = AttributeQuality.of(settings) if told is None or isinstance(told, Quality) else told
        return _range_difference(came, sent, settings, step) or plane_difference(
            came, sent, few, allowed, exact=told is None
        )
    told = told if isinstance(told, Quality) else None
    return _range_difference(came, sent, settings, step) or _intensity_difference(
        came, sent, Quality.of(settings) if told is None else told, exact=told is None
    )


def _cloud_difference(came: Frame, sent: Frame, settings: StreamSettings) -> str | None:
    """Of a frame that is a point cloud: all bytes are as they were, or coordinates are within the bound."""
    same = (
        came.stamp_ns == sent.stamp_ns
        and came.sensor.hash == sent.sensor.hash
        and (came.pose is None if sent.pose is None else np.array_equal(came.pose, sent.pose))  # type: ignore[arg-type]
    )
    if not same:
        return "a different time, pose or sensor"
    one, other = payload_of(came), payload_of(sent)
    if one == other or (settings.max_error_m and same_but_near(one, other, settings.max_error_m)):
        return None
    return "points that are further off than allowed, or other fields" if settings.max_error_m else "other bytes"


def _range_difference(came: Frame, sent: Frame, settings: StreamSettings, step: int | None) -> str | None:
    if not table.codec(settings.codec).bounded:
        return None
    allowed = _allowed(sent, settings, step)
    off = int(np.abs(came.range.astype(np.int64) - sent.range.astype(np.int64))[sent.valid].max(initial=0))
    if off <= allowed:
        return None
    error_m, most_m = (bound_of(2 * steps, sent.sensor.range_step_m) for steps in (off, allowed))
    return f"a range error of {error_m:g} m, although only {most_m:g} m are allowed"


def _allowed(sent: Frame, settings: StreamSettings, step: int | None) -> int:
    """Largest error of a range, in range steps."""
    allowed = (step or 1) // 2
    if settings.target_kbps is None:  # only a target bitrate may change the bound
        allowed = min(allowed, step_of(settings.max_error_m or 0.0, sent.sensor.range_step_m) // 2)
    return allowed


def _intensity_difference(came: Frame, sent: Frame, quality: Quality, *, exact: bool) -> str | None:
    """exact: whether the encoder used exactly this quality"""
    if not quality.levels:
        return "intensities, although they are switched off" if came.intensity.any() else None
    if quality.lossless:
        kept = sent.intensity if sent.keep is None else np.where(sent.valid, sent.intensity, np.uint8(0))
        return None if np.array_equal(came.intensity, kept) else "different intensities"
    if exact:
        same = np.array_equal(came.intensity, reduced(sent, quality))
        return None if same else "other intensities than the encoder chose"
    given, off = (plane[sent.valid].astype(np.float64) for plane in (sent.intensity, came.intensity))
    off -= given
    if off.size and np.square(off).mean() > given.var() + 0.25:  # with one value: the mean as an integer
        return "larger intensity errors than any choice of values allows"
    return None


def _same_side(came: SideInfo | PacketRest | None, sent: SideInfo | PacketRest | None) -> bool:
    """Whether packets have the same bytes, and host times within their coding error."""
    if isinstance(came, PacketRest) and isinstance(sent, PacketRest):
        return _same_rest(came, sent)
    if not isinstance(came, SideInfo) or not isinstance(sent, SideInfo):
        return came is sent
    return (
        np.array_equal(came.layouts[came.layout], sent.layouts[sent.layout])
        and np.array_equal(came.gps_us, sent.gps_us)
        and np.array_equal(came.status, sent.status)
        and np.array_equal(came.irregular, sent.irregular)
        and np.array_equal(came.second, sent.second)
        and int(np.abs(came.packet_ns - sent.packet_ns).max(initial=0)) <= CLOCK_NS
    )


def _same_rest(came: PacketRest, sent: PacketRest) -> bool:
    return (
        came.layout == sent.layout
        and came.odd_packets == sent.odd_packets
        and np.array_equal(came.odd, sent.odd)
        and came.series.keys() == sent.series.keys()
        and all(np.array_equal(values, sent.series[name]) for name, values in came.series.items())
        and int(np.abs(came.packet_ns - sent.packet_ns).max(initial=0)) <= CLOCK_NS
    )
