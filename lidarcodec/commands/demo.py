"""`lidarcodec demo`: runs the whole system on this machine, with its page."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.apps.demo.processes import PageServer, free_port
from lidarcodec.commands.running.stopping import stoppable


def run(
    seconds: float | None,
    source: str,
    codec: str | None,
    pairs: list[str],
    calibration: Path | None,
    *,
    port: int | None,
    browser: bool,
) -> None:
    """Run the demonstration, and print a summary."""
    meeting_port = free_port()
    with PageServer(port, meeting_port) as server:  # started first, because it takes longest to load
        from lidarcodec.apps.demo.demo import Demo
        from lidarcodec.commands.settings import one_setting

        settings = one_setting(codec, pairs)  # checked here, so that an error is one line
        words = [*(["--codec", codec] if codec else []), *(word for pair in pairs for word in ("--set", pair))]
        words += ["--calibration", str(calibration)] if calibration else []
        demo = Demo(source, seconds, settings, words, browser=browser)
        with stoppable(demo.interrupt):
            demo.run(server, meeting_port)
