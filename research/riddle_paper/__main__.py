"""RIDDLE as its paper has it, trained and measured: docs/riddle-paper.md holds what came of it.

    python -m research.riddle_paper train SOURCE... --calibration FILE --out DIR [--temporal 100]
    python -m research.riddle_paper evaluate SOURCE --calibration FILE --intra DIR --temporal DIR [--json FILE]
    python -m research.riddle_paper table FILE...

`train` goes on where a run in DIR stands, and keeps the network that was best on turns held out. `evaluate` measures
each predictor on the same turns; `table` prints what it wrote. Needs the extra `learned`; a GPU is used when there is
one.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.training import training_module


def _module(name: str) -> Any:
    """A module of this folder. They import torch, so `training_module` comes first: it says what is missing."""
    return import_module(f"research.riddle_paper.{name}")


def _train(chosen: argparse.Namespace) -> int:
    runs, data, run = training_module("runs"), _module("data"), _module("run")
    runs.limit_threads(chosen.threads)
    settings = run.RunSettings(
        temporal=chosen.temporal,
        steps=chosen.steps,
        batch=chosen.batch,
        frames=chosen.frames,
        rate=chosen.rate,
        seed=chosen.seed,
        minutes=chosen.minutes,
    )
    scans, held_out = [], []
    for source in chosen.sources:
        found = data.read_scans(source, calibration=chosen.calibration)
        held = min(chosen.hold_out, len(found) - 1)
        scans += found[: len(found) - held]
        held_out += found[len(found) - held :]
        print(f"{source}: {len(found)} turns, {sum(s.motion is not None for s in found)} with the motion before them")

    drives = {}
    for source in chosen.validate:
        found = data.read_scans(source, calibration=chosen.calibration, skip=8, every=30)
        drives[Path(source).name.split(".")[0]] = [scan for scan in found if scan.motion is not None]

    def tell(progress: Any) -> None:
        if progress.measured is not None:
            print(json.dumps(progress.measured), flush=True)
        elif sys.stderr.isatty():
            line = f"\r{progress.step} steps, {100 * progress.done:.1f} %, loss {progress.loss:.3f} "
            print(line, end="", file=sys.stderr, flush=True)

    device = runs.choose_device(chosen.device)
    run.train(scans, held_out, settings, chosen.out, device=device, every=chosen.every, validate=drives, tell=tell)
    return 0


def _evaluate(chosen: argparse.Namespace) -> int:
    runs = training_module("runs")
    data, run, coding, measure = map(_module, ("data", "run", "coding", "measure"))
    runs.limit_threads(chosen.threads)
    device = runs.choose_device(chosen.device)
    nets, trained = {}, {}
    for name, folder in (("intra", chosen.intra), ("temporal", chosen.temporal)):
        if folder is not None:
            net, state = run.load_net(folder, device, run.BEST if (folder / run.BEST).exists() else run.CHECKPOINT)
            nets[f"RIDDLE {name}"] = measure.Learned(coding.Predictor(net, device), net.shape.temporal)
            trained[name] = {"settings": state.settings, "step": state.step, "seconds": state.seconds, "log": state.log}
    scans = data.read_scans(
        chosen.source, calibration=chosen.calibration, skip=chosen.skip, every=chosen.every, most=chosen.frames
    )
    if not all(scan.motion is not None for scan in scans):
        raise SourceError("a turn has no other before it, or its motion was not found: measure others (--skip)")
    result: dict[str, Any] = {"source": Path(chosen.source).name, "turns": len(scans), "trained": trained, "steps": {}}
    for step in chosen.steps:
        found: dict[str, Any] = {"drawn": measure.drawn_returns(scans, nets, step, chosen.drawn)}
        _write(chosen.json, result | {"steps": result["steps"] | {str(step): found}})
        whole = scans[:: chosen.whole] if chosen.whole else []
        if whole:
            found["whole_turns"] = len(whole)
            found["whole"] = measure.whole_frames(
                whole, nets, step, lambda line: print(line, file=sys.stderr, flush=True)
            )
            found["ours"] = measure.ours(whole, step) if step % 2 else {}
        if chosen.decode:
            found["comes_back"] = {name: measure.comes_back(scans[0], net, step) for name, net in nets.items()}
        result["steps"][str(step)] = found
        _write(chosen.json, result)
    print(_table(result))
    return 0


def _write(path: Path | None, result: dict[str, Any]) -> None:
    if path is not None:
        path.write_text(json.dumps(result, indent=1) + "\n")


def _table(result: dict[str, Any]) -> str:
    """A Markdown table for each step: accuracy on drawn returns, bits of whole turns without and with the mask."""
    lines = [f"`{result['source']}`, {result['turns']} turns"]
    for step, found in result["steps"].items():
        lines += ["", f"Steps of {int(step) * 0.2:.1f} cm", ""]
        lines += ["| predictor | cell foreseen | within 0.1 m | entropy | sparse + arithmetic | varint + LZMA |"]
        lines += ["|---|---:|---:|---:|---:|---:|"]
        for name, row in found["drawn"].items():
            bits = found.get("whole", {}).get(name, {}).get("bits", {})
            cells = [f"{bits[coder]:.3f}" if coder in bits else "-" for coder in ("sparse", "varint")]
            shares = [f"{100 * row[share]:.1f} %" for share in ("right_cell", "within_0.1_m")]
            lines.append(f"| {' | '.join([name, *shares, format(row['bits']['entropy'], '.3f'), *cells])} |")
        for name, row in found.get("ours", {}).items():
            value = next(iter(row["bits"].values()), 0.0)
            lines.append(f"| {name} | - | - | - | {value:.3f} | - |")
    return "\n".join(lines)


def _print_tables(chosen: argparse.Namespace) -> int:
    for path in chosen.files:
        print(_table(json.loads(path.read_text())))
    return 0


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m research.riddle_paper",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    train = verbs.add_parser("train", help="train a predictor, or go on")
    train.add_argument("sources", nargs="+", metavar="SOURCE")
    train.add_argument("--calibration", type=Path)
    train.add_argument("--out", type=Path, required=True, help="folder of the run")
    train.add_argument(
        "--temporal", type=int, default=0, help="points of the scan before: 0 intra, 100 as in the paper"
    )
    train.add_argument("--steps", type=int, default=4000)
    train.add_argument(
        "--minutes", type=float, help="train so long instead; the learning rate goes by the clock, and what was "
        "reached is written every ten minutes"
    )  # fmt: skip
    train.add_argument(
        "--validate", action="append", default=[], metavar="SOURCE", help="a drive for the learning curve (curve.csv): "
        "every 30th of its turns; repeatable"
    )  # fmt: skip
    train.add_argument("--batch", type=int, default=1024, help="returns a step")
    train.add_argument("--frames", type=int, default=2, help="frames they are drawn from")
    train.add_argument("--rate", type=float, default=2e-3, help="peak of the learning rate")
    train.add_argument("--seed", type=int, default=1)
    train.add_argument("--hold-out", type=int, default=3, help="last turns of each source, to measure on")
    train.add_argument("--every", type=int, default=250, help="steps from one checkpoint to the next")
    train.add_argument("--threads", type=int, default=1)
    train.add_argument("--device", default="auto")
    evaluate = verbs.add_parser("evaluate", help="measure predictors, baselines and `predictive` on the same turns")
    evaluate.add_argument("source", metavar="SOURCE")
    evaluate.add_argument("--calibration", type=Path)
    evaluate.add_argument("--intra", type=Path, help="folder of a run without the scan before")
    evaluate.add_argument("--temporal", type=Path, help="folder of a run with it")
    evaluate.add_argument("--steps", type=int, nargs="+", default=[11, 51], help="quantisation, in steps of 2 mm")
    evaluate.add_argument("--skip", type=int, default=8)
    evaluate.add_argument("--every", type=int, default=8, help="of the turns one in so many")
    evaluate.add_argument("--frames", type=int, default=None)
    evaluate.add_argument("--drawn", type=int, default=4000, help="returns of each turn for the accuracy")
    evaluate.add_argument(
        "--whole", type=int, default=6, help="of those turns one in so many is coded as a whole; 0: none"
    )
    evaluate.add_argument("--decode", action="store_true", help="encode and decode the first turn, and compare")
    evaluate.add_argument("--threads", type=int, default=1)
    evaluate.add_argument("--device", default="auto")
    evaluate.add_argument("--json", type=Path, help="file for what was found, written after every part")
    table = verbs.add_parser("table", help="print what `evaluate` wrote, as Markdown")
    table.add_argument("files", nargs="+", type=Path)
    return parser


def main() -> int:
    """Command line."""
    chosen = _arguments().parse_args()
    try:
        return {"train": _train, "evaluate": _evaluate, "table": _print_tables}[chosen.verb](chosen)
    except LidarCodecError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
