"""Checks data of vehicles before it is used or passed on: status, settings and answers.

Any program on the network can send a status. `read_status` keeps the fields that docs/live.md lists, if they have the
right type and size. It drops and counts everything else, so browsers, logs and metrics get only expected values.

>>> told = read_status(b'{"fps": 10.0, "kbps": "much", "colour": "red"}')
>>> told.status, told.dropped
({'fps': 10.0}, 2)
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from lidarcodec.apps.reports import COUNTED, COUNTED_TIMES, MEASURED, SUMMED
from lidarcodec.apps.timings import BOUNDS_MS
from lidarcodec.errors import SettingsError
from lidarcodec.mounting import Mounting
from lidarcodec.ratecontrol.image_curve import MOST_ATTRIBUTES, ImageKind
from lidarcodec.settings import StreamSettings, is_name, settings_from
from lidarcodec.untrusted.json import read_object

MAX_STATUS_BYTES: Final = 64 * 1024
MAX_SETTINGS_BYTES: Final = 8 * 1024
"""Largest settings of a stream as JSON. The settings of all codecs together are a tenth of it."""
MAX_FRAME: Final = 2**63
MAX_NAMES: Final = 64
"""Most names in an object such as `errors`, which has a count for each cause."""
MAX_RECEIVERS: Final = 64
TEXT: Final = 512
"""Most characters of a path, a note or a reason."""
WORD: Final = 64
BUCKETS: Final = len(BOUNDS_MS) + 1


class Told(NamedTuple):
    """status: the known fields;  dropped: number of fields left out, at any depth"""

    status: dict[str, Any]
    dropped: int


class _OtherError(ValueError):
    """A value does not fit its field."""


class _Reader:
    """Reads values and counts the dropped ones."""

    def __init__(self) -> None:
        self.dropped = 0

    def record(self, value: Any, fields: dict[str, Check]) -> dict[str, Any]:
        """The known fields of an object."""
        if not isinstance(value, dict):
            raise _OtherError
        kept: dict[str, Any] = {}
        for name, one in value.items():
            try:
                kept[name] = fields.get(name, _unknown)(self, one)
            except _OtherError:
                self.dropped += 1
        return kept


Check = Callable[[_Reader, Any], Any]
"""Returns the checked value. Raises _OtherError for a wrong type or size."""


def _unknown(_: _Reader, __: Any) -> Any:
    raise _OtherError


def number(_: _Reader, value: Any) -> float:
    """A finite number with an absolute value below 2^63."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        raise _OtherError
    return value


def count(_: _Reader, value: Any) -> int:
    """A whole number from 0 on."""
    if not is_count(value):
        raise _OtherError
    return int(value)


def flag(_: _Reader, value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise _OtherError
    return value


def text(longest: int) -> Check:
    """Text of at most `longest` characters."""

    def check(_: _Reader, value: Any) -> str:
        if not isinstance(value, str) or len(value) > longest:
            raise _OtherError
        return value

    return check


def or_null(of: Check) -> Check:
    """A value of this kind, or null."""
    return lambda reader, value: None if value is None else of(reader, value)


def record(**fields: Check) -> Check:
    """An object with these fields; each of them may be missing."""
    return lambda reader, value: reader.record(value, fields)


def named(of: Check, most: int = MAX_NAMES, longest: int = WORD) -> Check:
    """An object with any names; names beyond `most` are dropped."""

    def check(reader: _Reader, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise _OtherError
        first = dict(list(value.items())[:most])
        reader.dropped += len(value) - len(first)
        return reader.record(first, {name: of for name in first if len(name) <= longest})

    return check


def several(of: Check, most: int, least: int = 0) -> Check:
    """A list of `least` to `most` values."""

    def check(reader: _Reader, value: Any) -> list[Any]:
        if not isinstance(value, list) or not least <= len(value) <= most:
            raise _OtherError
        return [of(reader, one) for one in value]

    return check


def _settings(_: _Reader, value: Any) -> dict[str, Any]:
    settings = known_settings(value)
    if settings is None:
        raise _OtherError
    return settings.model_dump()


def _mount(_: _Reader, value: Any) -> dict[str, float]:
    try:
        return Mounting.of_values(value).values()
    except SettingsError:
        raise _OtherError from None


def _receivers(reader: _Reader, value: Any) -> dict[str, Any]:
    kept: dict[str, Any] = named(_REPORT, MAX_RECEIVERS)(reader, value)
    names = [name for name in kept if is_name(name)]
    reader.dropped += len(kept) - len(names)
    return {name: kept[name] for name in names}


_name, _word, _long = text(WORD), or_null(text(WORD)), or_null(text(TEXT))
_any_number, _any_count = or_null(number), or_null(count)
_times = record(
    **dict.fromkeys(("mean", "p50", "p99", "max", "sum"), _any_number),
    count=count,
    buckets=record(**dict.fromkeys((*(f"{bound:g}" for bound in BOUNDS_MS), "more"), count)),
)
_REPORT = record(
    **dict.fromkeys(COUNTED, count),
    **dict.fromkeys((*MEASURED, *SUMMED), _any_number),
    **dict.fromkeys(COUNTED_TIMES, several(count, BUCKETS, BUCKETS)),
)
_FIELDS: Final[dict[str, Check]] = {
    **dict.fromkeys(("vehicle", "sensor", "stream_id"), _name),
    **dict.fromkeys(
        ("packets", "assembled", "replaced", "no_receiver", "left_out", "frames", "messages", "bytes", "key_frames"),
        count,
    ),
    "stamp_ns": number,
    "frame_index": _any_count,
    "settings": _settings,
    "codec": _name,
    "codec_choice": or_null(record(codec=_name, because=text(TEXT), encode_ms=named(number), budget_ms=_any_number)),
    "sensor_model": record(name=_name, model=_name, calibration=text(TEXT), hash=_name, note=_long),
    "mount": or_null(_mount),
    "refinements": or_null(
        record(
            **dict.fromkeys(
                ("frames", "whole", "sent", "arrived", "given_up", "bytes", "no_receiver", "under_way"), count
            )
        )
    ),
    "matching": flag,
    "ended": flag,
    "time_source": record(stamps=_name, sensor=_word, host_minus_sensor_ms=_any_number),
    "fps": _any_number,
    "mean_fps": _any_number,
    "kbps": _any_number,
    "rate": or_null(
        record(
            auto=flag,
            target_kbps=_any_number,
            reachable_kbps=or_null(several(number, 2, 2)),
            limited_by=_word,
            reached=or_null(flag),
            kbps_5s=_any_number,
            max_error_m=number,
            quality=number,
            crf=number,
            intensity=_word,
            step=number,
            frames_left_out=number,
        )
    ),
    "images": or_null(record(spacing=number, attributes=number, range_step_m=number, returns_per_s=number)),
    "reduction": or_null(
        record(
            name=_name,
            returns=_any_count,
            kept=_any_count,
            cell_m=_any_number,
            left_out=_any_count,
            odometry=_word,
            seen_before=or_null(flag),
            unseen=_any_count,
            note=_long,
        )
    ),
    "learning": or_null(
        record(
            **dict.fromkeys(("steps", "samples", "frames_left_out", "updates", "update_bytes"), _any_count),
            seconds=number,
            gain_bits=_any_number,
        )
    ),
    "path": record(capacity_kbps=_any_number, sustained_kbps=_any_number, share=_any_number),
    "encode_ms": _times,
    "put_ms": _times,
    "flight": record(
        receivers=several(_name, MAX_RECEIVERS),
        following=_word,
        because=_word,
        for_s=_any_number,
        refused=named(count),
        arrive_ms=_times,
        **dict.fromkeys(("unproved", "turned_away", "window", "in_flight", "timeouts", "unreported"), count),
    ),
    "errors": named(count, longest=TEXT),
    "preparing": _word,
    "worker": or_null(record(pid=_any_count, state=_name, restarts=count, last_failure=_long)),
    "worker_restarts": count,
    "source": named(count),
    "certificate": or_null(record(state=_name, until=_name)),
    "gate": or_null(
        record(
            **dict.fromkeys(("open", "unfinished", "waiting", "barred", "sessions", "failed"), count),
            **dict.fromkeys(("bytes_in", "bytes_out", "restarts"), count),
            refused=named(count),
            last_barred=_word,
            running=flag,
        )
    ),
    "recording": or_null(record(file=_long, stopped=_long, counts=named(count))),
    "past": or_null(
        record(
            **dict.fromkeys(("max_bytes", "bytes", "marks", "marked_bytes"), count),
            **dict.fromkeys(("from_ns", "to_ns", "marked_ns"), _any_count),
            stopped=_long,
            counts=named(count),
        )
    ),
    "reports": _receivers,
}


def read_status(data: bytes) -> Told:
    """The known fields of a status.

    Raises JsonRefusedError if it is not valid JSON or exceeds its limits.
    """
    reader = _Reader()
    return Told(reader.record(read_object(data, MAX_STATUS_BYTES), _FIELDS), reader.dropped)


def read_answer(data: bytes) -> dict[str, Any]:
    """A vehicle's answer to a query. The caller checks the fields that it uses.

    Raises JsonRefusedError.
    """
    return read_object(data, MAX_STATUS_BYTES)


def known_settings(values: Any) -> StreamSettings | None:
    """Settings that a vehicle reported. Unknown settings of a newer vehicle are dropped. None if they are invalid."""
    if not isinstance(values, dict):
        return None
    known = {name: value for name, value in values.items() if name in StreamSettings.model_fields}
    try:
        check_settings_size(known)
        return settings_from(known)
    except SettingsError:
        return None


_IMAGES: Final = {
    "spacing": (0.1, 64.0),
    "attributes": (0.0, MOST_ATTRIBUTES),
    "range_step_m": (0.0005, 1.0),
    "returns_per_s": (1.0, 1e9),
}
"""What a vehicle may say of its sensor's images, from least to most."""


def images_told(status: dict[str, Any] | None) -> ImageKind | None:
    """What a status says of the images of another sensor than an HDL-64E; None where it says nothing that can be."""
    told = (status or {}).get("images")
    if not isinstance(told, dict) or any(
        not isinstance(told.get(name), int | float) or not least <= told[name] <= most
        for name, (least, most) in _IMAGES.items()
    ):
        return None
    return ImageKind(**{name: told[name] for name in _IMAGES})


def check_settings_size(values: dict[str, Any]) -> None:
    """Check that settings are small and simple enough to be stored, sent and shown.

    Raises SettingsError.
    """
    try:
        read_object(json.dumps(values), MAX_SETTINGS_BYTES)
    except (ValueError, TypeError, RecursionError) as error:
        raise SettingsError(f"the settings are not valid: {error}") from None


def check_names(values: Any) -> None:
    """Check that no setting is the path of a file: clients must not learn which files exist here.

    Raises SettingsError, with the same text whether the file exists or not.
    """
    if isinstance(values, str) and (values.startswith((".", "~")) or any(sign in values for sign in "/\\:\0")):
        raise SettingsError("a setting must be a name, not the path of a file", "codec_settings")
    parts = values.values() if isinstance(values, dict) else values if isinstance(values, list) else ()
    for part in parts:
        check_names(part)


def first_frame(answer: dict[str, Any]) -> int | None:
    """The frame number in an answer; None if it has none."""
    value = answer.get("first_frame")
    return value if is_count(value) else None


def is_count(value: Any) -> bool:
    """Whether a value is a whole number that fits a 64-bit field."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MAX_FRAME
