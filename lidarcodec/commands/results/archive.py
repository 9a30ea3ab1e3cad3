"""JSON of `archive` and its subcommands."""

from __future__ import annotations

from typing import Annotated, Any

from typing_extensions import TypedDict


class NotDone(TypedDict):
    """An input or a segment that a run of `archive run` could not do."""

    what: Annotated[str, "name of the input, and which segment of it"]
    why: Annotated[str, "the reason"]


class FoundBroken(TypedDict):
    """A recording that `archive run --job verify` found broken."""

    object: Annotated[str, "name of the recording in the archive"]
    broken: Annotated[list[str], "what is wrong, one sentence each"]


class ArchiveStats(TypedDict):
    """What an archive holds of a vehicle, a sensor and a codec."""

    vehicle: Annotated[str, "its name"]
    sensor: Annotated[str, "its name"]
    codec: Annotated[str, "the codec"]
    segments: Annotated[int, "number of segments"]
    frames: Annotated[int, "number of frames"]
    first_ns: Annotated[int, "time of the first frame, ns since the Unix epoch"]
    last_ns: Annotated[int, "of the last frame"]
    points: Annotated[int | None, "returns"]
    packet_bytes: Annotated[int | None, "bytes of the packets"]
    bytes: Annotated[int | None, "bytes after coding"]
    bound_m: Annotated[
        float | None,
        "largest allowed error of a range, in metres: the sum of all codings since the input; null if one has no bound",
    ]
    error_m: Annotated[
        float | None,
        "largest measured error of a range, in metres: after several codings their sum, which it cannot exceed; null "
        "if one is not known",
    ]


class ArchiveRun(TypedDict):
    """Of `archive run`. Numbers are of this run alone; what earlier runs did is counted in `finished`."""

    job: Annotated[str, "the job"]
    inputs: Annotated[int, "number of inputs, or of segments in the archive"]
    finished: Annotated[int, "those with nothing left to do when the run began"]
    other_settings: Annotated[
        int, "of compress: inputs that are in the archive with other settings, and were left as they are"
    ]
    unfinished: Annotated[
        int,
        "of these: those that are there only in part; of map: squares that changed while they were listed, and 1 if "
        "there are too many",
    ]
    changed: Annotated[int, "of compress: inputs that changed since they were archived, and were archived anew"]
    earlier_aside: Annotated[
        int, "of compress: inputs that an earlier run set aside, whole or in part, and that are not tried again"
    ]
    tasks: Annotated[int, "number of tasks that were done; with --dry-run, that would be begun"]
    segments: Annotated[int, "segments that were written or compared"]
    frames: Annotated[int, "frames in them"]
    packet_bytes: Annotated[int, "bytes of the packets in them"]
    bytes: Annotated[int, "bytes of their recordings"]
    bytes_before: Annotated[int, "of recompress: bytes of the recordings that were replaced, or would be"]
    unchanged: Annotated[
        int,
        "of recompress: segments that had the settings already; of verify: segments without their input that were "
        "found whole before",
    ]
    compared: Annotated[int, "of verify: segments that were compared with their input; it must be there as it was"]
    points: Annotated[int, "of map: points of the maps that were written"]
    second_returns_left_out: Annotated[int, "of convert: second returns, which its points do not hold"]
    joined: Annotated[int, "joined tables that were written"]
    removed: Annotated[int, "joined tables that were removed, because they were not used any more"]
    lost: Annotated[int, "of stats and map: segments whose tables are lost, so that their frames are missing"]
    tried_again: Annotated[int, "tasks that failed and were tried again"]
    done_twice: Annotated[int, "segments that another worker had written meanwhile"]
    repaired: Annotated[dict[str, int], "with --repair: number of removed objects, by kind"]
    aside: Annotated[list[NotDone], "what was set aside in this run"]
    left: Annotated[list[NotDone], "what a store did not allow; the next run tries it again"]
    broken: Annotated[list[FoundBroken], "of verify: broken recordings"]
    stats: Annotated[list[ArchiveStats], "of stats: a row for each vehicle, sensor and codec"]
    dry_run: Annotated[bool, "whether nothing was written"]


class ArchiveRows(TypedDict):
    """Of `archive query`."""

    columns: Annotated[list[str], "names of the columns"]
    rows: Annotated[list[list[Any]], "the rows: numbers, texts, null; times as ISO 8601 in UTC"]
    lost: Annotated[int, "segments whose tables are lost, so that the query could not see their frames"]


class ArchiveGot(TypedDict):
    """Of `archive get`."""

    output: Annotated[str, "path of what was written"]
    frames: Annotated[int, "number of frames in it; in a recording with those that decoding needs"]


class ArchivePushed(TypedDict):
    """Of `archive push`."""

    uploaded: Annotated[int, "recordings that were uploaded"]
    bytes: Annotated[int, "bytes of them"]
    already_there: Annotated[int, "recordings that the store had already"]
    deleted: Annotated[int, "recordings that were deleted here, because the store gave back the same bytes"]
    still_written: Annotated[int, "recordings that a program is writing"]
    unreadable: Annotated[int, "files that are no recordings, or cannot be opened"]
    gone: Annotated[int, "recordings that another program removed meanwhile"]
