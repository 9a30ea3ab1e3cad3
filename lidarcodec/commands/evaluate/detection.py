"""`lidarcodec evaluate detection`: compares codecs and settings by what is left of labelled objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, interrupted_after
from lidarcodec.commands.running.telling import tell, terminal_width
from lidarcodec.commands.settings import sweep
from lidarcodec.commands.sources import check_finite
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.detection.detector.network import SHIPPED, read_network
from lidarcodec.evaluation.detection.evaluate import Detection, Result
from lidarcodec.evaluation.detection.labels import read_labels
from lidarcodec.evaluation.detection.report import text_tables
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.pipeline import check_offline
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.spec import parse


def run(
    source: str,
    *,
    codecs: str | None,
    pairs: Sequence[str],
    recordings: Sequence[Path],
    labels: Path | None,
    camera: Path | None,
    first_label: int,
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    detector: str,
    seed: int,
    as_json: bool,
) -> None:
    """Measure every setting and print the results. If stopped, print the finished ones."""
    check_finite(source, frames)
    simulated = parse(source).scheme == "sim"
    if labels is None and not simulated:
        raise SettingsError(f"{source} has no labels: give them with --labels FILE", "labels")
    if labels is None and (camera is not None or first_label):
        raise SettingsError("--camera and --first-label belong to --labels FILE", "labels")
    settings = _settings(codecs, pairs, recordings)
    network = (
        None if detector == "none" else read_network(SHIPPED if detector == "shipped" else Path(detector), detector)
    )
    for path in recordings:  # one that cannot be read ends the command before anything is measured
        RecordedFrames(path)
    known = None if labels is None else read_labels(labels, camera)
    results: list[dict[str, Any]] = []
    wanted = 1 + len(settings) + len(recordings)
    with suppress(KeyboardInterrupt):
        with progress(f"reading {source}", frames) as tick:
            drive = Detection(
                source, known, first_label=first_label, frames=frames, skip=skip, calibration=calibration, poses=poses,
                seed=seed, detector=network, tick=tick,
            )  # fmt: skip
        results.append(drive.original())
        for name, measure in _jobs(drive, settings, recordings):
            with progress(f"{name} ({len(results)} of {wanted - 1})", len(drive.frames)) as advance:
                drive.tick = advance
                results.append(measure())
    part = len(results) < wanted
    end: list[dict[str, Any]] = [interrupted_after(len(results), wanted)] if part else []
    if as_json or results:
        tell(results + end, text_tables(results, terminal_width()) if results else "", as_json)
    if part:
        raise StoppedError(f"stopped: the output has only {len(results)} of {wanted} settings")


def _settings(codecs: str | None, pairs: Sequence[str], recordings: Sequence[Path]) -> list[StreamSettings]:
    if codecs is None and not pairs and recordings:
        return []
    return [check_offline(chosen) for chosen in sweep(codecs, list(pairs))]


def _jobs(
    drive: Detection, settings: Sequence[StreamSettings], recordings: Sequence[Path]
) -> list[tuple[str, Callable[[], Result]]]:
    coded = [(chosen.codec, partial(drive.setting, chosen)) for chosen in settings]
    return [*coded, *((str(path), partial(drive.recording, path)) for path in recordings)]
