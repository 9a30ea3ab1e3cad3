"""`lidarcodec demo`: runs the whole system on this machine, with its page."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from lidarcodec.apps.demo.processes import PageServer
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.transport.endpoints import free_port


def run(
    seconds: float | None,
    source: str,
    codec: str | None,
    pairs: list[str],
    calibration: Path | None,
    *,
    port: int | None,
    browser: bool,
    as_json: bool = False,
) -> None:
    """Run the demonstration, and print a summary."""
    meeting_port = free_port()
    with PageServer(port, meeting_port) as server:  # started first, because it takes longest to load
        from lidarcodec.apps.demo.demo import Demo
        from lidarcodec.commands.settings import one_setting

        one_setting(codec, pairs)  # checked here, so that an error is one line
        words = [*(["--codec", codec] if codec else []), *(word for pair in pairs for word in ("--set", pair))]
        words += ["--calibration", str(calibration)] if calibration else []
        demo = Demo(source, seconds, words, browser=browser, out=sys.stderr if as_json else None)
        with stoppable(demo.interrupt):
            figures = demo.run(server, meeting_port)
        if as_json:
            about = {"source": source, "page": demo.address, "picture": demo.saved}
            tell(about | dataclasses.asdict(figures), "", as_json)
