"""A segment's objects: its recording, its table of frames, and the commit that makes both visible."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidarcodec import wire
from lidarcodec.archive.names import FORMAT, Commit, json_of
from lidarcodec.archive.objects import Place, read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.table import place_of, write_table
from lidarcodec.codecs import table as codecs
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.coded_recording import CodedRecording
from lidarcodec.evaluation.metrics import RangeErrors
from lidarcodec.evaluation.verify import bound_of, promise_of
from lidarcodec.files.digest import sha256_of
from lidarcodec.files.regular import open_regular
from lidarcodec.frame import Frame
from lidarcodec.frame_images import payload_bytes
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.layout import MESSAGE_ENCODING
from lidarcodec.units import RANGE_STEP_M
from lidarcodec.wire.checksum import checksum_of


@dataclass(frozen=True)
class About:
    """What is the same for all frames of a segment.

    about: further plain values for the commit, such as the input
    lost_m: largest allowed and largest measured error of ranges, in metres, that the frames had before they were coded;
        None if it is not known
    """

    vehicle: str
    sensor: str
    origin: str
    segment: str
    about: dict[str, Any]
    lost_m: tuple[float | None, float | None] = (0.0, 0.0)

    @property
    def stream_id(self) -> int:
        """The stream id of the segment's messages: the same at every attempt."""
        return int(self.segment[:16], 16)


@dataclass(frozen=True)
class Product:
    """Files of a segment, not in the store yet. value: contents of the commit"""

    recording: Path
    table: Path
    commit: Commit
    value: dict[str, Any]


class _Rows:
    """Collects the rows of the table while a recording is written. step_m: range step of the sensor"""

    def __init__(self) -> None:
        self.rows: dict[int, dict[str, Any]] = {}
        self.step_m = RANGE_STEP_M

    def compared(self, sent: Frame, decoded: Frame) -> None:
        """Add a frame: as it was encoded, and as it was decoded again."""
        self.step_m = decoded.sensor.range_step_m
        row = place_of(decoded) | {"stamp_ns": decoded.stamp_ns, "frame": decoded.index, "model": decoded.sensor.model}
        row |= {"packets": 0, "packet_bytes": 0, "error_m": None}
        if sent.side is not None:
            row |= {"packets": sent.side.packets, "packet_bytes": payload_bytes(sent)}
        if not decoded.sensor.is_cloud and sent.range.shape == decoded.range.shape:
            errors = RangeErrors(range_step_m=self.step_m)
            errors.add(sent.range * sent.valid, decoded.range)
            row["error_m"] = errors.max_error_m
        self.rows[decoded.index] = row


def write_product(frames: Iterable[Frame], encoder: StreamEncoder, about: About, folder: Path) -> Product:
    """Encode frames into files of a folder. Every message is decoded again and compared.

    Raises SourceError if there is no frame, SettingsError, RoundTripError.
    """
    path, rows = folder / "recording.mcap", _Rows()
    texts = {"segment": about.segment, "source": str(about.about.get("input", ""))}
    with path.open("wb") as file:
        coded = CodedRecording(file, encoder, texts, vehicle=about.vehicle, sensor=about.sensor, compared=rows.compared)
        for frame in frames:
            coded.write(frame)
        coded.close()
    if not coded.frames:
        raise SourceError("it has no frame")
    digest = sha256_of(path)
    names = f"{about.vehicle}/{about.sensor}/{about.segment}-{digest[:16]}"
    fields = {
        "vehicle": about.vehicle,
        "sensor": about.sensor,
        "segment": about.segment,
        "object": f"recordings/{names}.mcap",
    }
    places = []
    for place, more in _messages(path, rows.step_m):
        places.append(place)
        for number in range(place.frames):
            if (row := rows.rows.get(place.frame + number)) is not None:
                row |= {"offset": place.offset, "length": place.length, "bytes": place.length // place.frames,
                        "key": bool(place.key), "checksum": place.checksum, **more, **fields}  # fmt: skip
    complete = [row for _, row in sorted(rows.rows.items()) if "offset" in row]
    lost = {}
    for name, before_m in zip(("bound_m", "error_m"), about.lost_m, strict=True):
        for row in complete:  # errors of several codings add up at most
            row[name] = None if None in (row[name], before_m) else row[name] + before_m
        values = [row[name] for row in complete]
        lost[name] = None if None in values else max(values)
    stamps = [row["stamp_ns"] for row in complete]
    table = folder / "frames.parquet"
    write_table(complete, table)
    commit = Commit(about.vehicle, about.sensor, min(stamps), max(stamps), about.origin, about.segment)
    value = (
        about.about
        | fields
        | lost
        | {
            "format": FORMAT,
            "origin": about.origin,
            "table": f"frames/{names}.parquet",
            "bytes": path.stat().st_size,
            "sha256": digest,
            "settings": encoder.settings.model_dump(mode="json"),
            "frames": len(complete),
            "packets": coded.packets,
            "positions": coded.positions,
            "packet_bytes": coded.payload_bytes,
            "messages": [list(place) for place in places],
        }
    )
    return Product(path, table, commit, value)


def publish(store: Store, product: Product) -> bool:
    """Put a segment into the store. Returns whether it was this product that became visible.

    The commit is created last and only once. A product that lost the race is removed again, unless its objects are
    those of the winner: equal contents have equal names.
    """
    value, ours = product.value, json_of(product.value)
    store.create(value["object"], product.recording)
    store.create(value["table"], product.table)
    if store.create(product.commit.name, ours):
        return True
    theirs = read_commit(store, product.commit)
    for key in ("object", "table"):
        if theirs[key] != value[key]:
            store.delete(value[key])
    return theirs == value


def _messages(path: Path, step_m: float) -> Iterator[tuple[Place, dict[str, Any]]]:
    """(place, codec and bound) of each message of a recording."""
    with open_regular(path) as file:
        for channel, stored in RecordingReader(file).everything():
            if channel.encoding != MESSAGE_ENCODING:
                continue
            data = stored.data()
            header, message = wire.peek(data), wire.unpack(data)
            promise = promise_of(message)
            bound_m = promise.bound_m
            if bound_m is None and promise.step is not None:
                bound_m = bound_of(promise.step, step_m)
            needs = -1 if header.needs is None else header.needs
            place = Place(
                header.stamp_ns, stored.start, stored.length, checksum_of(data), header.frame_index, header.frame_count,
                int(header.key), needs,
            )  # fmt: skip
            yield place, {"codec": codecs.codec_name(header.codec), "bound_m": bound_m}
