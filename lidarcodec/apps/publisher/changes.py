"""Changes: changes the settings of a publisher's stream between two frames, all of them or none."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from lidarcodec.apps.control import Applied, settings_with
from lidarcodec.apps.publisher.coding import Coding
from lidarcodec.apps.publisher.sending import Sending
from lidarcodec.apps.worker.process import START_S as WORKER_START_S
from lidarcodec.codecs import table
from lidarcodec.codecs.other_sensors import check_for
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol.choosing import with_codec
from lidarcodec.settings import StreamSettings

logger = logging.getLogger(__name__)


class Changes:
    """Applies changes of settings one by one. Thread-safe.

    asked:   the settings as requested; the codec may be `auto`
    running: whether the stream has begun and not ended
    tell:    makes the publisher send its status soon
    """

    def __init__(
        self,
        asked: StreamSettings,
        coding: Coding,
        sending: Sending,
        running: Callable[[], bool],
        tell: Callable[[], None],
    ) -> None:
        self.asked = self._own = asked
        self.preparing: str | None = None
        """The codec of a change that waits for its process to start."""
        self._encoder, self._isolation, self._choosing = coding.encoder, coding.isolation, coding.choosing
        self._sending = sending
        self._running, self._tell = running, tell
        self._lock = threading.Lock()
        coding.choosing.when_chosen(self._chosen)

    def change(self, changes: dict[str, Any]) -> Applied:
        """Change some settings. If the new codec needs a process, the old codec encodes until that process is ready.

        Raises SettingsError, UnknownNameError or MissingExtraError; then nothing has changed.
        """
        with self._lock:
            applied = self._change(settings_with(self.asked, changes))
        logger.info("new settings from frame %d on: %s", applied.first_frame, changes)
        return applied

    def reset(self) -> Applied:
        """Return to the settings of the start. Raises as `change`."""
        with self._lock:
            applied = self._change(self._own)
        logger.info("the settings of the start from frame %d on", applied.first_frame)
        return applied

    def _change(self, wanted: StreamSettings) -> Applied:
        asked = check_for(self._sending.sensor, wanted)
        table.check_installed(asked.codec)
        first, key = self._apply(asked, self._choosing.codec_for(asked, self._encoder.settings.codec))
        return Applied(asked, first, key)

    def _chosen(self, asked: StreamSettings, codec: str) -> None:
        """Use the codec chosen for `auto`, unless settings changed meanwhile. Called by the choosing thread."""
        with self._lock:
            if self.asked == asked and self._encoder.settings.codec != codec and self._running():
                self._apply(asked, with_codec(asked, codec))

    def _apply(self, asked: StreamSettings, wanted: StreamSettings) -> tuple[int, bool]:
        """wanted: `asked` with a codec in place of `auto`. If it is refused, nothing changes."""
        try:
            self._prepare(wanted)
            first, key = self._sending.apply(wanted)
        except Exception:
            self._choosing.codec_for(self.asked, self._encoder.settings.codec)
            raise
        self._isolation.changed(wanted.codec)
        self.asked = asked
        return first, key

    def _prepare(self, wanted: StreamSettings) -> None:
        """Wait for the codec's process. Meanwhile the status names the codec, so that receivers also start their
        process.
        """
        if self._isolation.isolated(self._encoder.settings.codec) or not self._isolation.isolated(wanted.codec):
            return
        if not self._running():
            return
        self.preparing = wanted.codec
        self._tell()
        self._isolation.start(wanted.codec)
        end = time.monotonic() + WORKER_START_S
        while not self._isolation.ready(wanted.codec):
            if self._isolation.rests or not self._running() or time.monotonic() > end:
                self.preparing = None
                why = self._isolation.last_failure or "its process is not ready"
                raise SettingsError(f"codec {wanted.codec} cannot be used at the moment: {why}", "codec")
        self.preparing = None


__all__ = ["Changes"]
