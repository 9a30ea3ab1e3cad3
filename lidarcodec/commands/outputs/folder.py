"""A folder with a file for each frame, of any format of frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from lidarcodec.commands.outputs.base import Cloud, Output
from lidarcodec.frame import Frame


class FolderOutput:
    """Files `000000.EXT` and so on. `timestamps.json` has the host time of each frame in ns."""

    def __init__(self, path: Path, ending: str, opened: Callable[[Path], Output]) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self._folder, self._ending, self._open = path, ending, opened
        self._stamps: dict[str, int] = {}

    def write(self, frame: Frame, cloud: Cloud) -> None:
        name = f"{len(self._stamps):06d}{self._ending}"
        output = self._open(self._folder / name)
        try:
            output.write(frame, cloud)
        except BaseException:
            with suppress(Exception):
                output.close()
            raise
        output.close()
        self._stamps[name] = frame.stamp_ns

    def close(self) -> None:
        (self._folder / "timestamps.json").write_text(json.dumps(self._stamps, indent=1) + "\n")
