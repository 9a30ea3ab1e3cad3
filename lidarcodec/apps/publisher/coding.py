"""Coding: the parts of a publisher that turn frames into messages, without a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.choosing import CodecChooser
from lidarcodec.apps.publisher.learning import SpareLearning
from lidarcodec.apps.worker.isolation import Isolate, Isolation
from lidarcodec.errors import WorkerError
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings


class Coding:
    """An encoder, the process that it may run in, the choice of codec `auto`, and learning.

    asked: the settings as requested; interval_s: time between two packets of the source; isolate: as of `Isolation`
    failed: called with the errors of the process; once: takes the errors of learning
    """

    def __init__(
        self,
        asked: StreamSettings,
        interval_s: float,
        isolate: Isolate | None,
        failed: Callable[[WorkerError], None],
        once: Once,
    ) -> None:
        self.isolation = Isolation(isolate, failed)
        self.choosing = CodecChooser(interval_s)
        self.encoder = StreamEncoder(
            self.choosing.codec_for(asked),
            make_encoder=self.isolation.make_encoder,
            make_other=self.isolation.make_other_encoder,
        )
        self.learning = SpareLearning(self.encoder, once)

    @property
    def codec(self) -> str:
        """The current codec."""
        return self.encoder.settings.codec

    def start(self) -> None:
        """Start the codec's process, if it has one."""
        self.isolation.start(self.codec)

    def close(self) -> None:
        """End threads and processes. A second call does nothing."""
        self.choosing.close()
        self.learning.close()
        self.isolation.close()

    def state(self) -> dict[str, Any]:
        """For the status."""
        images = self.encoder.images
        return {
            "codec": self.codec,
            "codec_choice": self.choosing.state(self.codec),
            "rate": self.encoder.rate,
            "images": None if images is None else images._asdict(),
            "reduction": self.encoder.reduction,
            "learning": self.learning.state(),
            "worker": self.isolation.state(),
            "worker_restarts": self.isolation.restarts,
        }
