"""Frames of a complete or cut recording: decodes every message that can be decoded, and counts the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from lidarcodec.errors import DecodeError, SettingsError, SourceError, UnknownNameError
from lidarcodec.files.regular import open_regular
from lidarcodec.frame import Frame
from lidarcodec.layers import RefinedFrame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder, check, frames_of
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.recording.layer_counts import LAYERS, LayerCounts
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source


class RecordedFrames:
    """Frames of a recording in order; iterate once.

    failed: messages that could not be decoded, by error; counts: damage that the reader found (`cut`, `damaged`)
    metadata: metadata of the recording; message: the message of the current frame, None if packets were recorded
    refined: the refinements of the current frame, None if it has none
    layers: frames refined `whole`, in `part` or not at all (`base`); empty for a recording of one layer
    """

    def __init__(self, path: Path, instead: str = "") -> None:
        """Raises OSError or SourceError if it is not a recording. instead: what the error adds then"""
        self._path = path
        self.message: Message | None = None
        self.refined: RefinedFrame | None = None
        self._layers = LayerCounts()
        self.failed: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        with open_regular(path) as handle:
            reader = RecordingReader(handle, False, instead)
            self.metadata = reader.metadata
            self._coded = next(reader.messages(), None) is not None

    @property
    def layers(self) -> Counter[str]:
        """How many frames were refined."""
        return self._layers.counts

    def settings(self) -> StreamSettings | None:
        """The settings in the metadata; None if there are none.

        Raises SourceError if this build does not know them.
        """
        text = self.metadata.get("settings")
        if text is None:
            return None
        try:
            return check(StreamSettings.model_validate_json(text))
        except (ValueError, SettingsError, UnknownNameError) as error:
            raise SourceError(f"{self._path} was made with settings that this build does not know: {error}") from None

    def __iter__(self) -> Iterator[Frame]:
        return self._decoded() if self._coded else self._from_packets()

    def _decoded(self) -> Iterator[Frame]:
        decoder = StreamDecoder()
        with open_regular(self._path) as handle:
            reader = RecordingReader(handle)
            for message, frames in decoded(reader, reader.messages(), decoder.decode, self._fail, self._take):
                self.message = message
                if frames:
                    self._layers.add(reader, message, self.refined)
                yield from frames
                self.refined = None
            self.counts = reader.counts
        yield from decoder.flush()

    def _take(self, refined: RefinedFrame) -> None:
        self.refined = refined

    def layers_text(self) -> str:
        """How many frames were refined, in a sentence; empty if there is nothing to say."""
        if not self.layers:
            return ""
        whole, part, base = (self.layers[name] for name in LAYERS)
        return f"{whole} frames refined whole, {part} in part, {base} base only"

    def _fail(self, error: DecodeError) -> None:
        self.failed[f"{type(error).__name__}: {error}"] += 1

    def _from_packets(self) -> Iterator[Frame]:
        with open_source(self._path, points=False) as source:
            yield from frames_of(source.packets(), source.sensor)
            self.counts = source.counts

    def warnings(self) -> list[str]:
        """Warnings about missing frames, one sentence each. The reader itself warns about a cut file."""
        total = sum(self.failed.values())
        if not total:
            return []
        worst, _ = self.failed.most_common(1)[0]
        return [f"{self._path}: {total} messages could not be decoded and were skipped ({worst})"]
