"""The job `verify`: reads a segment's recording from the archive and compares it with the input it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidarcodec.archive.jobs.reading import made_from, opened
from lidarcodec.archive.names import Commit, json_of, notes_of
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.segments import Segment, packets_in
from lidarcodec.archive.stores.base import Store
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.evaluation.verdict import broken_promises, missing_parts
from lidarcodec.evaluation.verify import Comparison, PacketsByTime, promise_of
from lidarcodec.files.digest import sha256_of


def verify(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Compare a segment, and note one that is whole as `verified/SEGMENT-LISTED-compared.json`.

    value: `commit` (fields of Commit), `listed`: id of its recording as it is listed, None if it is not there
    `noted`: whether it was found whole before, without its input

    If the input is not there any more, only checksum and decoding are checked, once; `compared` is 0 then, and the note
    is `verified/SEGMENT-LISTED.json`.
    """
    commit = Commit(*value["commit"])
    found = read_commit(target, commit)
    if value["noted"] and made_from(found, source) is None:
        return {"unchanged": 1, "object": found["object"], "broken": []}
    with scratch_folder() as folder:
        path = folder / "recording.mcap"
        target.download(found["object"], path)
        result = _compared(path, found, source)
    result |= {"segment": commit.segment, "object": found["object"]}
    if not result["broken"] and value["listed"] is not None:
        target.create(notes_of(commit.segment, value["listed"])[result["compared"]], json_of(result))
    return result


def _compared(path: Path, found: dict[str, Any], source: Store) -> dict[str, Any]:
    whole = sha256_of(path) == found["sha256"]
    broken = [] if whole else ["the checksum of the recording is not that of its commit"]
    recorded, comparison = RecordedFrames(path), Comparison()
    one = made_from(found, source)
    if one is None:
        frames = sum(1 for _ in recorded)
    else:
        with opened(source, one) as packets:
            given = PacketsByTime(packets_in(packets.packets(), Segment.of(found["range"])))
            for frame in recorded:
                message = recorded.message
                comparison.add(frame, given, None if message is None else promise_of(message))
            comparison.finish(given)
            coverage = given.coverage()
        frames = comparison.frames
        if coverage is not None and not coverage.whole:
            broken.append(f"{coverage.source_packets - coverage.packets} packets of the input are missing")
        broken += broken_promises(recorded.settings(), comparison)
    if frames != found["frames"]:
        broken.append(f"it has {frames} frames, and should have {found['frames']}")
    broken += missing_parts(recorded)
    return {"frames": frames, "compared": int(one is not None), "broken": broken}
