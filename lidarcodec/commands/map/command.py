"""The options of `lidarcodec map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.maps import MapBuilt, MapCompressed, MapExported, MapFetched, MapInfo, MapsServed
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AsJson,
    CalibrationFile,
    Connect,
    Force,
    FrameCount,
    Listen,
    PosesOf,
    SkipCount,
    ZenohConfig,
)

HELP = "Build maps for localisation, make them small, and serve them."
app = typer.Typer(help=HELP, no_args_is_help=True, rich_markup_mode=None)

MapFile = Annotated[Path, typer.Argument(metavar="MAP.lcmap", show_default=False, help="A map of `map build`.")]
Out = Annotated[Path, Option("-o", "--out", metavar="OUT.lcmap", show_default=False, help="The map to write.")]


@app.callback()
def _group() -> None:
    """Build maps for localisation, make them small, and serve them."""


@app.command()
@prints(MapBuilt)
def build(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...", show_default=False, help="Drives. Those without poses are aligned by their overlap."
        ),
    ],
    out: Out,
    poses: Annotated[
        list[Path] | None,
        Option(
            "--poses",
            metavar="FILE",
            help="Poses of the sensor (.npz, TUM or KITTI), once for each SOURCE. Default: those of the simulator or "
            "of the recording, otherwise found by registration.",
        ),
    ] = None,
    mount: Annotated[
        list[str] | None,
        Option(
            "--mount",
            metavar="X,Y,Z,ROLL,PITCH,YAW|FILE",
            help="Where the sensor sits on its vehicle: once, or once for each SOURCE. Without poses, the map then "
            "begins at the vehicle.",
        ),
    ] = None,
    poses_of: PosesOf = None,
    align: Annotated[
        bool,
        Option("--align", help="Poses of each SOURCE are in a frame of its own: align all by their overlap."),
    ] = False,
    start: Annotated[
        list[str] | None,
        Option(
            "--start",
            metavar="X,Y,YAW",
            help="Where the first scan of a SOURCE is in the map, to 5 m and 20 degrees: once for each SOURCE after "
            "the first. It is not searched then.",
        ),
    ] = None,
    origin: Annotated[
        str | None,
        Option(
            "--origin",
            metavar="LAT,LON,HEADING",
            help="Place of the origin of the poses, and the direction of their x axis in degrees clockwise from "
            "north. The map is then in UTM.",
        ),
    ] = None,
    step: Annotated[
        float,
        Option("--step", min=0.001, max=1.0, metavar="M", help="Step of coordinates. It must divide 50 m."),
    ] = 0.02,
    least_seen: Annotated[
        int, Option("--least-seen", min=1, max=255, metavar="N", help="Leave out cells that fewer than N scans hit.")
    ] = 3,
    every: Annotated[int, Option("--every", min=1, max=1000, metavar="N", help="Use every N-th scan.")] = 1,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Build a map of one or several drives: means of 0.2 m cells with normals and counts, without what moves."""
    from lidarcodec.commands.map.build import Asked, run

    asked = Asked(
        sources, out, poses or [], origin, step, least_seen, every, frames, skip, calibration, mount or [], poses_of,
        align, start or [],
    )  # fmt: skip
    run(asked, force, as_json)


@app.command()
@prints(list[MapCompressed])
def compress(
    source: MapFile,
    out: Out,
    keep: Annotated[
        str | None,
        Option("--keep", metavar="P%[,P%...]", help="Share of the points. Several write OUT-20.lcmap ..."),
    ] = None,
    size: Annotated[
        int | None,
        Option("--bytes", min=1000, metavar="N", help="Instead of --keep: keep as many points as fit into N bytes."),
    ] = None,
    by: Annotated[
        str,
        Option(
            "--by",
            metavar="NAME",
            help="greedy, information (smaller errors, more scans lost), random, voxel (means of larger cells), paper "
            "or lp (integer programmes, extra `maps`), or learned (a network).",
        ),
    ] = "greedy",
    weights: Annotated[
        Path | None,
        Option("--weights", metavar="FILE.npz", help="For learned: weights from `train map-points`."),
    ] = None,
    normals: Annotated[bool, Option("--normals/--no-normals", help="Whether to keep normals.")] = True,
    seed: Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="Seed of random choices.")] = 1,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Keep some of the points of a map, so that localisation still works."""
    from lidarcodec.commands.map.compress import Asked, run

    run(Asked(source, out, keep, size, by, weights, normals, seed), force, as_json)


@app.command()
@prints(MapInfo)
def info(source: MapFile, as_json: AsJson = False) -> None:
    """Describe a map."""
    from lidarcodec.commands.map.info import run

    run(source, as_json)


@app.command()
@prints(MapExported)
def export(
    source: MapFile,
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", show_default=False, help="A file that ends in .pcd, .ply or .las."),
    ],
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write the points of a map for other programs."""
    from lidarcodec.commands.map.info import run_export

    run_export(source, out, force, as_json)


@app.command()
@prints(MapsServed)
def serve(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="MAP.lcmap|DIR...", show_default=False, help="Maps, or folders of maps."),
    ],
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Serve the tiles of maps on the network. Files that change are read again. Ctrl-C stops it."""
    from lidarcodec.commands.map.serve import run_serve

    keep_standard_output()
    run_serve(sources, (connect or [], listen or [], zenoh_config), as_json)


@app.command()
@prints(MapFetched)
def fetch(
    name: Annotated[str, typer.Argument(metavar="NAME", show_default=False, help="Name of a served map.")],
    out: Out,
    around: Annotated[
        str | None, Option("--around", metavar="X,Y", help="Only the tiles near this place, in metres in the map.")
    ] = None,
    radius: Annotated[
        float | None,
        Option("--radius", min=0.0, max=1e7, metavar="M", help="Distance around that place. Default: 200."),
    ] = None,
    patience: Annotated[
        float,
        Option("--patience", min=1.0, max=1e6, metavar="S", help="Give up when nobody answers for S s."),
    ] = 60.0,
    force: Force = False,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a map that `map serve` or a server serves, or a part of it. Run it again to continue."""
    from lidarcodec.commands.map.serve import Wanted, run_fetch

    keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    run_fetch(Wanted(name, out, around, radius, patience), given, force=force, as_json=as_json)
