"""RateControl: the controller for an encoder. Its clock is the time stamps of the frames."""

from __future__ import annotations

import json
import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.ratecontrol.adaptive import START_KBPS
from lidarcodec.ratecontrol.budget import WINDOW_S, kbps
from lidarcodec.ratecontrol.controller import (
    SETTLED_S,
    Load,
    Plan,
    RateState,
    Sizes,
    chosen,
    left_out,
    limited_by,
    measured,
    on_target,
    reachable_kbps,
    retargeted,
    skips,
    surprised,
)
from lidarcodec.ratecontrol.curve import Curve, Pins, WorkingPoint, operating_curve
from lidarcodec.ratecontrol.fitting import fitted
from lidarcodec.ratecontrol.image_curve import ImageKind, image_curve, range_bits, seconds_of
from lidarcodec.ratecontrol.model import MAX_ROUGHNESS, tilt
from lidarcodec.settings import AUTO, LATTICE, StreamSettings
from lidarcodec.units import FIRINGS_PER_PACKET, PACKET_INTERVAL_US
from lidarcodec.wire import size_of

logger = logging.getLogger(__name__)

PACKET_S: Final = PACKET_INTERVAL_US * 1e-6
"""An HDL-64 sends a packet every 288 us (6 firings of 48 us), at any rotation speed."""
STAMP_FACTOR: Final = 4.0
"""If by the stamps a packet took 4 times as long, or a quarter, there was a pause or the clock was set."""
STAMP_GAIN: Final = 0.2


class RateControl:
    """Chooses the value of an encoder's knob for each frame, and learns from the messages.

    Call in this order: `settings_for(frame)`, encode, `sent(frame, messages)`; with the target `auto` also `aim`. An
    encoder of groups calls `range_of` for each message when it has its frames (`codecs.base.Steered`).

    Raises SettingsError if the codec has no knob, or the settings have no target.
    """

    def __init__(
        self, settings: StreamSettings, before: RateControl | None = None, images: ImageKind | None = None
    ) -> None:
        """before: the control of this stream with the previous codec; its learned state is kept

        images: of the sensor, if that is another one than an HDL-64E
        """
        self._images: Final = images
        self._settings: StreamSettings
        self._plan: Plan
        self._auto_kbps = START_KBPS if before is None else before._plan.target_bps / 1e3
        self._state: RateState = RateState() if before is None else before._state
        self._usual_s: float | None = PACKET_S if images is None else None
        """Time of a packet, before stamps tell; None: as the first frame says."""
        self._packet_s: float = PACKET_S if before is None else before._packet_s
        self._last: tuple[int, int, int] | None = None if before is None else before._last
        self._logged_reached: bool = before is None or before._logged_reached
        self._since_log_s: float = 0.0 if before is None else before._since_log_s
        self._waiting: deque[tuple[int, Load]] = deque()
        self._fitted: deque[tuple[Plan, int]] = deque()  # for messages after `range_of` and before `sent`
        self._level, self._turned = 0, False
        self._exact: WorkingPoint | None = None  # the fitted point of a group
        self._begun: tuple[int, Load] | None = None  # the frame that is being encoded
        self._since_s: float = 0.0 if before is None else before._since_s
        self.left_out: int = 0 if before is None else before.left_out
        """Number of frames that were skipped, because the target is too small for them."""
        self._take(settings)
        if before is not None and before._plan.target_bps != self._plan.target_bps:
            self._state = retargeted(self._state)

    def apply(self, settings: StreamSettings) -> None:
        """Use other settings of the same codec from the next frame on."""
        target_bps = self._plan.target_bps
        at = self.point
        self._auto_kbps = target_bps / 1e3
        self._take(settings)
        self._level = _nearest_to(at, self._plan.curve)
        if self._plan.target_bps != target_bps:
            self._state = retargeted(self._state)

    def begin_with(self, bits: float, codec: str) -> None:
        """Before the first frame of another sensor than an HDL-64E: what a range took when it was tried, in bits, and
        with which codec."""
        if self._images is not None and bits > 0.0:
            guess = range_bits(codec, self._images)
            roughness = math.log(bits / guess) / float(tilt(np.array([guess]))[0])
            self._state = replace(self._state, roughness=min(max(roughness, -MAX_ROUGHNESS), MAX_ROUGHNESS))

    def aim(self, target_kbps: float) -> None:
        """With the target `auto`: set the present bitrate of the path. Debts are kept. A fixed target does not
        change.
        """
        if self._settings.target_kbps == AUTO:
            self._auto_kbps = target_kbps
            self._plan = replace(self._plan, target_bps=1e3 * target_kbps)

    @property
    def dear(self) -> bool:
        """Whether a change of the knob costs bits, so that it is best done at key frames."""
        return self._knob.renewal is not None

    @property
    def settings(self) -> StreamSettings:
        """The settings of the last frame."""
        return self._at(self.point)

    @property
    def point(self) -> WorkingPoint:
        """The working point of the last frame."""
        if self._exact is not None:
            return self._exact
        return self._plan.curve.points[min(self._level, len(self._plan.curve.points) - 1)]

    @property
    def step(self) -> int:
        """The step of the lattice of the last frame, or one in so many returns is sent; 1 if a reduction is pinned."""
        return self.point.step if self._settings.reduction == AUTO else 1

    def leaves_out(self, frame: Frame) -> bool:
        """Whether to skip a frame, because even the cheapest working point exceeds the target with all frames.

        A skipped frame counts as time without sent data.
        """
        load = self._load(frame)
        if self._waiting or not skips(self._state, self._plan, load, self._since_s):
            self._since_s = 0.0
            return False
        self._since_s += load.seconds
        self.left_out += 1
        self._state = left_out(self._state, self._plan, load)
        self._tell(load.seconds)
        return True

    def settings_for(self, frame: Frame, *, key: bool = False) -> StreamSettings:
        """The settings for encoding a frame; `step` is its lattice. All frames of a group use the settings of its
        first one.

        key: whether it will be a key frame
        """
        self._begun = (frame.index, self._load(frame))
        if not self._waiting:
            self._exact = None
            last = self._level if self._turned else None
            self._level, self._turned = chosen(self._state, self._plan, self._load(frame), last, key=key), True
        return self.settings

    def spilled(self, frame: Frame, messages: list[Message]) -> bool:
        """Whether a frame's messages are so large that it must be coded again as a key frame, with `settings_for`."""
        if not self.dear or len(messages) != 1 or messages[0].frame_count != 1:
            return False
        known = surprised(self._state, self._plan, self._level, self._load(frame), _sizes(messages[0]))
        if known is None:
            return False
        self._state = known
        return True

    def range_of(self, frames: Sequence[Frame], message: Message, code: Callable[[StreamSettings], bytes]) -> bytes:
        """The RANGE section with which a message of these frames has its allowed size.

        message: the message without ranges; code: codes the ranges with the knob in these settings
        """
        known = dict(self._waiting) | dict([self._begun] if self._begun is not None else [])
        load = _sum([known.get(frame.index) or self._load(frame) for frame in frames])
        at = self.point
        pins = pins_of(self._settings)._replace(step=at.step, levels=at.levels)
        plan = replace(self._plan, curve=self._curve(pins))
        points = plan.curve.points
        level, data = fitted(
            self._state, plan, load, 8.0 * size_of(message), lambda level: code(self._at(points[level]))
        )
        self._fitted.append((plan, level))
        self._level, self._exact = _nearest_to(points[level], self._plan.curve), points[level]
        return data

    def sent(self, frame: Frame | None, messages: list[Message]) -> None:
        """Learn from the messages that a frame, or the end of the stream, completed."""
        if frame is not None:
            self._follow_stamps(frame)
            self._waiting.append((frame.index, self._load(frame)))
        for message in messages:
            while self._waiting and self._waiting[0][0] < message.frame_index:
                self._waiting.popleft()  # lost with an encoder that failed
            loads = [self._waiting.popleft()[1] for _ in range(min(message.frame_count, len(self._waiting)))]
            if not loads:
                continue
            load = _sum(loads)
            plan, level = self._fitted.popleft() if self._fitted else (self._plan, self._level)
            self._state = measured(self._state, plan, level, load, _sizes(message), len(loads))
            self._tell(load.seconds)

    def report(self) -> dict[str, Any]:
        """The field `rate` of the status: target, reachable bitrates, limit, mean of five seconds, knob."""
        state, plan = self._state, self._plan
        ends, mean = reachable_kbps(state, plan), kbps(state.budget, WINDOW_S)
        return {
            "auto": self._settings.target_kbps == AUTO,
            "target_kbps": round(plan.target_bps / 1e3, 1),
            "reachable_kbps": None if ends is None else [round(end, 1) for end in ends],
            "limited_by": self._limited_by(),
            "reached": self._reached(),
            "kbps_5s": None if mean is None else round(mean, 1),
            self._knob.setting: self.point.value,
            "intensity": self._intensity_at(self.point),
            "step": 1 if self._settings.purpose == "localise" else self.step,
            "frames_left_out": self.left_out,
        }

    def _at(self, point: WorkingPoint) -> StreamSettings:
        settings = self._knob.with_value(self._settings, point.value)
        return settings.model_copy(update={"intensity": self._intensity_at(point)})

    def _intensity_at(self, point: WorkingPoint) -> str:
        chosen = self._settings.intensity
        if chosen != AUTO:
            return chosen
        return {0: "off", 256: "lossless"}.get(point.levels, f"levels={point.levels}")

    def _take(self, settings: StreamSettings) -> None:
        knob = table.codec(settings.codec).knob
        if knob is None or settings.target_kbps is None:
            raise SettingsError(f"codec {settings.codec} cannot keep a target bitrate", "target_kbps")
        own = {name: value for name, value in settings.codec_settings.items() if name != knob.setting}
        model = f"{settings.codec} {json.dumps(own, sort_keys=True, default=str)}"
        if settings.purpose == "localise":
            model += f" {settings.purpose}"
        if settings.reduces:  # one of few returns costs more than one of many
            model += f" {settings.reduction} {settings.keep_points} {settings.keep_fraction}"
        self._settings, self._knob = settings, knob
        target_kbps = self._auto_kbps if settings.target_kbps == AUTO else float(settings.target_kbps)
        self._plan = Plan(1e3 * target_kbps, model, self._curve(pins_of(settings)), knob.renewal)

    def _curve(self, pins: Pins) -> Curve:
        codec = self._settings.codec
        return operating_curve(codec, pins) if self._images is None else image_curve(codec, pins, self._images)

    def _reached(self) -> bool:
        """Whether the target is reached. With target `auto` the mean of five seconds is not compared. If even the
        finest point of the curve needs less, the target also counts as reached."""
        limit = self._limited_by()
        if self._settings.target_kbps == AUTO:
            return limit != "floor"
        return limit == "codec" or on_target(self._state, self._plan)

    def _limited_by(self) -> str:
        limit = limited_by(self._state, self._plan)
        return "path" if limit == "target" and self._settings.target_kbps == AUTO else limit

    def _load(self, frame: Frame) -> Load:
        whole = frame.keep is None or frame.lattice is not None
        returns = frame.points if whole else int(frame.valid.sum())
        packets = _packets(frame)
        if self._usual_s is None:
            self._usual_s = self._packet_s = seconds_of(frame) / packets
        return Load(returns, packets, packets * self._packet_s)

    def _follow_stamps(self, frame: Frame) -> None:
        if self._last is not None:
            index, stamp_ns, packets = self._last
            packet_s = (frame.stamp_ns - stamp_ns) * 1e-9 / (packets * max(frame.index - index, 1))
            usual_s = self._usual_s or PACKET_S
            if usual_s / STAMP_FACTOR <= packet_s <= usual_s * STAMP_FACTOR:
                self._packet_s += STAMP_GAIN * (packet_s - self._packet_s)
        self._last = frame.index, frame.stamp_ns, _packets(frame)

    def _tell(self, seconds: float) -> None:
        """Log when a target is missed and when it is reached again, at most once in five seconds."""
        self._since_log_s += seconds
        reached = self._reached()
        if reached == self._logged_reached or self._since_log_s < (SETTLED_S if self._logged_reached else WINDOW_S):
            return
        self._logged_reached, self._since_log_s = reached, 0.0
        mean = kbps(self._state.budget, WINDOW_S) or 0.0
        low, high = reachable_kbps(self._state, self._plan) or (0.0, 0.0)
        logger.log(
            logging.INFO if reached else logging.WARNING,
            "target of %.0f kbit/s %s: sending %.0f kbit/s; codec %s can send %.0f to %.0f kbit/s of this scene",
            self._plan.target_bps / 1e3,
            "reached" if reached else "missed",
            mean,
            self._settings.codec,
            low,
            high,
        )


def pins_of(settings: StreamSettings) -> Pins:
    """The values that the settings pin."""
    knob = table.codec(settings.codec).knob
    own = None if knob is None else settings.codec_settings.get(knob.setting)
    name, _, number = settings.reduction.partition(":")
    step = None if settings.reduction == AUTO else int(number) if name == LATTICE else 1
    levels = None if settings.intensity == AUTO else settings.intensity_levels
    sparse = settings.reduces and (name != LATTICE or settings.purpose == "localise")
    return Pins(step, levels, settings.max_error_m, None if own is None else float(own), settings.purpose, sparse)


def _nearest_to(point: WorkingPoint, curve: Curve) -> int:
    """Index of the point of a curve that is most similar to another point."""

    def unlike(place: int) -> tuple[float, float, float]:
        of = curve.points[place]
        return abs(math.log(of.step / point.step)), abs(of.value - point.value), abs(of.levels - point.levels)

    return min(range(len(curve.points)), key=unlike)


def _sum(loads: Sequence[Load]) -> Load:
    return Load(*(sum(parts) for parts in zip(*loads, strict=True)))


def _packets(frame: Frame) -> int:
    packets = 0 if frame.side is None else frame.side.packets
    return max(packets or -(-frame.width // FIRINGS_PER_PACKET), 1)


def _sizes(message: Message) -> Sizes:
    bits = {SectionType.RANGE: 0.0, SectionType.INTENSITY: 0.0, SectionType.CALIBRATION: 0.0}
    for section in message.sections:
        kind = SectionType.RANGE if section.type == SectionType.PLANES else section.type
        if kind in bits:
            bits[SectionType(kind)] += 8.0 * len(section.data)
    return Sizes(
        range=bits[SectionType.RANGE],
        intensity=bits[SectionType.INTENSITY],
        rest=8.0 * size_of(message) - sum(bits.values()),
        calibration=bits[SectionType.CALIBRATION],
        renewed=message.needs is None,
    )
