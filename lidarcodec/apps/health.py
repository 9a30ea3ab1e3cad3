"""Health: the state of a publisher in a file, for watchdogs that cannot ask over the network.

A publisher that cannot reach its router is healthy. One that hangs, or whose sensor sends nothing, is not. Ages are
measured with CLOCK_MONOTONIC, which is the same for all processes of a machine and never set.

>>> sensor = {"stream": "car-7/roof", "quiet_s": 12.0}
>>> complaints({"monotonic_s": 100.0, "boot": boot(), "sensors": [sensor]}, now_s=100.5)
['car-7/roof: no frame came from the sensor for 12 s']
"""

from __future__ import annotations

import json
import logging
import os
import stat
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from lidarcodec.apps.ending import ended
from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.spare import SpareHandles
from lidarcodec.files.whole import written_whole
from lidarcodec.untrusted.json import JsonRefusedError, read_object

logger = logging.getLogger(__name__)

TELL_S = 1.0
STALE_S = 10.0
"""If a file is older than this, its process hangs or has ended."""
QUIET_S = 10.0
"""Seconds without a frame from the sensor, or without one sent to a connected receiver, that count as a fault."""
MAX_FILE_BYTES = 1 << 20
BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class SensorState:
    """Current state of a sensor.

    assembled, sent: number of frames since it was opened;  failure: why its source ended
    gate: whether the gate in front of the TLS port runs; None without one
    """

    stream: str
    assembled: int = 0
    sent: int = 0
    matching: bool = False
    failure: str | None = None
    gate: bool | None = None

    @classmethod
    def of(cls, status: dict[str, Any]) -> Self:
        """From a publisher's status."""
        stream = f"{status['vehicle']}/{status['sensor']}"
        gate = status.get("gate")
        runs = None if gate is None else bool(gate["running"])
        return cls(stream, status["assembled"], status["frames"], bool(status["matching"]), gate=runs)


class HealthFile:
    """Writes the state once a second. A context manager: it removes the file when it exits normally."""

    def __init__(self, path: Path, states: Callable[[], Sequence[SensorState]]) -> None:
        """states: gives the states of the sensors; called in a thread of this object"""
        self._path, self._states = path, states
        self._stop = threading.Event()
        self._since: dict[str, dict[str, tuple[int, float]]] = {}
        self._thread = threading.Thread(target=self._run, name="lidarcodec health", daemon=True)
        self._complained = False
        self._spare = SpareHandles(1)

    def __enter__(self) -> Self:
        """Raises SettingsError if the file cannot be written, or is not a health file."""
        self._check_place()
        try:
            self._write()
        except LidarCodecError as error:
            raise SettingsError(str(error), "health_file") from None
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        ended([self._thread])
        self._spare.close()
        if self._writer() == os.getpid():  # another publisher may write the file now
            self._path.unlink(missing_ok=True)

    def _check_place(self) -> None:
        """Check that the file is a health file, if it exists.

        Raises SettingsError.
        """
        if not os.path.lexists(self._path):
            return
        writer = self._writer()
        if writer is None:
            text = f"{self._path} exists and is not a health file: choose another name, or remove it"
            raise SettingsError(text, "health_file")
        if writer != os.getpid() and _runs(writer):
            logger.warning("%s is also written by process %d: give each publisher its own health file", self._path,
                           writer)  # fmt: skip

    def _writer(self) -> int | None:
        """Id of the process that wrote the file last; None if there is no health file."""
        try:
            if not stat.S_ISREG(os.lstat(self._path).st_mode):  # reading a pipe would block
                return None
            with open_regular(self._path) as file:
                told = read_object(file.read(MAX_FILE_BYTES + 1), MAX_FILE_BYTES)
        except (OSError, JsonRefusedError):
            return None
        writer = told.get("pid")
        whole = isinstance(writer, int) and not isinstance(writer, bool) and {"monotonic_s", "sensors"} <= told.keys()
        return writer if whole else None

    def _run(self) -> None:
        while not self._stop.wait(TELL_S):
            try:
                self._write()
            except LidarCodecError as error:  # watchdogs see that the file is old
                if not self._complained:
                    logger.warning("%s", error)
                self._complained = True

    def _write(self) -> None:
        now_s = time.monotonic()
        sensors = [self._fields_of(one, now_s) for one in self._states()]
        contents = {"monotonic_s": now_s, "boot": boot(), "pid": os.getpid(), "sensors": sensors}
        with self._spare.lent(), written_whole(self._path, sync=False) as beside:
            beside.write_text(json.dumps(contents) + "\n")

    def _fields_of(self, state: SensorState, now_s: float) -> dict[str, Any]:
        since = self._since.setdefault(state.stream, {})
        unsent_s = self._unchanged_s(since, "sent", state.sent, now_s)
        if not state.matching:  # nothing receives it
            since["sent"] = (state.sent, now_s)
            unsent_s = 0.0
        return {
            "stream": state.stream,
            "assembled": state.assembled,
            "sent": state.sent,
            "matching": state.matching,
            "quiet_s": round(self._unchanged_s(since, "assembled", state.assembled, now_s), 1),
            "unsent_s": round(unsent_s, 1),
            "failure": state.failure,
            "gate": state.gate,
        }

    @staticmethod
    def _unchanged_s(since: dict[str, tuple[int, float]], name: str, value: int, now_s: float) -> float:
        if name not in since or since[name][0] != value:
            since[name] = (value, now_s)
        return now_s - since[name][1]


def boot() -> str | None:
    """Random number of this start of the machine, with which CLOCK_MONOTONIC began; None if it is not known."""
    try:
        return BOOT.read_text("ascii").strip()
    except (OSError, ValueError):
        return None


def _runs(process: int) -> bool:
    """Whether a process with that id exists."""
    if process <= 0:
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def health_file_or_nothing(
    path: Path | None, states: Callable[[], Sequence[SensorState]]
) -> AbstractContextManager[HealthFile | None]:
    """A HealthFile at a path, or a context manager that does nothing without a path."""
    return nullcontext() if path is None else HealthFile(path, states)


def complaints(told: dict[str, Any], now_s: float) -> list[str]:
    """Faults in the contents of a health file, one text each; empty if there are none.

    Raises SourceError if these are not the contents of a health file.
    """
    try:
        age_s = now_s - float(told["monotonic_s"])
        wrong = [f"the publisher has not written its state for {age_s:.0f} s"] if not 0 <= age_s <= STALE_S else []
        if told.get("boot") != boot():
            wrong = ["the publisher has not written its state since the machine was started"]
        for sensor in told["sensors"]:
            quiet_s, unsent_s = float(sensor["quiet_s"]), float(sensor.get("unsent_s", 0.0))
            if sensor.get("failure"):
                wrong.append(f"{sensor['stream']}: {sensor['failure']}")
            elif quiet_s > QUIET_S:
                wrong.append(f"{sensor['stream']}: no frame came from the sensor for {quiet_s:.0f} s")
            elif unsent_s > QUIET_S:
                wrong.append(
                    f"{sensor['stream']}: nothing was sent for {unsent_s:.0f} s, although a receiver is connected"
                )
            elif sensor.get("gate") is False:
                wrong.append(f"{sensor['stream']}: the gate in front of the TLS port does not run")
    except (KeyError, TypeError, ValueError, AttributeError):
        raise SourceError("not a health file") from None
    return wrong


def read(path: Path) -> dict[str, Any]:
    """Contents of a health file.

    Raises SourceError if there is none.
    """
    try:
        with open_regular(path) as file:
            return read_object(file.read(MAX_FILE_BYTES + 1), MAX_FILE_BYTES)
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}; is `lidarcodec publish --health-file {path}` running?") from None
    except JsonRefusedError as error:
        raise SourceError(f"{path} is not a health file: {error}") from None
