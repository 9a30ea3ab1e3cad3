"""JSON of `info`, `doctor` and `health`. Names of some fields of `info` are the words of its text, with spaces."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from typing_extensions import TypedDict


class SourceInfo(TypedDict):
    """Of `info SOURCE`. Fields that a sensor lacks are left out."""

    source: Annotated[str, "the source, as it was given"]
    what: Annotated[str, "what it is: a capture, a recording, a sensor"]
    sensor: Annotated[str, "name of the sensor"]
    model: Annotated[str, "name of the model, as in `--model`"]
    calibration: Annotated[dict[str, str], "its `origin` and its `hash`"]
    note: NotRequired[Annotated[str, "what it means that the unit has no calibration of its own, and what to do"]]
    packets: Annotated[int, "number of packets; position packets are counted apart"]
    frames: Annotated[float | int, "number of turns"]
    short_turns: NotRequired[
        Annotated[
            list[dict[str, Any]],
            "turns that lack columns, an object each: number of the `turn`, from 0; its `columns`; the columns "
            "`missing`, and where (`gaps_deg`); whole turns missing before or in it (`turns_before`) if there are any",
        ]
    ]
    not_sent: NotRequired[Annotated[str, "what the sensor does not send in any turn, as it is set"]]


class RecordingInfo(TypedDict):
    """Of `info RECORDING`. `messages 0 to N` has the first messages, one object each; `damaged` the damaged ones."""

    recording: Annotated[str, "path of the recording"]
    metadata: Annotated[dict[str, str], "notes in the recording: vehicle, sensor, source, settings"]
    sensor: NotRequired[Annotated[str, "name of the sensor"]]
    model: NotRequired[Annotated[str, "name of the model, as in `--model`"]]
    rows: NotRequired[Annotated[int, "number of its lasers or channels"]]
    messages: Annotated[int, "number of messages"]
    frames: Annotated[
        int | None,
        "number of frames in them, without those of damaged messages. By their numbers, `missing frames` lie between "
        "them. `longest hole` says where most time is missing. Null if it holds raw packets",
    ]
    holds: NotRequired[Annotated[str, "of raw packets: that it holds no frames yet, and how it is read"]]
    begins: Annotated[str | None, "time of the first message or raw packet; null without any"]
    duration_s: Annotated[float | None, "seconds from the first to the last message or raw packet"]
    codecs: Annotated[dict[str, int], "number of messages of each codec"]
    sent: NotRequired[
        Annotated[
            dict[str, Any],
            "what its messages say was sent: `columns_percent` of columns; `least_bound_m` and `largest_bound_m` of "
            "ranges; numbers of frames: `without_bound`, `reduced` by a choice of returns, and by how `intensity` was "
            "sent. `measured`: what `encode` measured of all frames, as it prints it",
        ]
    ]
    noticed: Annotated[dict[str, int], "damage that was noticed, by kind"]
    refinements: NotRequired[Annotated[int, "of two layers: refinements; `bytes of refinements` has their size"]]


class MessageInfo(TypedDict):
    """Of `info RECORDING --message N`. `from the first byte` has an object for each part of it."""

    message: Annotated[int, "number of the message"]
    bytes: Annotated[int, "its size"]


class Check(TypedDict):
    """One check of `doctor`."""

    name: Annotated[str, "what was checked"]
    state: Annotated[Literal["good", "warning", "bad"], "`bad` if something does not work, `warning` if it may not"]
    found: Annotated[str, "what was found"]
    remedy: Annotated[str, "what to do about it; empty if it is good"]


class Doctor(TypedDict):
    """Of `doctor`, and of `info` without a source."""

    checks: Annotated[list[Check], "what was checked, in order: name, state, found and remedy of each"]
    versions: Annotated[dict[str, str], "versions of this package, Python, the system, and required packages"]
    extras: Annotated[dict[str, str], "`installed`, or the packages that are missing, for each extra"]
    ports: Annotated[dict[str, str], "state of the ports of sensor, network and server, and of the receive buffer"]
    clock: Annotated[dict[str, str], "time of this machine, and whether it is synchronised"]
    settings: Annotated[dict[str, str], "settings in effect for `publish`, and where each comes from"]
    environment: Annotated[dict[str, str], "variables of lidarcodec that are set"]


class Health(TypedDict):
    """Of `health`. If it is not well, the exit code is 1."""

    well: Annotated[bool, "whether the publisher or the server works"]
    wrong: Annotated[list[str], "what is wrong, a sentence each"]


class Interrupted(TypedDict):
    """The last object of a list if a signal ended the command."""

    complete: Annotated[Literal[False], "always false"]
    interrupted: Annotated[Literal[True], "always true"]
    done: Annotated[int, "number of finished measurements"]
    wanted: Annotated[int, "number of measurements that were asked for"]
