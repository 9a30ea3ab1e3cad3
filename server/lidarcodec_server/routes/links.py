"""`/api/v1/links`: presets of settings for the radio links that carry a stream."""

from __future__ import annotations

from fastapi import APIRouter

from lidarcodec.ratecontrol.presets import PRESETS
from lidarcodec_server.auth import Viewer
from lidarcodec_server.schemas import LinkAnswer, LinkSettings

router = APIRouter(prefix="/api/v1/links", tags=["settings"])


@router.get("")
def links(client: Viewer) -> list[LinkAnswer]:
    """Presets for links. A preset is a few settings: to use it, send its `settings` as the PATCH of a stream's
    settings.
    """
    return [
        LinkAnswer(name=one.name, label=one.label, settings=LinkSettings(**one.settings)) for one in PRESETS.values()
    ]
