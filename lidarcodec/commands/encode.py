"""`lidarcodec encode`: a source into a recording."""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path

from lidarcodec.commands.coded_recording import CodedRecording
from lidarcodec.commands.progress import progress
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.sources import check_finite, check_not_input, readable
from lidarcodec.commands.stopping import stoppable
from lidarcodec.commands.unkept import say_unkept
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.pipeline import StreamEncoder, check_offline, frames_of
from lidarcodec.sources import open_source
from lidarcodec.sources.posed import with_poses


def run(
    spec: str,
    out: Path,
    codec: str | None,
    pairs: list[str],
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    clouds: bool = False,
    learn: int = 0,
) -> None:
    """Encode frame by frame; a signal ends it behind a whole frame, with a recording that reads."""
    if out.suffix.lower() != ".mcap":
        raise SettingsError(f"encode writes a recording: let {out} end in .mcap")
    encoder = StreamEncoder(check_offline(one_setting(codec, pairs)))
    if learn:
        encoder.learn(0)
    check_finite(spec, frames, live_too=False)
    check_not_input(out, spec)
    with (
        open_source(spec, calibration=calibration, poses=poses) as source,
        stoppable(source.close if source.live else None) as stopped,
    ):
        about = {"source": readable(spec), "calibration": f"{source.sensor.origin} {source.sensor.hash}"}
        cut = with_poses(
            frames_of(source.packets(), source.sensor, encoder.settings.framing, source.counts),
            source.poses if poses else None,
        )
        chosen = islice(cut, skip, None if frames is None else skip + frames)
        first = next(chosen, None)
        if first is None and stopped():
            return
        if first is None:  # before the file is opened: what stood there stays
            raise SourceError(f"{spec} has no frame behind the first {skip}: nothing was encoded")
        with out.open("wb") as handle, progress("encoding", frames) as tick:
            coded = CodedRecording(handle, encoder, about, clouds=clouds)
            try:
                for frame in chain((first,), chosen):
                    coded.write(frame)
                    if learn:
                        encoder.learn(learn)
                    tick()
                    if stopped():
                        break
            except BaseException:
                coded.leave()
                raise
            coded.close()
        say_unkept(source.label, source.counts)
    print(f"{out}: {coded.summary()}" + clouds * f"; with clouds the file has {out.stat().st_size:,}")
