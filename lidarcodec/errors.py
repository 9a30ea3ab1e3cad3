"""Every error this package raises on purpose.

LidarCodecError
  DecodeError(offset)                 bytes from outside that cannot be decoded
    PacketError                       a payload that is not a packet of the sensor, or of any known one
    HeaderError                       a message header that contradicts itself
      UnsupportedVersionError         another major version, or an unknown codec
        MissingCodecError(extra)      a codec whose optional dependency is not installed; a MissingExtraError as well
    TruncatedError                    fewer bytes than announced
    ChecksumError                     the CRC-32C does not match
    SectionError                      a section whose contents are damaged or contradict the message
    MissingReferenceError(needs)      an inter frame whose key frame or calibration was not received: ask for one
  SettingsError(field)                a setting that is not allowed
  CalibrationError                    a calibration file or table that cannot be used
  UnknownNameError(name, known)       a codec, reducer, sensor or source that does not exist
  MissingExtraError(extra)            an optional dependency that is not installed
  SourceError                         a source that cannot be opened or read
  TransportError                      a network session that cannot be opened or used
  WorkerError(cause, resting)         the process in which a codec runs crashed, hung or could not be started
  RoundTripError                      encoded frames do not decode to the original frames
  TargetMissedError                   encoded frames take more than the target bitrate
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Final

from lidarcodec.units import counted

_REASONS: Final = {
    "string_type": "must be text",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a finite number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "dict_type": "must hold names and values",
    "model_type": "must hold names and values",
    "model_attributes_type": "must hold names and values",
    "list_type": "must be a list",
    "missing": "is missing",
    "extra_forbidden": "does not exist",
}
"""Kinds of errors of pydantic, and what they mean."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """The sentence about a name that does not exist, with the one that was probably meant.

    >>> unknown_name("setting", "code", ["codec", "purpose"])
    "unknown setting 'code': did you mean codec? Otherwise choose one of codec, purpose"
    """
    return f"unknown {kind} '{name}': {one_of(name, known)}"


def one_of(name: str, known: Iterable[str]) -> str:
    """What to write instead of a name that does not exist."""
    names = tuple(known)
    near = get_close_matches(name.lower(), names, 1, 0.75)
    meant = f"did you mean {near[0]}? Otherwise choose" if near else "choose"
    return f"{meant} one of {', '.join(names)}"


def reason_of(error: Mapping[str, Any]) -> str:
    """What is wrong with a value, in words that follow the name of its field.

    error: one of a ValidationError

    >>> reason_of({"type": "less_than_equal", "ctx": {"le": 20.0}, "msg": "Input should be less than or equal to 20"})
    'must be at most 20'
    """
    limits = {"greater_than_equal": ("ge", "at least"), "less_than_equal": ("le", "at most"),
              "greater_than": ("gt", "more than"), "less_than": ("lt", "less than")}  # fmt: skip
    kind, text = str(error["type"]), str(error["msg"])
    if kind in limits:
        name, words = limits[kind]
        return f"must be {words} {error['ctx'][name]:g}"
    if kind == "literal_error":
        return f"must be {error['ctx']['expected']}"
    if kind == "too_short":
        return f"must have at least {counted(error['ctx']['min_length'], 'item')}"
    if kind == "too_long":
        return f"must have at most {counted(error['ctx']['max_length'], 'item')}"
    if kind in _REASONS:
        return _REASONS[kind]
    return text.removeprefix("Value error, ").replace("Input should ", "must ").replace("String should ", "must ")


def sentence_of(field: str, error: Mapping[str, Any]) -> str:
    """What is wrong with a field. error: as of `reason_of`"""
    reason = reason_of(error)
    if reason.startswith(f"{field} "):
        return reason
    return f"{field} {reason}" if reason.startswith(("must ", "is ", "does ")) else f"{field}: {reason}"


def is_panic(error: BaseException) -> bool:
    """Whether a library written in Rust panicked. Its PanicException is not a subclass of Exception."""
    return type(error).__name__ == "PanicException"


def told(error: BaseException) -> Exception:
    """The error as an Exception: itself, or a LidarCodecError with its text for a panic. Threads report errors so."""
    return error if isinstance(error, Exception) else LidarCodecError(f"a library of native code failed: {error}")


class LidarCodecError(Exception):
    """Base class of every error that this package raises on purpose."""


class DecodeError(LidarCodecError):
    """Bytes from outside that cannot be decoded; `offset` is the byte at which the error was found."""

    def __init__(self, message: str, offset: int = 0) -> None:
        super().__init__(message)
        self.offset = offset


class PacketError(DecodeError):
    """A payload that is not a packet of the sensor, or of any known one."""


class HeaderError(DecodeError):
    """Bytes that do not begin with a message header, or a header that contradicts itself."""


class UnsupportedVersionError(HeaderError):
    """A message of another major version, or of a codec that this build does not know."""


class TruncatedError(DecodeError):
    """Fewer bytes than announced."""


class ChecksumError(DecodeError):
    """The CRC-32C over the message does not match."""


class SectionError(DecodeError):
    """A section of a message whose contents are damaged or contradict the message."""


class MissingReferenceError(DecodeError):
    """A message that needs frame `needs`, which was not received: ask for a key frame."""

    def __init__(self, message: str, needs: int) -> None:
        super().__init__(message)
        self.needs = needs


class SettingsError(LidarCodecError):
    """A setting that is not allowed; `field` names it when it is known."""

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


class CalibrationError(LidarCodecError):
    """A calibration that cannot be read, or does not belong to the sensor."""


class UnknownNameError(LidarCodecError):
    """A name that does not exist; `known` lists those that do."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.name, self.known = name, tuple(known)
        super().__init__(unknown_name(kind, name, self.known))


class MissingExtraError(LidarCodecError):
    """An optional dependency that is not installed; `extra` is the extra that installs it."""

    def __init__(self, what: str, extra: str) -> None:
        self.extra = extra
        super().__init__(f"{what} needs an optional dependency: pip install 'lidarcodec[{extra}]'")


class MissingCodecError(MissingExtraError, UnsupportedVersionError):
    """A message of a codec whose optional dependency is not installed here."""


class SourceError(LidarCodecError):
    """A source of packets that cannot be opened or read."""


class TransportError(LidarCodecError):
    """A network session that cannot be opened or used."""


class WorkerError(LidarCodecError):
    """The process in which a codec runs crashed, hung, or could not be started. The next one begins with a key frame.

    cause: what happened, such as `killed by SIGSEGV`; resting: it failed too often, the next one starts after a pause.
    """

    def __init__(self, message: str, cause: str, *, resting: bool = False) -> None:
        super().__init__(message)
        self.cause, self.resting = cause, resting


class TargetMissedError(LidarCodecError):
    """Encoded frames take more than the target bitrate, because of pinned settings or of the scene."""


class RoundTripError(LidarCodecError):
    """Encoded frames do not decode to the original frames within the bounds of the settings: a fault of the codec."""
