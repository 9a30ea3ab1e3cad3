"""`lidarcodec fetch`: gets a clip of what a vehicle kept."""

from __future__ import annotations

import logging
import re
import shutil
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any, Final

from lidarcodec.apps.past.clip import write_clip
from lidarcodec.apps.past.fetch import RECORDING, CancelledError, Fetch
from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.apps.past.times import check_quality, span_of
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.running.attending import attended
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.folder_lock import alone_in
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.files.whole import beside, check_free, whole
from lidarcodec.recording.holes import longest_of
from lidarcodec.transport import open_transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.times import rfc_3339, time_ns_of

logger = logging.getLogger(__name__)

PLAN = "plan.json"
BEFORE_NOW: Final = re.compile(r"-[0-9]{1,6}([.][0-9]{1,3})?", re.ASCII)
"""Seconds before now: `-30`."""
ABSENT_S: Final = 3.0
"""After this time without an answer, the command prints that nobody answers."""


def run(
    key: str,
    span: tuple[str, str],
    out: Path,
    quality: str,
    patience_s: float,
    given: Given,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Fetch the clip and write it. What was fetched stays in a folder beside the output until that is written.

    Raises SettingsError, SourceError if there is nothing to fetch, or another fetch into this output runs,
    TransportError, StoppedError after a signal.
    """
    check_quality(quality)
    now_ns = time.time_ns()
    begin, end = (absolute(text, now_ns, field) for field, text in zip(("from", "to"), span, strict=True))
    clip = Clip(StreamKeys.parse(key), *span_of(begin, end, now_ns=now_ns))
    if out.suffix.lower() != ".mcap":
        raise SettingsError(f"{out}: a clip is a recording, so its name must end in .mcap", "out")
    check_free(out, force=force)
    if (begin, end) != span:
        sys.stderr.write(f"the clip is --from {begin} --to {end}; write it so to continue after a cut\n")
    endpoints = endpoints_of(given)
    store = PieceStore(beside(out, ".fetching", folder=True))
    stop = threading.Event()
    with alone_in(store.folder):
        with stoppable(stop.set), open_transport(endpoints, stop=stop) as transport:
            fetch = Fetch(clip, store, store.folder / _plan_name(clip), lambda: transport, patience_s)
            progress = _Progress(fetch, key, patience_s)
            try:
                attended(partial(fetch.run, partial(_check_room, store)), fetch.cancel, stop, progress)
            except CancelledError:
                raise StoppedError from None
        plan = fetch.plan
        with whole(out, force=force) as output:
            written = write_clip(plan, store, output.beside)
        state = fetch.state()
        store.forget(piece.name for piece in plan.pieces)  # those of other clips of this output stay
        (store.folder / _plan_name(clip)).unlink(missing_ok=True)
    for begin_ns, end_ns in plan.gaps():
        logger.warning(
            "the vehicle kept nothing for %.1f s, beginning at %s", (end_ns - begin_ns) / 1e9, rfc_3339(begin_ns)
        )
    if (longest := longest_of(written.holes)) is not None:
        logger.warning(
            "%d frames are missing between those of the clip, because the vehicle did not keep them; the longest hole "
            "is %.1f s, beginning at %s", written.missing, longest.seconds, rfc_3339(longest.from_ns),
        )  # fmt: skip
    if written.frames != state["frames"]:
        logger.warning("the vehicle listed %d frames, and sent %d", state["frames"], written.frames)
    about = {"output": str(out), "bytes": written.bytes, "frames": written.frames}
    about |= {name: state[name] for name in ("bytes_received", "gaps")}
    about |= {"missing": written.missing, "holes": [list(hole) for hole in written.holes]}
    tell(about, _line(about), as_json)


def absolute(text: str, now_ns: int, field: str = "time") -> str:
    """A time as it is, or that of `now`, or so many seconds before it.

    >>> absolute("-30", 1_764_158_430 * 10**9), absolute("2026-11-26T12:00:00Z", 0)
    ('2025-11-26T12:00:00.000Z', '2026-11-26T12:00:00Z')

    Raises SettingsError for what is no time, and for seconds without their minus.
    """
    if BEFORE_NOW.fullmatch(f"-{text}"):
        raise SettingsError(f"'{text}' is not a time: write -{text} for {text} s before now")
    if text != "now" and not BEFORE_NOW.fullmatch(text):
        try:
            time_ns_of(text, field)
        except SettingsError as error:
            raise SettingsError(f"{error}. Also -30 for 30 s before now, and now", field) from None
        return text
    return rfc_3339(now_ns - (0 if text == "now" else int(-float(text) * 1e9)))


def _check_room(store: PieceStore, plan: Plan) -> None:
    """Raises SourceError if the disk has no room for the clip, once as pieces and once as a recording."""
    needed = sum((1 if store.has(piece.name, piece.size) else 2) * piece.size for piece in plan.there)
    free = shutil.disk_usage(store.folder).free
    if needed > free:
        raise SourceError(
            f"the disk has no room for this clip: it needs {needed:,} bytes, and {free:,} are free. Make room, or "
            "fetch a shorter one"
        )


def _plan_name(clip: Clip) -> str:
    return f"{clip.keys.vehicle}_{clip.keys.sensor}_{clip.from_ns}_{clip.to_ns}.{PLAN}"


class _Progress:
    """How far a fetch is. It warns once if nobody has answered for `ABSENT_S`."""

    def __init__(self, fetch: Fetch, key: str, patience_s: float) -> None:
        self._fetch, self._key, self._patience_s = fetch, key, patience_s
        self._since_s: float | None = time.monotonic()

    def __call__(self) -> str:
        state = self._fetch.state()
        if state["listed"] or state["pieces"] or state["waiting"] == RECORDING:
            self._since_s = None
        if self._since_s is not None and time.monotonic() - self._since_s > ABSENT_S:
            self._since_s = None
            logger.warning(
                "nobody has answered for %s yet; waiting for up to %g s. Check the name and --connect, and whether the "
                "vehicle publishes with --keep", self._key, self._patience_s,
            )  # fmt: skip
        if state["waiting"]:
            return f"waits {state['waiting']}"
        if not state["listed"]:
            return "asks what is there"
        return f"{state['bytes_done'] / 1e6:.1f} of {state['bytes'] / 1e6:.1f} MB"


def _line(about: dict[str, Any]) -> str:
    return (
        f"{about['output']}: {about['frames']} frames in {about['bytes']:,} bytes, {about['bytes_received']:,} bytes "
        f"received, {about['missing']} frames missing between them, {len(about['gaps'])} gaps"
    )
