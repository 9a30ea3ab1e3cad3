"""`lidarcodec join`: joins parts of a drive into one recording or one capture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import Joined
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, Force


@prints(Joined)
def join(
    parts: Annotated[
        list[Path],
        typer.Argument(metavar="PART...", show_default=False, help="Parts in order: all .mcap, or all .pcap."),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", show_default=False)],
    allow_gap: Annotated[
        bool, Option("--allow-gap", help="Also join damaged parts, and parts with missing frames between them.")
    ] = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Join parts of a drive: recordings (.mcap) or captures (.pcap). Messages and packets do not change."""
    from lidarcodec.commands.join import captures, recordings
    from lidarcodec.commands.sources import check_not_input
    from lidarcodec.errors import SettingsError
    from lidarcodec.files.whole import check_free

    ending = out.suffix.lower()
    if ending not in (".mcap", ".pcap") or any(part.suffix.lower() != ending for part in parts):
        raise SettingsError(
            f"join takes only .mcap files or only .pcap files: all parts and {out} must have the same ending"
        )
    if len(parts) < 2:
        raise SettingsError("join needs at least two parts, then OUT")
    for part in parts:
        check_not_input(out, part)
    check_free(out, force=force)
    if ending == ".mcap":
        recordings.run(parts, out, allow_gap, force, as_json)
    else:
        captures.run(parts, out, allow_gap, force, as_json)
