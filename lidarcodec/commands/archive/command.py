"""The options of `lidarcodec archive`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.archive import ArchiveGot, ArchivePushed, ArchiveRows, ArchiveRun
from lidarcodec.commands.running.ending import FAILED
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, CodecName, Force, Pairs
from lidarcodec.commands.signatures.selecting import WhichReturns

app = typer.Typer(
    help="Compress, find and fetch recordings of a fleet, in a folder or in object storage (s3:// gs:// az://).",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ArchiveName = Annotated[
    str, typer.Argument(metavar="ARCHIVE", show_default=False, help="A folder, or s3://BUCKET/PREFIX, gs://, az://.")
]


@app.command()
@prints(ArchiveRun)
def run(
    source: Annotated[
        str, typer.Argument(metavar="IN", show_default=False, help="Folder or bucket with captures, recordings, bags.")
    ],
    archive: Annotated[str, typer.Argument(metavar="OUT", show_default=False, help="The archive: folder or bucket.")],
    job: Annotated[
        str,
        Option(
            "--job",
            metavar="NAME",
            help="What to do: compress, verify, recompress, reduce, convert, map, index or stats.",
        ),
    ] = "compress",
    codec: CodecName = None,
    pairs: Pairs = None,
    seconds: Annotated[
        float | None,
        Option("--seconds", min=1.0, max=600.0, metavar="S", help="Length of a segment (compress). Default: 40."),
    ] = None,
    keep_both: Annotated[
        bool,
        Option(
            "--keep-both", help="Also add inputs that are in the archive already, but with other settings (compress)."
        ),
    ] = False,
    workers: Annotated[
        str | None,
        Option(
            "--workers",
            metavar="NAME",
            help="Where tasks run: processes, dask or ray (a cluster), or here (this process). Default: processes.",
        ),
    ] = None,
    processes: Annotated[
        int | None,
        Option(
            "--processes", min=1, max=256, metavar="N", help="Number of processes. Default: one for each processor."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Address of the cluster: tcp://HOST:PORT (Dask), ray://HOST:PORT or HOST:PORT (Ray).",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        Option(
            "--timeout",
            min=1.0,
            metavar="S",
            help="Time limit of a task. Beyond it, the task is ended and tried again. Default: 1800.",
        ),
    ] = None,
    memory: Annotated[
        int | None,
        Option(
            "--memory",
            min=256,
            metavar="MB",
            help="Memory limit of a task. Beyond it, the task is ended and tried again. Default: no limit.",
        ),
    ] = None,
    policy: Annotated[
        Path | None,
        Option("--policy", metavar="FILE", help="Rules in TOML: which settings after how many days (recompress)."),
    ] = None,
    form: Annotated[
        str | None,
        Option("--as", metavar="NAME", help="Format: rosbag, laz, pcd, kitti and others of `convert` (convert)."),
    ] = None,
    before: Annotated[
        str | None, Option("--before", metavar="TIME", help="Only segments that ended before this time (recompress).")
    ] = None,
    delete_old: Annotated[
        bool,
        Option(
            "--delete-old", help="Delete recordings that were replaced, once the new ones are verified (recompress)."
        ),
    ] = False,
    dry_run: Annotated[bool, Option("--dry-run", help="Only print what would be done.")] = False,
    repair: Annotated[
        bool,
        Option(
            "--repair",
            help="First remove unfinished objects, and retry tasks that were set aside. No other run may be active.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Bring everything of IN into the archive OUT. Run it again after an interruption: it continues."""
    from lidarcodec.commands.archive import run as command

    wanted = command.Wanted(
        job, codec, pairs or [], seconds, keep_both, policy, form, before, delete_old, dry_run, repair, workers,
        processes, scheduler, timeout, memory,
    )  # fmt: skip
    if not command.run(source, archive, wanted, as_json):
        raise typer.Exit(FAILED)


@app.command()
@prints(ArchiveRows)
def query(
    archive: ArchiveName,
    sql: Annotated[
        str,
        typer.Argument(metavar="SQL", show_default=False, help="An SQL query of the table `frames`."),
    ],
    as_json: AsJson = False,
) -> None:
    """Ask the index of an archive, such as "select vehicle, count(*) from frames group by vehicle"."""
    from lidarcodec.commands.archive import query as command

    command.run(archive, sql, as_json)


@app.command()
@prints(ArchiveGot)
def get(
    archive: ArchiveName,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            show_default=False,
            help="Packets (.pcap), a recording (.mcap), points (.ply .pcd .las .laz .csv), images (.npz), or a folder.",
        ),
    ],
    vehicle: Annotated[str | None, Option("--vehicle", metavar="NAME", help="Only this vehicle.")] = None,
    sensor: Annotated[str | None, Option("--sensor", metavar="NAME", help="Only this sensor.")] = None,
    first: Annotated[
        str | None, Option("--from", metavar="TIME", help="First time, such as 2026-11-26T12:00:00Z.")
    ] = None,
    last: Annotated[str | None, Option("--to", metavar="TIME", help="Last time.")] = None,
    where: Annotated[
        str | None, Option("--where", metavar="SQL", help="Instead: an SQL condition on the table `frames`.")
    ] = None,
    returns: WhichReturns = "first",
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fetch frames from an archive. Only the bytes that hold them are read."""
    from lidarcodec.commands.archive import get as command

    command.run(archive, out, command.Which(vehicle, sensor, first, last, where), returns, force, as_json)


@app.command()
@prints(ArchivePushed)
def push(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", show_default=False, help="Folder of `publish --record` or `subscribe`.")
    ],
    store: Annotated[
        str, typer.Argument(metavar="STORE", show_default=False, help="A folder or bucket: the IN of `archive run`.")
    ],
    limit: Annotated[
        float | None, Option("--limit", min=0.01, metavar="MBIT", help="Upload at most so many Mbit/s.")
    ] = None,
    delete: Annotated[
        bool, Option("--delete", help="Delete each local recording once its upload was read back and is the same.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Upload the recordings of a vehicle. Run it again after an interruption: it continues."""
    from lidarcodec.commands.archive import push as command

    if not command.run(folder, store, limit, delete, as_json):
        raise typer.Exit(FAILED)
