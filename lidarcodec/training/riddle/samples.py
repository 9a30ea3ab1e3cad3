"""Samples: inputs and results of the networks for some returns, as rows of bytes on disk.

A clip is processed like a stream in the codec: each frame is quantised, its motion is found, the history is warped, and
the native core computes the networks' inputs for each return. Some random rows of each frame are stored. The random
numbers depend only on the run's seed and the numbers of source and clip, so samples are reproducible.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.whole import written_whole
from lidarcodec.frame import Frame
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.network.networks import Weights
from lidarcodec.network.shelf import EFFORTS, networks_of
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.quantise import as_decoded
from lidarcodec.sources import open_source
from lidarcodec.training.identity import identity
from lidarcodec.training.riddle.beside import BesideSamples
from lidarcodec.training.riddle.drives import clips, frames_to_learn
from lidarcodec.training.riddle.extraction import LABELS, Rows, extracted, joined, row_bytes
from lidarcodec.training.riddle.variations import Variation
from lidarcodec.training.runs import step_rng

STEPS: Final = (1, 1, 1, 3, 3, 3, 5, 7, 7, 11, 11, 11, 15, 21, 25, 35, 51, 51, 51, 75, 101, 151, 201, 251)
"""Quantiser steps; a step that occurs more often here is chosen more often."""
_WARM: Final = 2
"""Frames of a clip without a known motion."""
_CLIP_STEPS: Final = 4
_STREAM_FRAMES: Final = 200

Say = Callable[[str], None]


@dataclass(frozen=True)
class Gathering:
    """Options of samples.

    frame_rows: rows of each frame for each step; passes: how often each source is used, with other random numbers
    frames:     most frames of each source; framing: how packets are divided into frames
    units:      `varied`: also other units of the sensor; `own`: only the sensor; `auto`: varied for simulated drives
    """

    seed: int = 1
    frame_rows: int = 5000
    passes: int = 1
    frames: int | None = None
    framing: str = "revolution"
    units: str = "auto"

    def __post_init__(self) -> None:
        if self.frame_rows < 1 or self.passes < 1:
            raise SettingsError("training needs at least one row of each frame and one pass")
        if self.units not in ("auto", "varied", "own"):
            raise SettingsError(f"units must be auto, varied or own, not {self.units}", "units")


def clip_samples(clip: Sequence[Frame], step: int, rows: int, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Rows of a clip at one step: one frame for networks of kind alone, all but the first two for kind expecting.

    clip: frames of one sensor in order; rows: most rows of each frame
    """
    history, finder = RangeHistory(), MotionFinder()
    looked_alone = int(rng.integers(len(clip)))
    alone: list[Rows] = []
    expecting: list[Rows] = []
    for number, frame in enumerate(clip):
        if number == looked_alone:
            alone.append(extracted(frame, step, None, rows, rng))
        if len(clip) > 1:
            motion = finder.next(frame, history).motion
            if number >= _WARM:
                expected = history.expected(motion, frame.azimuth, frame.fired, frame.sensor)
                expecting.append(extracted(frame, step, expected, rows, rng))
            sent = as_decoded(frame.range_u16, frame.valid, step, level_offsets(frame.sensor))
            history.remember(sent, frame.azimuth, frame.fired, frame.sensor)
    return joined(alone, expects=False), joined(expecting, expects=True)


def source_samples(spec: str, how: Gathering, *stream: int, scans: bool = False) -> Iterator[tuple[Rows, Rows]]:
    """Rows of each clip of a source. stream: numbers for its random generator; scans: its frames are independent

    Raises SourceError, CalibrationError or PacketError if it cannot be read.
    """
    units = how.units == "varied" or (how.units == "auto" and spec.startswith("sim:"))
    with open_source(spec) as source:
        source.sensor.only_hdl64e("train riddle")
        found = clips(frames_to_learn(source, how.framing, how.frames), step_rng(how.seed, 0, *stream))
        for number, clip in enumerate(found):
            rng = step_rng(how.seed, number + 1, *stream)
            varied = Variation.drawn(rng, units=units).of(clip, rng)
            for step in rng.choice(STEPS, _CLIP_STEPS, replace=False):
                for part in [[frame] for frame in varied] if scans else [varied]:
                    yield clip_samples(part, int(step), how.frame_rows, rng)


def stream_samples(spec: str, how: Gathering, beside: Weights, *stream: int) -> tuple[Rows, Rows]:
    """Rows of the first 200 frames of a source, coded as a stream with the largest of these networks at one step.

    stream: numbers for its random generator. Raises the errors of `source_samples`.
    """
    units = how.units == "varied" or (how.units == "auto" and spec.startswith("sim:"))
    rng = step_rng(how.seed, 0, *stream, 1)
    with open_source(spec) as source:
        source.sensor.only_hdl64e("train riddle")
        frames = [
            frame.with_(side=None) for frame in islice(frames_to_learn(source, how.framing, how.frames), _STREAM_FRAMES)
        ]
    varied = Variation.drawn(rng, units=units).of(frames, rng)
    return BesideSamples(networks_of(beside, max(EFFORTS)), int(rng.choice(STEPS)), how.frame_rows, rng).of(varied)


class SampleStore:
    """Samples of a run in a folder: two files for each source and pass, complete or missing."""

    def __init__(
        self,
        folder: Path,
        name: str,
        how: Gathering,
        sources: Sequence[str],
        scans: Sequence[str],
        beside: Weights | None = None,
        begun: str = "",
    ) -> None:
        """beside: weights with which the sources are also coded, for samples with context predictions
        begun: name of the initial weights
        """
        self.folder, self._how, self._beside = folder / name, how, beside
        self._sources = [(spec, False) for spec in sources] + [(spec, True) for spec in scans]
        self._plan = {"sources": list(sources), "scans": list(scans), "labels": LABELS, **asdict(how)}
        self._plan["begun"] = begun
        if beside is not None:
            self._plan["beside"] = beside.name

    def gather(self, say: Say) -> None:
        """Make missing samples. Raises SettingsError if the folder has samples of another run."""
        self._check_plan()
        jobs = [(n, p) for p in range(self._how.passes) for n in range(len(self._sources))]
        for done, (number, turn) in enumerate(jobs):
            paths = [self._path(number, turn, expects) for expects in (False, True)]
            if not all(path.exists() for path in paths):
                self._gather_one(number, turn, paths)
                say(f"{self.folder.name} samples: {done + 1} of {len(jobs)} sources, {self._sources[number][0]}")

    def rows(self, expects: bool) -> list[Rows]:
        """The samples of one kind, file by file, mapped into memory. Raises SettingsError if there are none."""
        width = row_bytes(expects)
        found: list[Rows] = []
        for path in sorted(self.folder.glob(f"*-{_kind(expects)}.rows")):
            if count := path.stat().st_size // width:
                found.append(np.memmap(path, np.int8, "r", shape=(count, width)))
        if not found:
            raise SettingsError(f"the sources have no {self.folder.name} samples for a network {_kind(expects)}")
        return found

    def some(self, expects: bool, count: int) -> list[Rows]:
        """About `count` samples of one kind, evenly from all files. Raises SettingsError if there are none."""
        found = self.rows(expects)
        every = max(1, -(-sum(map(len, found)) // count))
        return [np.array(rows[::every]) for rows in found]

    def _gather_one(self, number: int, turn: int, paths: list[Path]) -> None:
        spec, scans = self._sources[number]
        with (
            written_whole(paths[0]) as alone_path,
            written_whole(paths[1]) as expecting_path,
            alone_path.open("wb") as alone,
            expecting_path.open("wb") as expecting,
        ):
            parts = source_samples(spec, self._how, number, turn, scans=scans)
            if self._beside is not None and not scans:
                parts = chain(parts, [stream_samples(spec, self._how, self._beside, number, turn)])
            for rows in parts:
                for file, part in zip((alone, expecting), rows, strict=True):
                    file.write(part.tobytes())

    def _check_plan(self) -> None:
        path = self.folder / "plan.json"
        self._plan["made_of"] = [_identity(spec) for spec, _ in self._sources if not spec.startswith("sim:")]
        text = json.dumps(self._plan, sort_keys=True, indent=1)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if path.exists() and not _says(path, text):
                raise SettingsError(
                    f"{self.folder} has samples of other sources, calibrations, poses or settings: use another folder"
                )
            with written_whole(path) as beside:
                beside.write_text(text)
        except OSError as error:
            raise SourceError(f"cannot write samples to {self.folder}: {error.strerror or error}") from None

    def _path(self, number: int, turn: int, expects: bool) -> Path:
        return self.folder / f"{turn:03d}-{number:05d}-{_kind(expects)}.rows"


def _identity(spec: str) -> str:
    with open_source(spec) as source:
        source.sensor.only_hdl64e("train riddle")
        return identity(source, spec)


def _says(path: Path, text: str) -> bool:
    try:
        return read_file(path, "about") == text.encode()
    except FileTooLargeError:
        return False


def _kind(expects: bool) -> str:
    return "expecting" if expects else "alone"
