"""`lidarcodec annotate`: labels the returns of a drive that matter for localisation, to train networks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from lidarcodec.api import read_frames
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_finite, readable
from lidarcodec.errors import SettingsError
from lidarcodec.sources import open_source
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.training.annotate import AnnotationSettings, annotate
from lidarcodec.training.annotation_folder import AnnotationFolder
from lidarcodec.training.identity import identity


def run(
    spec: str,
    out: Path,
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    workers: int,
    as_json: bool,
    **given: Any,
) -> None:
    """Annotate, and print a summary."""
    check_finite(spec, frames)
    if given["refine"] is None:  # poses from files are rarely exact to a centimetre; the simulator's are
        given["refine"] = poses is not None
    chained = given["odometry"] is not None
    given["odometry"] = given["odometry"] or "auto"
    what = f"{readable(spec)} from frame {skip}" + ("" if frames is None else f", {frames} frames")
    folder = AnnotationFolder(out)
    with open_source(spec, calibration=calibration, poses=poses) as source:
        if source.live:
            raise SettingsError(f"{spec} is live and has no end: record it first, then annotate the recording")
        source.sensor.no_cloud("annotate")
        settings = AnnotationSettings(source=what, made_of=identity(source, spec), **given)
        stop = None if frames is None else skip + frames
        known = None if chained else source.poses
        about = annotate(islice(read_frames(source), skip, stop), folder, settings, known, workers, _stage)
        say_unkept(spec, source.counts)
    tell(about | {"folder": str(out)}, f"{_text(about)}\nwritten          {out}", as_json)


@contextmanager
def _stage(name: str, steps: int) -> Iterator[Any]:
    with progress(name, steps or None) as tick:
        yield tick


def _text(about: dict[str, Any]) -> str:
    seconds, frames = about["seconds"], about["frames"]
    shares = ", ".join(f"{name} {share:.1%}" for name, share in about["shares"].items())
    cost = sum(seconds.get(name, 0.0) for name in ("frames", "map", "counts", "labels")) / frames
    return "\n".join(
        [
            f"frames           {frames}, over {about['travelled_m']:.1f} m",
            f"map              {about['map_points']:,} points",
            f"labels           {shares}",
            f"counts           median {about['median_count']:g} beside the road, high above "
            f"{about['median_threshold']:g}",
            f"took             {cost * 1000:.0f} ms a frame, and {seconds.get('trajectory', 0.0):.1f} s for the "
            "trajectory",
        ]
    )
