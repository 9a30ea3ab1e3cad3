"""The options of `lidarcodec cut`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import CutOut
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, Force, FrameCount, SkipCount
from lidarcodec.commands.signatures.selecting import FromTime, ToTime


@prints(CutOut)
def cut(
    source: Annotated[
        Path, typer.Argument(metavar="IN", show_default=False, help="A recording (.mcap) or a capture (.pcap).")
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", show_default=False, help="A name with the same ending. Parts are OUT-000, OUT-001."
        ),
    ],
    begin: FromTime = None,
    end: ToTime = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    every: Annotated[
        float | None,
        Option("--every", min=0.1, max=1e9, metavar="S", help="Split into parts of S seconds each."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Cut a part out of a recording or a capture, or split it. Messages and packets do not change."""
    from lidarcodec.commands.cut import captures, recordings
    from lidarcodec.commands.cut.parts import Cut
    from lidarcodec.commands.selection.frames import Selection
    from lidarcodec.commands.sources import check_not_input
    from lidarcodec.errors import SettingsError

    ending = out.suffix.lower()
    if ending not in (".mcap", ".pcap") or source.suffix.lower() != ending:
        raise SettingsError(f"cut takes a .mcap or a .pcap file: {source} and {out} must have the same ending")
    selection = Selection(frames, skip, begin, end)
    if not (selection.by_time or frames is not None or skip or every is not None):
        raise SettingsError("nothing to cut: give --from, --to, --skip, --frames or --every", "from")
    if ending == ".pcap" and (frames is not None or skip):
        raise SettingsError("--frames and --skip are for recordings: cut a capture by time, or use convert", "frames")
    check_not_input(out, source)
    wanted = Cut(source, out, selection, None if every is None else round(every * 1e9), force, as_json)
    (recordings if ending == ".mcap" else captures).run(wanted)
