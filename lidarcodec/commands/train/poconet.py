"""`lidarcodec train poconet` and `train scores`: networks that choose returns, from annotated drives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.fleet import TrainedScores
from lidarcodec.commands.running.telling import prints, tell
from lidarcodec.commands.signatures.common import AsJson, Force
from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import check_free
from lidarcodec.training import training_module
from lidarcodec.training.annotation_folder import AnnotationFolder

Drives = Annotated[
    list[Path], typer.Argument(metavar="DIR...", show_default=False, help="Drives labelled by `annotate`.")
]
Out = Annotated[
    Path, Option("--out", metavar="FILE", show_default=False, help="Checkpoint file. An existing one is continued.")
]
Test = Annotated[
    list[Path] | None, Option("--test", metavar="DIR", help="Measure on this drive at the end. Repeatable.")
]
Seed = Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="The same seed gives the same weights.")]
Device = Annotated[str, Option("--device", metavar="NAME", help="auto, cpu, cuda, cuda:1 and so on.")]
Threads = Annotated[int, Option("--threads", min=1, metavar="N", help="Number of CPU threads.")]
Every = Annotated[int, Option("--every", min=1, metavar="N", help="Use every N-th labelled frame.")]
Seconds = Annotated[
    float | None, Option("--seconds", min=1.0, metavar="S", help="Stop after S seconds. The same command continues.")
]


@prints(TrainedScores)
def poconet(
    drives: Drives,
    out: Out,
    test: Test = None,
    epochs: Annotated[int, Option("--epochs", min=1, metavar="N")] = 30,
    batch: Annotated[int, Option("--batch", min=1, metavar="N", help="Scans in each step.")] = 1,
    points: Annotated[
        int | None,
        Option("--points", min=512, metavar="N", help="Points of each scan. Default: 122880 on a GPU, otherwise 8192."),
    ] = None,
    minutes: Annotated[
        float | None,
        Option(
            "--minutes",
            metavar="M",
            help="Train for M minutes instead of --epochs. The learning rate falls in the last fifth.",
        ),
    ] = None,
    validate: Annotated[
        list[Path] | None,
        Option(
            "--validate",
            metavar="DIR",
            help="Measure on this drive every ten minutes, and keep the best network "
            "in NAME.best.pt beside FILE. Repeatable. NAME.curve.csv has what was measured.",
        ),
    ] = None,
    every: Every = 1,
    seconds: Seconds = None,
    seed: Seed = 1,
    device: Device = "auto",
    threads: Threads = 1,
    as_json: AsJson = False,
) -> None:
    """Train PocoNet, the paper's network, on annotated drives (extra `learned`)."""
    training = _begun(drives, [*(test or []), *(validate or [])], threads, "train_poconet")
    run = training.PocoRun(seed=seed, epochs=epochs, batch=batch, points=points, minutes=minutes)
    with progress("steps") as tick:
        net = training.train_poconet(
            drives, out, run, device, tick=lambda *_: tick(), every=every, seconds=seconds, validate=validate or ()
        )  # fmt: skip
    used = run.on(next(net.parameters()).device)["points"]
    _tell([out], {str(drive): training.measure_poconet(net, [drive], used) for drive in test or []}, as_json)


@prints(TrainedScores)
def scores(
    drives: Drives,
    out: Out,
    onnx: Annotated[
        Path | None, Option("--onnx", metavar="FILE", help="Also write the network in the form that `poconet` reads.")
    ] = None,
    note: Annotated[str, Option("--note", help="Training data, as noted in the ONNX file.")] = "unknown drives",
    licence: Annotated[str, Option("--licence", help="Licence of the weights, as noted in the ONNX file.")] = "unknown",
    force: Force = False,
    test: Test = None,
    steps: Annotated[int, Option("--steps", min=1, metavar="N")] = 1300,
    every: Every = 1,
    seconds: Seconds = None,
    seed: Seed = 1,
    device: Device = "auto",
    threads: Threads = 1,
    as_json: AsJson = False,
) -> None:
    """Train the small network of the reducers `poconet` and `poconet-paper` on annotated drives (extra `learned`)."""
    if onnx is not None:
        check_free(onnx, force=force)
    training = _begun(drives, test, threads, "train_scores")
    run = training.ScoreRun(seed=seed, steps=steps)
    with progress("reading"):
        examples = training.examples_of(drives, seed, every)
    with progress("steps", steps) as tick:
        net = training.train_scores(examples, out, run, device, tick=lambda *_: tick(), seconds=seconds)
    if onnx is not None:
        about = {"trained_on": note, "licence": licence} | _described(drives, out)
        training_module("export_scores").export_scores(net, onnx, about, force=force)
    tests = {str(drive): training.measure_scores(net.eval(), [drive]) for drive in test or []}
    _tell([out, *([onnx] if onnx is not None else [])], tests, as_json)


def _begun(drives: list[Path], test: list[Path] | None, threads: int, module: str) -> Any:
    for drive in [*drives, *(test or [])]:
        if not (drive / "annotation.json").is_file():
            raise SettingsError(
                f"{drive} is not an annotated drive: label it first with `lidarcodec annotate`", "drives"
            )
    training_module("runs").limit_threads(threads)
    return training_module(module)


def _described(drives: list[Path], out: Path) -> dict[str, str]:
    """What the ONNX file says besides: the models of the sensors, and how long the training took."""
    run = training_module("runs").load_checkpoint(out)
    models = sorted({AnnotationFolder(drive).sensor.model for drive in drives})
    return {"sensors": ", ".join(models), "steps": str(run.step), "seconds": str(round(run.seconds))}


def _tell(outputs: list[Path], tests: dict[str, Any], as_json: bool) -> None:
    """Print the end of a training. The first output is the checkpoint."""
    about = training_module("runs").load_checkpoint(outputs[0])
    paths, seconds = [str(path) for path in outputs], round(about.seconds, 1)
    lines = [f"{', '.join(paths)}: {about.step} steps in {seconds} s"]
    lines += [f"{drive}: {json.dumps(found)}" for drive, found in tests.items()]
    result = {"outputs": paths, "steps": about.step, "seconds": seconds, "tests": tests}
    tell(result, "\n".join(lines), as_json)
