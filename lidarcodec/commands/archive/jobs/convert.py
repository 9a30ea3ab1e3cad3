"""The job `convert`: a segment as a capture, a rosbag2, points or images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from lidarcodec.archive.inputs import BAG as METADATA
from lidarcodec.archive.names import Commit, json_of
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.base import Store
from lidarcodec.cloud import second_returns
from lidarcodec.commands.convert.outputs import Bag, Wanted
from lidarcodec.commands.outputs.base import NO_CLOUD
from lidarcodec.commands.outputs.table import FORMS, check_output, opened
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.files.digest import sha256_of
from lidarcodec.sources import open_source

BAG: Final = "rosbag"


def check_form(name: str) -> None:
    """Raise UnknownNameError or MissingExtraError if a format cannot be written."""
    if name == BAG:
        return
    if name not in FORMS:
        raise UnknownNameError("format", name, (BAG, *FORMS))
    check_output(_path(Path("archive"), name), FORMS[name], force=True)


def stem_of(form: str, commit: Commit) -> str:
    """Names of what a segment becomes begin so. `STEM.json` is created last: it names the files."""
    return f"{form}/{commit.vehicle}/{commit.sensor}/{max(0, commit.first_ns):020}-{commit.segment}"


def convert(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Write a segment in another format. value: `commit` (fields of Commit), `as`: name of the format

    A format with a file for each frame gives a folder. Points are those of first returns; the others are counted.
    Raises SourceError if the recording is damaged, OSError.
    """
    commit, form = Commit(*value["commit"]), value["as"]
    found, stem = read_commit(source, commit), stem_of(value["as"], Commit(*value["commit"]))
    with scratch_folder() as folder:
        recording = folder / "recording.mcap"
        source.download(found["object"], recording)
        if sha256_of(recording) != found["sha256"]:
            raise SourceError(f"{found['object']} is damaged: its checksum is not the one that was written with it")
        out = _path(folder / "drive", form)
        frames, second = _bag(recording, out) if form == BAG else _frames(recording, out, form)
        if frames < found["frames"] and form != BAG:
            raise SourceError(f"{found['object']} has {found['frames']} frames, of which {frames} can be decoded")
        names = []
        for path, name in _files(out, stem):
            target.create(name, path)
            names.append(name)
    target.create(f"{stem}.json", json_of({"source": found["object"], "files": names}))
    return {"frames": found["frames"], "second_returns_left_out": second}


def _path(path: Path, form: str) -> Path:
    """Where to write: a file, or a folder."""
    alone = form != BAG and not FORMS[form].only_each and form not in ("pcd", "ply", "pcd-compressed")
    return path.with_suffix(FORMS[form].ending) if alone else path


def _frames(recording: Path, out: Path, name: str) -> tuple[int, int]:
    """Write decoded frames. Returns their number, and that of the second returns left out."""
    form, count, second = FORMS[name], 0, 0
    with opened(out, form, out) as writer:
        for frame in RecordedFrames(recording):
            writer.write(frame, frame.cloud() if form.points else NO_CLOUD)
            count += 1
            second += second_returns(frame) if form.first_returns else 0
    return count, second


def _bag(recording: Path, out: Path) -> tuple[int, int]:
    """The packets of a recording as scans in a rosbag2."""
    out.mkdir()
    name = f"{out.name}_0.mcap"
    with open_source(recording) as source, (out / name).open("wb") as file:
        bag = Bag(Wanted("rosbag"), file, source)
        for packet in source.packets():
            bag.write(packet)
        bag.close()
    (out / METADATA).write_text(bag.writer.metadata(name))
    return 0, 0


def _files(out: Path, stem: str) -> Iterator[tuple[Path, str]]:
    if not out.is_dir():
        yield out, stem + out.suffix
        return
    for path in sorted(out.iterdir()):
        yield path, f"{stem}/{path.name}"
