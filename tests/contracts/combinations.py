"""Every codec x shape of frame x content x bound x intensity: it comes back as its settings promise, or is refused
before anything is sent.

`tests/codecs/test_combinations.py` takes a selection in which any two values meet, `python -m tests.fuzz.round_trips`
the whole product.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, islice, product

import numpy as np

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import settings_from
from lidarcodec.side import SideInfo
from lidarcodec.sources import open_source
from lidarcodec.units import FIRINGS_PER_PACKET, LASERS, MAX_COLUMNS, MAX_PACKETS
from tests.conftest import data_folder
from tests.contracts.codec import assert_same_but_ranges, assert_side_equal
from tests.contracts.frames import SENSOR

Row = tuple[str, ...]

CODECS: Mapping[str, dict[str, object]] = {
    **{name: {"codec": name} for name in table.names()},
    "pcodec with mask history": {"codec": "pcodec", "codec_settings": {"mask_history": True}},
    "predictive with motion": {"codec": "predictive", "codec_settings": {"motion": True}},
    "riddle without memory": {"codec": "riddle", "codec_settings": {"memory": False}},
}
SHAPES: Mapping[str, int] = {
    "1 packet": 1,
    "29 packets": 29,
    "683 packets": 683,
    "2048 packets": MAX_PACKETS,
    "revolution": 334,
    "stalled": MAX_PACKETS,
    "24576 columns": 2 * MAX_PACKETS,
}
"""Packets in a frame. `stalled`: all azimuths are equal, so that a turn never ends. The last never was packets."""
CONTENTS = ("constant", "noise", "real", "empty")
BOUNDS: Mapping[str, float | None] = {"no bound": None, "lossless": 0.0, "5 cm": 0.05, "20 m": 20.0}
INTENSITIES = ("lossless", "levels=16", "off")
FACTORS: tuple[Sequence[str], ...] = (tuple(CODECS), tuple(SHAPES), CONTENTS, tuple(BOUNDS), INTENSITIES)
STREAM = 0x600D_57A3


@cache
def _real(packets: int) -> Frame:
    """A frame of so many packets of a real sensor before a wall, over and over; simulated ones without that capture."""
    capture = data_folder() / "hdl64e_s3_atwall.pcap"
    with open_source(str(capture) if capture.exists() else "sim:street?frames=1") as source:
        few = list(islice(source.packets(), 300))
        given = [few[number % len(few)] for number in range(packets)]
        return next(frames_of(given, source.sensor, f"packets:{packets}"))


@cache
def frame_of(shape: str, content: str, index: int = 0) -> Frame:
    """The frame of a case."""
    packets = SHAPES[shape]
    real = content == "real"
    frame = _real(min(packets, MAX_PACKETS)).with_(index=index) if real else _made(packets, content, index)
    if shape == "stalled":
        return frame.with_(azimuth=np.full_like(frame.azimuth, 12_345))
    if shape == "24576 columns":
        return _widest(frame)
    return frame


def _made(packets: int, content: str, index: int) -> Frame:
    """A frame of regular packets."""
    columns = min(packets * FIRINGS_PER_PACKET, MAX_COLUMNS)
    rng = np.random.default_rng([packets, index])
    cells = (LASERS, columns)
    ranges, intensity = {
        "constant": lambda: (np.full(cells, 5000, np.uint16), np.full(cells, 77, np.uint8)),
        "noise": lambda: (
            rng.integers(0, 65536, cells).astype(np.uint16) * (rng.random(cells) < 0.9),
            rng.integers(0, 256, cells).astype(np.uint8),
        ),
        "empty": lambda: (np.zeros(cells, np.uint16), np.zeros(cells, np.uint8)),
    }[content]()
    turn = (index * columns + np.arange(columns)) * 18 % 36_000
    return Frame(
        index=index,
        stamp_ns=1_700_000_000_000_000_000 + index * 100_000_000,
        range=ranges,
        intensity=intensity,
        azimuth=np.tile(turn.astype(np.uint16), (2, 1)),
        fired=np.ones((2, columns), np.bool_),
        sensor=SENSOR,
        side=SideInfo.regular(packets) if packets <= MAX_PACKETS else None,
    )


def _widest(frame: Frame) -> Frame:
    """The frame again and again until it has 24,576 columns, every cell fired."""
    times = -(-MAX_COLUMNS // frame.width)
    planes = {name: np.tile(getattr(frame, name), (1, times))[:, :MAX_COLUMNS] for name in ("range", "intensity")}
    azimuth = np.tile(frame.azimuth, (1, times))[:, :MAX_COLUMNS]
    return frame.with_(azimuth=azimuth, fired=np.ones((2, MAX_COLUMNS), np.bool_), side=None, **planes)


@dataclass(frozen=True)
class Case:
    """One of the combinations."""

    codec: str
    shape: str
    content: str
    bound: str
    intensity: str

    @property
    def bounded(self) -> bool:
        """Whether the codec keeps a bound."""
        return table.codec(str(CODECS[self.codec]["codec"])).bounded

    @property
    def refused(self) -> bool:
        """Whether its settings are no settings: a codec without bounds is asked for one."""
        return BOUNDS[self.bound] is not None and not self.bounded

    def check(self, frames: int = 2) -> int:
        """Send a key frame and others after it, and compare what came back; the bytes of all messages.

        Raises AssertionError, SettingsError where `refused` says so, and whatever encoder or decoder raise.
        """
        settings = settings_from({**CODECS[self.codec], "max_error_m": BOUNDS[self.bound], "intensity": self.intensity})
        encoder, decoder, size = StreamEncoder(settings, STREAM), StreamDecoder(), 0
        sent = [frame_of(self.shape, self.content).with_(index=index) for index in range(frames)]
        came: list[Frame] = []
        for messages in (*(encoder.encode(frame) for frame in sent), encoder.flush()):
            for message in messages:
                data = wire.pack(message)
                size += len(data)
                came += decoder.decode(wire.unpack(data))
        came += decoder.flush()
        assert len(came) == len(sent), f"{len(came)} of {len(sent)} frames came back"
        for back, frame in zip(came, sent, strict=True):
            self._compare(back, frame, settings.step)
        return size

    def _compare(self, came: Frame, sent: Frame, step: int) -> None:
        assert_same_but_ranges(came, sent)
        assert_side_equal(came.side, sent.side)
        off = np.abs(came.range.astype(np.int32) - sent.range)[sent.valid]
        if self.bounded:
            assert off.max(initial=0) <= step // 2, f"an error of {off.max()} steps, {step // 2} are allowed"
        if self.intensity == "lossless":
            np.testing.assert_array_equal(came.intensity, sent.intensity, err_msg="intensity")
        elif self.intensity == "off":
            assert not came.intensity.any(), "intensities although they are off"
        else:
            levels = int(self.intensity.removeprefix("levels="))
            given, back = sent.intensity[sent.valid].astype(np.float64), came.intensity[sent.valid]
            assert len(np.unique(back)) <= levels, "more values of intensity than levels"
            if len(given):
                off = np.sqrt(np.mean((back - given) ** 2))
                assert off <= given.std() + 0.5, "intensities further off than one value for all would be"


def all_cases() -> Iterator[Case]:
    """The whole product."""
    return (Case(*row) for row in product(*FACTORS))


def covering_cases() -> list[Case]:
    """A selection in which any value of a factor meets any value of any other; the same one every time."""
    return [Case(*row) for row in covering(FACTORS)]


def covering(factors: Sequence[Sequence[str]]) -> list[Row]:
    """Rows, one value a factor, in which any two values of two factors meet. Greedy: a row begins with a pair that has
    not met, and takes for each other factor the value that brings most new pairs; of equals, the one used least.

    >>> len(covering(("ab", "cd", "ef")))
    4
    """
    pairs = list(combinations(range(len(factors)), 2))
    left = {(i, a, j, b) for i, j in pairs for a in factors[i] for b in factors[j]}
    rows: list[Row] = []
    for i, j in pairs:
        for a, b in product(factors[i], factors[j]):
            if (i, a, j, b) not in left:
                continue
            row = {i: a, j: b}
            for k in range(len(factors)):
                if k not in row:
                    row[k] = max(
                        factors[k],
                        key=lambda value, k=k, row=row: (  # type: ignore[misc]
                            len(_new(row | {k: value}, left)),
                            -sum(other[k] == value for other in rows),
                        ),
                    )
            left -= _new(row, left)
            rows.append(tuple(row[k] for k in range(len(factors))))
    return rows


def _new(row: Mapping[int, str], left: set[tuple[int, str, int, str]]) -> set[tuple[int, str, int, str]]:
    """The pairs of a row that have not met yet."""
    return {(i, row[i], j, row[j]) for i, j in combinations(sorted(row), 2)} & left
