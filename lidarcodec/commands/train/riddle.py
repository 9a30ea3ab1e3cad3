"""`lidarcodec train riddle`: trains the networks of codec riddle on recorded or simulated drives."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.fleet import Trained
from lidarcodec.commands.running.telling import prints, tell
from lidarcodec.commands.signatures.common import AsJson, Force
from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import check_free

Names = Annotated[list[str] | None, typer.Argument(metavar="SOURCE", show_default=False)]


@prints(Trained)
def riddle(
    sources: Names = None,
    out: Annotated[
        Path,
        Option(
            "--out",
            metavar="FILE",
            show_default=False,
            help="Weight file to write. FILE.run next to it has the state of the run, to continue it later.",
        ),
    ] = ...,  # type: ignore[assignment]
    holdout: Annotated[
        list[str] | None,
        Option("--holdout", metavar="SOURCE", help="A drive for measuring only. Repeatable."),
    ] = None,
    scans: Annotated[
        list[str] | None,
        Option("--scans", metavar="SOURCE", help="Single scans that do not follow each other. Repeatable."),
    ] = None,
    simulated: Annotated[
        int, Option("--simulated", min=0, metavar="N", help="Also train on N simulated drives of all kinds.")
    ] = 0,
    begin: Annotated[
        str | None,
        Option("--begin", metavar="package|FILE", help="Start from the weights of the package, or of a file."),
    ] = None,
    beside: Annotated[
        bool,
        Option(
            "--beside", help="Also train together with the context models, on drives coded with the weights of --begin."
        ),
    ] = False,
    tiles: Annotated[
        float | None,
        Option(
            "--tiles",
            metavar="SHARE",
            show_default="0.3 to 0.6, by network",
            help="Share of weights that large networks keep, up to 1. A larger share is slower and slightly better.",
        ),
    ] = None,
    size: Annotated[
        str, Option("--size", metavar="NAME[,NAME]", help="Networks to train: small, large, largest.")
    ] = "small,large",
    kind: Annotated[
        str, Option("--kind", metavar="NAME[,NAME]", help="alone: for key frames. expecting: for all others.")
    ] = "alone,expecting",
    steps: Annotated[int, Option("--steps", min=1, metavar="N", help="Training steps of each network.")] = 8000,
    batch: Annotated[int, Option("--batch", min=1, metavar="N", help="Returns in each training step.")] = 8192,
    seed: Annotated[
        int, Option("--seed", min=0, max=2**31, metavar="N", help="The same seed gives the same networks.")
    ] = 1,
    frames: Annotated[
        int | None, Option("--frames", min=1, metavar="N", help="Use at most N frames of each source.")
    ] = None,
    framing: Annotated[
        str, Option("--framing", help="Framing of the stream that will use the networks.")
    ] = "revolution",
    frame_rows: Annotated[
        int,
        Option(
            "--frame-rows", min=1, metavar="N", help="Number of returns to use of each frame, for each quantiser step."
        ),
    ] = 5000,
    passes: Annotated[int, Option("--passes", min=1, metavar="N", help="Go through each source N times.")] = 1,
    units: Annotated[
        str,
        Option(
            "--units",
            metavar="auto|varied|own",
            help="varied: also train for other units of the same sensor. own: only for this unit. auto: "
            "varied for simulated drives.",
        ),
    ] = "auto",
    precision: Annotated[
        str,
        Option("--precision", metavar="float32|mixed", help="mixed: use bfloat16 first, on processors that have it."),
    ] = "float32",
    device: Annotated[str, Option("--device", metavar="NAME", help="auto, cpu, cuda and so on.")] = "auto",
    threads: Annotated[int, Option("--threads", min=1, metavar="N", help="Number of CPU threads.")] = 1,
    licence: Annotated[
        str | None, Option("--licence", metavar="TEXT", help="Licence of the training data, as noted in the file.")
    ] = None,
    force: Force = False,
    date: Annotated[str | None, Option("--date", metavar="TEXT", help="Date, as noted in the file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Train the networks of codec riddle. After a stop, the same command continues."""
    from lidarcodec.commands.sources import check_finite, check_not_input, identity
    from lidarcodec.training import training_module

    runs, run = training_module("runs"), training_module("riddle.run")
    samples = training_module("riddle.samples")
    learned, held, single = tuple(sources or ()), tuple(holdout or ()), tuple(scans or ())
    for spec in (*learned, *held, *single):
        check_finite(spec, frames)
        check_not_input(out, spec)
    learned_from = {identity(spec) for spec in (*learned, *single)}
    if shared := [spec for spec in held if identity(spec) in learned_from]:
        raise SettingsError(
            f"{shared[0]} is given for training and with --holdout: use it for only one of them", "holdout"
        )
    if not out.parent.is_dir():
        raise SettingsError(f"there is no folder {out.parent}", "out")
    check_free(out, force=force)
    runs.limit_threads(threads)
    how = samples.Gathering(seed, frame_rows, passes, frames, framing, units)
    about = {name: text for name, text in (("licence", licence), ("date", date)) if text is not None}
    wanted = run.RiddleRun(
        learned, single, held, simulated, tuple(size.split(",")), tuple(kind.split(",")), steps, batch,
        precision=precision, begin=begin, beside=beside, tiles=tiles, gathering=how, about=about,
    )  # fmt: skip
    weights = run.train(
        wanted, out, device=device, say=lambda line: print(line, file=sys.stderr if as_json else sys.stdout, flush=True)
    )
    networks = weights.provenance["networks"]
    lines = [
        f"{net['network']}: {net['in whole numbers']:.4f} bits a return for the first 5 bits of ranges, "
        "on held-out drives"
        for net in networks
    ]
    lines.append(f"{out}: {len(weights.data)} bytes, weights {weights.name}")
    result = {"output": str(out), "bytes": len(weights.data), "weights": weights.name, "networks": networks}
    tell(result, "\n".join(lines), as_json)
