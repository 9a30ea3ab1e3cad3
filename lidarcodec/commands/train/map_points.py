"""`lidarcodec train map-points`: PointNet for `map compress --by learned`, from maps and what the programme keeps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer
from typer import Option

from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.maps import TrainedMapPoints
from lidarcodec.commands.running.telling import prints, tell
from lidarcodec.commands.selection.numbers import shares_of
from lidarcodec.commands.signatures.common import AsJson, Force
from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import check_free, whole
from lidarcodec.training import training_module

MEASURED: Final = 32
"""Windows that the loss is measured on after each epoch."""


@prints(TrainedMapPoints)
def map_points(
    maps: Annotated[
        list[Path],
        typer.Argument(metavar="MAP.lcmap...", show_default=False, help="Maps of `map build`."),
    ],
    out: Annotated[
        Path, Option("--out", metavar="FILE", show_default=False, help="Checkpoint. An existing one is continued.")
    ],
    weights: Annotated[
        Path, Option("--weights", metavar="FILE.npz", show_default=False, help="Weights for `map compress --weights`.")
    ],
    keep: Annotated[str, Option("--keep", metavar="P%", help="Share of the points that `paper` keeps.")] = "20%",
    note: Annotated[str, Option("--note", help="Training data, as noted in the weights.")] = "unknown maps",
    licence: Annotated[str, Option("--licence", help="Licence of the weights, as noted in them.")] = "unknown",
    epochs: Annotated[int, Option("--epochs", min=1, metavar="N")] = 60,
    batch: Annotated[int, Option("--batch", min=1, metavar="N", help="Windows of 1,024 points in each step.")] = 4,
    seconds: Annotated[
        float | None,
        Option("--seconds", min=1.0, metavar="S", help="Stop after S seconds. The same command continues."),
    ] = None,
    seed: Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="Seed of random choices.")] = 1,
    device: Annotated[str, Option("--device", metavar="NAME", help="auto, cpu, cuda, cuda:1 and so on.")] = "auto",
    threads: Annotated[int, Option("--threads", min=1, metavar="N", help="Number of CPU threads.")] = 1,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Train PointNet on the half of each map where its drives began, and measure it on the other half (extras
    `learned`, `maps`)."""
    from lidarcodec.maps.file import read_map
    from lidarcodec.maps.select.labels import Labelled, alike, labelled
    from lidarcodec.maps.select.learned import scores
    from lidarcodec.maps.select.point_net import LAYERS, Layer, PointNet
    from lidarcodec.maps.select.windows import halves
    from lidarcodec.untrusted.network_weights import packed

    shares = shares_of("--keep", keep)
    if len(shares) > 1:
        raise SettingsError(f"--keep {keep}: give one share only", "keep")
    check_free(weights, force=force)
    training_module("runs").limit_threads(threads)
    training = training_module("train_map_points")
    learnt, held_out = list[Labelled](), list[Labelled]()
    with progress("solving", len(maps)) as tick:
        for path in maps:
            first, second = halves(read_map(path))
            learnt.append(labelled(first, shares[0], seed))
            held_out.append(labelled(second, shares[0], seed))
            tick()
    run = training.PointsRun(seed=seed, epochs=epochs, batch=batch)
    given = [training.Windows.of([half.windows() for half in parts]) for parts in (learnt, held_out)]
    given[1] = given[1].thinned(MEASURED)
    with progress("epochs", epochs) as tick:
        net = training.train_map_points(LAYERS, *given, out, run, device, tick, seconds)
    state = training_module("runs").load_checkpoint(out)
    about = {
        "trained_on": note, "licence": licence, "keep": shares[0], "epochs": state.step, "seconds": round(state.seconds)
    }  # fmt: skip
    layers = {name: Layer(*layer) for name, layer in net.folded().items()}
    with whole(weights, force=force) as output:
        output.beside.write_bytes(packed(layers, about, LAYERS))
    ready = PointNet(layers, about)
    tests = {
        str(path): round(alike(half, scores(half.points, ready)), 4) for path, half in zip(maps, held_out, strict=True)
    }
    lines = [f"{out}, {weights}: {state.step} epochs in {state.seconds:.1f} s"]
    lines += [
        f"{path}: in the other half, {100 * found:.1f} % of the points that `paper` keeps are kept, too"
        for path, found in tests.items()
    ]
    result = {"outputs": [str(out), str(weights)], "epochs": state.step, "seconds": round(state.seconds, 1)}
    tell(result | {"tests": tests, "log": state.log}, "\n".join(lines), as_json)
