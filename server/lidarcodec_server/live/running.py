"""RunningRecording: a recording of the server that is being made, and when it must end."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace

from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec_server.live.shelf import Recording


@dataclass(frozen=True)
class Limits:
    """When a recording ends by itself."""

    max_seconds: float = 3600.0
    max_bytes: int = 4 * 2**30


class RunningRecording:
    """A running recording. `take` is called in the receiver's thread."""

    def __init__(self, recording: Recording, recorder: BackgroundRecorder, limits: Limits) -> None:
        self.recording, self.recorder, self.limits = recording, recorder, limits
        self.stop = asyncio.Event()
        self.began = time.monotonic()
        self.task: asyncio.Task[Recording] | None = None

    def take(self, data: bytes) -> None:
        """Keep a message."""
        self.recorder.message(data)

    def now(self) -> Recording:
        """The recording with its present size and counts."""
        counts = self.recorder.state()["counts"]
        return replace(self.recording, frames=int(counts.get("frames", 0)), size_bytes=int(counts.get("bytes", 0)))

    def over(self) -> str | None:
        """Why it must end; None if it need not."""
        if (lacking := self._lost()) is not None:
            return lacking
        state = self.recorder.state()
        if time.monotonic() - self.began >= self.limits.max_seconds:
            return f"the limit of {self.limits.max_seconds:g} s was reached"
        if int(state["counts"].get("bytes", 0)) >= self.limits.max_bytes:
            return f"the limit of {self.limits.max_bytes} bytes was reached"
        return None

    def lacking(self) -> str | None:
        """Why messages are missing in it; None if none are. The disk refused them or was too slow, or its file was
        lost.
        """
        if (lost := self._lost()) is not None:
            return lost
        if dropped := int(self.recorder.state()["counts"].get("dropped", 0)):
            return f"{dropped} messages were not recorded: the disk was too slow"
        return None

    def _lost(self) -> str | None:
        """Why it cannot continue; None if it can."""
        state = self.recorder.state()
        if state["stopped"] is not None:
            return str(state["stopped"])
        if state["counts"].get("lost files"):
            return "its file was removed, replaced or overwritten during the recording"
        return None
