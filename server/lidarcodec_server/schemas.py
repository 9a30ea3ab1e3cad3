"""What the REST interface answers with. The OpenAPI document is made of these."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from lidarcodec.settings import StreamSettings
from lidarcodec_server.fleet import Stream


class StreamAnswer(BaseModel):
    """A stream: who, whether its publisher is there, the settings in force and its last status (docs/live.md)."""

    vehicle: str
    sensor: str
    alive: bool
    settings: StreamSettings | None = Field(description="In force; null before the vehicle said.")
    status: dict[str, Any] | None = Field(description="The last status; null before the first one.")

    @classmethod
    def of(cls, stream: Stream) -> StreamAnswer:
        """From what the service knows."""
        return cls(
            vehicle=stream.keys.vehicle,
            sensor=stream.keys.sensor,
            alive=stream.alive,
            settings=stream.settings,
            status=stream.status,
        )


class Health(BaseModel):
    """Whether a part works; `reason` says why not."""

    ok: bool
    reason: str | None = None
