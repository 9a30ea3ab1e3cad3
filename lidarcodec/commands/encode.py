"""`lidarcodec encode`: a source into a recording."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from lidarcodec.commands.progress import progress
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.sources import check_finite
from lidarcodec.commands.stopping import stoppable
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingWriter
from lidarcodec.sources import open_source
from lidarcodec.units import PACKET_BYTES
from lidarcodec.wire import pack

VEHICLE, SENSOR = "vehicle", "lidar"


def run(
    spec: str,
    out: Path,
    codec: str | None,
    pairs: list[str],
    frames: int | None,
    skip: int,
    calibration: Path | None,
) -> None:
    """Encode frame by frame; a signal ends it behind a whole frame, with a recording that reads."""
    if out.suffix.lower() != ".mcap":
        raise SettingsError(f"encode writes a recording: let {out} end in .mcap")
    encoder = StreamEncoder(one_setting(codec, pairs))
    check_finite(spec, frames, live_too=False)
    count = packets = coded = 0
    with open_source(spec, calibration=calibration) as source, out.open("wb") as handle:
        about = {"source": spec, "calibration": f"{source.sensor.origin} {source.sensor.hash}"}
        wake = source.close if source.live else None
        with (
            RecordingWriter(handle, VEHICLE, SENSOR, encoder.settings, about) as writer,
            progress("encoding", frames) as tick,
            stoppable(wake) as stopped,
        ):
            cut = frames_of(source.packets(), source.sensor, encoder.settings.framing)
            for frame in islice(cut, skip, None if frames is None else skip + frames):
                for message in encoder.encode(frame):
                    writer.write(data := pack(message))
                    coded += len(data)
                count += 1
                packets += frame.side.packets if frame.side else 0
                tick()
                if stopped():
                    break
            for message in encoder.flush():
                writer.write(data := pack(message))
                coded += len(data)
    if not count:
        raise SourceError(f"{spec} has no frame behind the first {skip}: nothing was encoded")
    size = packets * PACKET_BYTES
    print(f"{out}: {count} frames, {size:,} bytes of packets in {coded:,} bytes, ratio {size / coded:.2f}")
