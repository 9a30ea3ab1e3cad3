"""A clip is called exact, so every frame of it is; and one that the disk cannot hold is not begun."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from lidarcodec.apps.past.clip import write_clip
from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.commands.fetch import _check_room
from lidarcodec.errors import SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.recording import RecordingWriter
from lidarcodec.recording.pieces import pieces_in, read_piece
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack
from tests.apps.past.kept_drive import KEYS, at, frames


def fetched(folder: Path, settings: StreamSettings) -> tuple[Plan, PieceStore]:
    """A clip that came from a folder with these settings: a recording of another run lies there, or a vehicle lies."""
    recorded = folder / "kept.mcap"
    encoder = StreamEncoder(settings)
    with recorded.open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for frame in frames(2):
            for message in encoder.encode(frame):
                writer.write(pack(message))
    store = PieceStore(folder / "pieces")
    pieces = pieces_in(recorded)
    for piece in pieces:
        store.add(piece.name, 0, read_piece(recorded, piece))
        assert store.finish(piece.name)
    return Plan(Clip(KEYS, at(0), at(2)), pieces, listed=True), store


@pytest.mark.parametrize(
    "settings",
    [
        {"codec": "pcodec", "max_error_m": 0.05},
        {"codec": "pcodec", "intensity": "off"},
        {"codec": "zstd", "reduction": "columns:2"},
        {"codec": "jpeg"},
    ],
    ids=str,
)
def test_frames_that_are_not_exact_are_no_clip(tmp_path: Path, settings: dict[str, object]) -> None:
    plan, store = fetched(tmp_path, StreamSettings.model_validate(settings))
    with pytest.raises(SourceError, match="not exact"):
        write_clip(plan, store, tmp_path / "clip.mcap")


def test_exact_frames_are_a_clip(tmp_path: Path) -> None:
    plan, store = fetched(tmp_path, StreamSettings.model_validate({"codec": "pcodec", "max_error_m": 0}))
    assert write_clip(plan, store, tmp_path / "clip.mcap").frames == 2


def test_a_clip_that_the_disk_cannot_hold_is_refused_before_it_is_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Usage(NamedTuple):
        free: int

    plan, store = fetched(tmp_path, StreamSettings.model_validate({"codec": "pcodec"}))
    needed = sum(piece.size for piece in plan.there)  # the pieces are here already
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(needed))
    _check_room(store, plan)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(needed - 1))
    with pytest.raises(SourceError, match="the disk has no room for this clip"):
        _check_room(store, plan)
