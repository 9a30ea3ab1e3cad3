"""The scenes of scenes.toml, as far as their data is here."""

from __future__ import annotations

import hashlib
import os
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lidarcodec.settings import StreamSettings, settings_from

HERE = Path(__file__).resolve().parent
FRAMING: Final = "packets"
"""Framing of the recorded figures: 348 packets a frame. Programs whose figures have another one say so."""
DATA = Path(os.environ.get("LIDARCODEC_DATA", HERE.parent.parent / "shared" / "data"))


@dataclass(frozen=True)
class Scene:
    """A source to measure on, and what names its bytes."""

    name: str
    spec: str
    calibration: Path | None
    frames: int

    @property
    def data_hash(self) -> str:
        """16 hex digits of the source's bytes; of its description where it is simulated."""
        path = Path(self.spec)
        digest = hashlib.sha256()
        if path.exists():
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        else:
            digest.update(self.spec.encode())
        return digest.hexdigest()[:16]


def _load() -> dict[str, Any]:
    return tomllib.loads((HERE / "scenes.toml").read_text())


def settings() -> list[StreamSettings]:
    """The settings that every scene is measured with."""
    return [settings_from({"framing": FRAMING, **entry}) for entry in _load()["setting"]]


def scenes() -> tuple[list[Scene], list[str]]:
    """Scenes whose data is here, and what is missing of the others."""
    found, missing = [], []
    for entry in _load()["scene"]:
        spec = entry.get("source") or str(DATA / entry["file"])
        if "file" in entry and not Path(spec).exists():
            missing.append(f"{entry['name']}: no {entry['file']} in LIDARCODEC_DATA")
            continue
        calibration = DATA / entry["calibration"] if "calibration" in entry else None
        found.append(Scene(entry["name"], spec, calibration, entry["frames"]))
    return found, missing
