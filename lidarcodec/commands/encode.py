"""`lidarcodec encode`: writes a source as a recording."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from lidarcodec.assembly.short_turns import ShortTurns
from lidarcodec.commands import kept_messages
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.sources import check_finite, check_not_input, readable
from lidarcodec.errors import SettingsError, SourceError, TargetMissedError
from lidarcodec.evaluation.coded_recording import UNNAMED, CodedRecording, Named
from lidarcodec.files.whole import check_free, whole
from lidarcodec.pipeline import StreamEncoder, check_offline, frames_of
from lidarcodec.ratecontrol.controller import TOLERANCE
from lidarcodec.ratecontrol.reach import pinned
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.mounts import NOT_SAID, Mounted
from lidarcodec.sources.posed import with_poses
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import SCHEMES, kind_of
from lidarcodec.sources.unkept import say_unkept

logger = logging.getLogger(__name__)


def run(
    spec: str,
    out: Path,
    *,
    codec: str | None,
    pairs: list[str],
    selection: Selection,
    calibration: Path | None,
    poses: Path | None,
    clouds: bool = False,
    learn: int = 0,
    force: bool = False,
    allow_missed: bool = False,
    as_json: bool = False,
    mounted: Mounted = NOT_SAID,
    named: Named = UNNAMED,
) -> None:
    """Encode frame by frame. OUT appears when it is complete; after a signal the finished part has another name.

    Without a setting the messages of a recording are kept as they are. A live sensor whose place another one takes ends
    nothing: if the settings are not for that one, its frames are left out, and the exit code is 1.
    """
    if out.suffix.lower() != ".mcap":
        raise SettingsError(f"encode writes a recording: {out} must end in .mcap")
    encoder = _encoder(codec, pairs, learn)
    check_finite(spec, selection.frames, live_too=False)
    check_not_input(out, spec)
    check_free(out, force=force)
    kept = None if mounted.mount else _as_it_is(spec, codec, pairs, learn, calibration, poses)
    if kept is not None:
        kept_messages.run(kept, out, selection, named, clouds=clouds, force=force, as_json=as_json)
        return
    with open_source(spec, calibration=calibration, poses=poses, points=clouds) as source:
        mounted.given_to(source)
        coding = _Coding(encoder, selection, named, posed=poses is not None, clouds=clouds, learn=learn)
        coded = coding.run(spec, source, out, force=force, as_json=as_json)
    missed = missed_target(encoder.settings, coded)
    if missed is not None and not allow_missed:
        raise TargetMissedError(missed)


@dataclass
class _Coding:
    """How frames are coded. posed: whether the poses of the source are taken;  learn: steps after each frame"""

    encoder: StreamEncoder
    selection: Selection
    named: Named
    posed: bool
    clouds: bool
    learn: int

    def run(self, spec: str, source: PacketSource, out: Path, *, force: bool, as_json: bool) -> CodedRecording:
        """Code the frames of a source into a recording, and say what was written."""
        encoder, selection, frames = self.encoder, self.selection, self.selection.frames
        short = ShortTurns("turn" if encoder.settings.framing == "revolution" else "frame")
        with (
            stoppable(source.finish if source.live else None) as stopped,
            whole(out, force=force) as output,
        ):
            encoder.prepare(source.sensor)
            about = {"source": readable(spec), "calibration": f"{source.sensor.origin} {source.sensor.hash}"}
            cut = with_poses(
                frames_of(
                    source.packets(),
                    source.sensor,
                    encoder.settings.framing,
                    source.counts,
                    current=lambda: source.sensor,
                ),
                source.poses if self.posed else source.carried,
                source.mount,
            )
            # A signal ends a live source; the packets received so far are the last frame.
            watched = Watched(cut, (lambda: False) if source.live else stopped)
            chosen = short.watched(selection.of(watched))
            first = next(chosen, None)
            if first is None and stopped():
                raise remaining.stopped(out, None, 0)
            if first is None:
                raise SourceError(f"{spec} has {selection.nothing()}: nothing was encoded")
            with output.beside.open("wb") as handle, progress("encoding", frames) as tick:
                vehicle, sensor = self.named.known(source)
                coded = CodedRecording(handle, encoder, about, clouds=self.clouds, vehicle=vehicle, sensor=sensor)
                left_out = 0  # frames of another sensor, which took the place of the first one
                unfit: SettingsError | None = None
                for frame in chain((first,), chosen):
                    try:
                        coded.write(frame)
                    except SettingsError as error:
                        if not source.live or not coded.frames:
                            raise
                        if unfit is None:
                            logger.warning("%s: %s; its frames are left out", source.label, error)
                        left_out, unfit = left_out + 1, error
                        continue
                    if self.learn:
                        encoder.learn(self.learn)
                    tick()
                coded.close()
            # A live source without --frames ends only by a signal, so this recording is complete.
            part = frames is not None and stopped() and coded.frames < frames if source.live else watched.cut
            if part:
                output.only_part()
        say_unkept(source.label, source.counts, short)
        _tell(output.kept or out, coded, _coded_before(source, selection), as_json)
        if part:
            raise remaining.stopped(
                out, output.kept, coded.frames, skip=selection.skip, frames=frames, live=source.live
            )
        if unfit is not None:
            raise SourceError(f"{left_out} frames of another sensor were left out: {unfit}")
        return coded


def _encoder(codec: str | None, pairs: list[str], learn: int) -> StreamEncoder:
    encoder = StreamEncoder(check_offline(one_setting(codec, pairs)))
    if learn:
        encoder.learn(0)
    return encoder


def _as_it_is(
    spec: str, codec: str | None, pairs: list[str], learn: int, calibration: Path | None, poses: Path | None
) -> RecordingSource | None:
    """The recording whose messages are kept as they are, because nothing was asked of them; else None."""
    if codec or pairs or learn or calibration or poses:
        return None
    parsed = parse(spec, SCHEMES)
    if kind_of(parsed) != "recording":
        return None
    source = RecordingSource.from_spec(parsed, None)
    return source if source.channel == "messages" else None


def _coded_before(source: PacketSource, selection: Selection) -> int | None:
    """Bytes of the messages that were coded again, 0 if only some of them were; None if they were packets."""
    if not isinstance(source, RecordingSource) or source.channel != "messages":
        return None
    return source.coded_bytes if selection == Selection() else 0


def _tell(kept: Path, coded: CodedRecording, again: int | None, as_json: bool) -> None:
    """Print what was written. again: as of `CodedRecording.summary`"""
    size = kept.stat().st_size if kept.is_file() else None
    found = Converted(
        output=str(kept), form="recording", files=1, beside=[], frames=coded.frames, packets=coded.packets,
        points=None, positions=coded.positions, bytes=size, coded_bytes=coded.coded, left_out=coded.left_out,
        returns_percent=coded.losses.kept_percent, largest_error_m=coded.losses.largest_error_m,
        intensity_rms=coded.losses.intensity_rms,
    )  # fmt: skip
    if again is None:
        found["packet_bytes"] = coded.payload_bytes
    elif again:
        found["source_coded_bytes"] = again
    if size_before := coded.payload_bytes if again is None else again:
        found["ratio"] = size_before / max(coded.coded, 1)
    if coded.refinement_bytes:
        found["refinement_bytes"] = coded.refinement_bytes
    clouds = f"; with clouds the file has {size:,}" if coded.clouds and size is not None else ""
    tell(found, f"{kept}: {coded.summary(again)}{clouds}", as_json)


def missed_target(settings: StreamSettings, coded: CodedRecording) -> str | None:
    """The error text if a recording exceeds its target bitrate, or keeps it only by frames that were left out because
    of what was set; None otherwise."""
    if not isinstance(settings.target_kbps, int | float) or not coded.seconds:
        return None
    kbps, names = coded.coded * 8 / coded.seconds / 1e3, pinned(settings)
    if kbps <= settings.target_kbps * (1.0 + TOLERANCE) and not (names and coded.left_out):
        return None
    needed, without = kbps, ""
    if coded.left_out:
        needed *= coded.frames / max(coded.frames - coded.left_out, 1)
        without = f"{coded.left_out} of {coded.frames} frames were left out, and "
    set_here = f"you have set {', '.join(names)}; " if names else ""
    return (
        f"the target of {settings.target_kbps:g} kbit/s was missed: {without}about {needed:.0f} kbit/s are needed "
        f"for all frames ({set_here}choose a higher target, or fewer settings); with --allow-missed the exit code is 0"
    )
