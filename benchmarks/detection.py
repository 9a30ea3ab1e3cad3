"""What is left of labelled objects in coded frames, by bound, bitrate, purpose and reducer.

    python -m benchmarks.detection --cache DIR [--drives city,0001] [--frames 40] --save

It measures as `lidarcodec evaluate detection` does, on simulated drives with known boxes and on KITTI's labelled ones.
What was measured is kept in DIR, so that it can be stopped and continued. Objects of all drives are taken together.
Intensity is left out: neither ground nor clusters use it. `--save` writes
benchmarks/results/detection/ and docs/detection.png.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks import results
from benchmarks.scenes import DATA
from lidarcodec.commands.settings import one_setting
from lidarcodec.evaluation.detection.evaluate import Detection
from lidarcodec.evaluation.detection.labels import read_labels
from lidarcodec.evaluation.detection.report import difference, percent
from lidarcodec.evaluation.detection.scores import Tally, mean_and_error, scores
from lidarcodec.evaluation.plots import blank_figure, plain_ticks

LABELS: Final = DATA / "sensors" / "labels"
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
SEED: Final = 1
DRIVES: Final[dict[str, dict[str, Any]]] = {
    "city": {"spec": "sim:city?seed=1"},
    "city-2": {"spec": "sim:city?seed=2"},
    "city-5": {"spec": "sim:city?seed=5&skip=300"},
    "0001": {"spec": DATA / "kitti_0001_f000-089.pcap.xz", "labels": (LABELS / "drive_0001_tracklet_labels.xml",)},
    "0005": {
        "spec": DATA / "kitti_0005.pcap.xz",
        "labels": (LABELS / "0000.txt", LABELS / "calib_0000.txt"),
        "skip": 60,
    },
}
BOUNDS: Final = ("0.01", "0.03", "0.1", "0.2", "0.5")
RATES: Final = ("300", "500", "1000", "2000")
PURPOSES: Final = ("look", "detect", "localise")
OTHERS: Final = ("pcodec", "jpeg", "h264")
KINDS: Final = ("car", "van", "cyclist", "pedestrian")
COLOURS: Final = {"look": "#2563eb", "detect": "#16a34a", "localise": "#dc2626", "pcodec": "#7c3aed", "jpeg": "#f59e0b",
                  "h264": "#0891b2"}  # fmt: skip
PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "detection.png"
REDUCED: Final = (("voxel", "9000"), ("voxel", "20000"), ("random", "20000"), ("columns:6", ""))


def tables() -> dict[str, list[tuple[str, list[str]]]]:
    """Codec and settings of each row, by table."""
    bound = [("predictive", ["intensity=off", f"max_error_m={value}"]) for value in BOUNDS]
    rate = [
        ("predictive", ["intensity=off", f"purpose={purpose}", f"target_kbps={value}"])
        for purpose in PURPOSES
        for value in RATES
    ]
    codecs = [
        (codec, ["intensity=off", "purpose=detect", f"target_kbps={value}"]) for codec in OTHERS for value in RATES[1:]
    ]
    reduced = [
        ("predictive", ["intensity=off", "max_error_m=0.01", f"reduction={name}"] + [f"keep_points={n}"] * bool(n))
        for name, n in REDUCED
    ]
    return {"bounds": bound, "purposes": rate, "codecs": codecs, "reducers": reduced}


def drive_of(name: str, frames: int) -> Detection:
    """A drive with its boxes."""
    given = dict(DRIVES[name])
    labels = given.pop("labels", None)
    calibration = None if labels is None else CALIBRATION
    known = None if labels is None else read_labels(*labels)
    return Detection(given.pop("spec"), known, frames=frames, calibration=calibration, seed=SEED, **given)


class Kept:
    """What was measured, in a folder: bitrates and tallies by drive and setting."""

    def __init__(self, folder: Path, frames: int) -> None:
        self._folder, self._frames = folder, frames
        self._drive: tuple[str, Detection] | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def measured(self, name: str, codec: str | None, pairs: list[str]) -> tuple[float | None, Tally]:
        """Bitrate and tally of a drive with a setting; codec None: of the original frames."""
        key = hashlib.sha256(json.dumps([name, self._frames, codec, pairs]).encode()).hexdigest()[:24]
        path = self._folder / f"{key}.json"
        if not path.exists():
            drive = self._read(name)
            kbps, tally = None, drive.tally
            if codec is not None:
                about, tally = drive.measured(one_setting(codec, pairs))
                kbps = about["kbps"]
            values = {field: np.array(value).tolist() for field, value in asdict(tally).items() if field != "kinds"}
            path.write_text(json.dumps({"kbps": kbps, "kinds": tally.kinds, **values}))
            print(name, codec, *pairs, kbps, file=sys.stderr, flush=True)
        found = json.loads(path.read_text())
        sizes = {field: [np.array(size) for size in found.pop(field)] for field in ("size_m", "label_m")}
        return found.pop("kbps"), Tally(**found, **sizes)

    def _read(self, name: str) -> Detection:
        if self._drive is None or self._drive[0] != name:
            self._drive = name, drive_of(name, self._frames)
        return self._drive[1]


def together(tallies: list[Tally]) -> Tally:
    """The tallies of several drives as one. No object is in two drives."""
    whole = Tally()
    for number, one in enumerate(tallies):
        whole.tracks += [track + (number << 40) for track in one.tracks]
        for field in ("kinds", "distances_m", "returns", "found", "size_m", "label_m", "ground"):
            getattr(whole, field).extend(getattr(one, field))
    return whole


def row_of(name: str, kbps: float | None, tally: Tally, original: Tally) -> list[str]:
    """A row of a table; the first one has the original frames, and no differences."""
    score = scores(tally, original, SEED)
    apart = (lambda *_: "-") if tally is original else difference
    cells = [f"`{name}`" if kbps else name, "-" if kbps is None else f"{kbps:,.0f}", percent(score["found"])]
    cells += [apart(score, "found", 100), percent(score["returns"]), apart(score, "size_error", 1000)]
    cells += [percent(score["ground_iou"])]
    cells += [apart(score["kinds"][kind], "found", 100) for kind in KINDS if kind in score["kinds"]]
    return cells + [apart(band, "found", 100) for band in score["distances"].values()]


def rows(kept: Kept, drives: list[str], settings: list[tuple[str, list[str]]]) -> Iterator[list[str]]:
    """A row for the original frames, and one for each setting."""
    original = together([kept.measured(name, None, [])[1] for name in drives])
    yield row_of("original", None, original, original)
    for codec, pairs in settings:
        found = [kept.measured(name, codec, pairs) for name in drives]
        kbps = float(np.mean([one for one, _ in found if one is not None]))
        words = [pair for pair in pairs if pair != "intensity=off"]
        yield row_of(" ".join([codec, *words]), kbps, together([tally for _, tally in found]), original)


def purpose_rows(kept: Kept, drives: list[str]) -> Iterator[list[str]]:
    """For each bitrate: how many objects more are found with `detect` than with `look`, in percentage points."""
    for rate in RATES:
        pairs = [["intensity=off", f"purpose={purpose}", f"target_kbps={rate}"] for purpose in ("look", "detect")]
        found = [[kept.measured(name, "predictive", pair) for name in drives] for pair in pairs]
        look, detect = (together([tally for _, tally in one]) for one in found)
        sent = [np.mean([kbps for kbps, _ in one if kbps is not None]) for one in found]
        apart = np.array(detect.found) - np.array(look.found)
        mean, error = mean_and_error(apart, np.array(look.tracks), SEED)
        yield [rate, *(f"{kbps:,.0f}" for kbps in sent), f"{100 * (mean or 0):+.1f} +- {100 * (error or 0):.1f}"]


def lines_of(made: dict[str, list[list[str]]]) -> dict[str, tuple[str, list[tuple[float, float]]]]:
    """Name, colour, and kbit/s and share of the objects that are found of each point."""
    lines = {"predictive, within a bound": ("#64748b", made["bounds"][1:])}
    for purpose in PURPOSES:
        found = [row for row in made["purposes"] if f"purpose={purpose} " in row[0]]
        lines[f"predictive, {purpose}"] = COLOURS[purpose], found
    for codec in OTHERS:
        lines[f"{codec}, detect"] = COLOURS[codec], [row for row in made["codecs"] if f"`{codec} " in row[0]]
    return {
        name: (colour, sorted((float(row[1].replace(",", "")), float(row[2])) for row in found))
        for name, (colour, found) in lines.items()
    }


def two_points_rows(made: dict[str, list[list[str]]]) -> Iterator[list[str]]:
    """The bitrate below which at least two percentage points fewer objects are found, straight between two results on
    a logarithmic scale."""
    level = float(made["bounds"][0][2]) - 2
    for name, (_, places) in lines_of(made).items():
        worse = [at for at, (_, found) in enumerate(places) if found < level]
        if not worse:
            yield [name, f"below {places[0][0]:,.0f}"]
        elif worse[-1] == len(places) - 1:
            yield [name, "not reached"]
        else:
            (low, bad), (high, good) = places[worse[-1]], places[worse[-1] + 1]
            yield [name, f"{low * (high / low) ** ((level - bad) / (good - bad)):,.0f}"]


def draw(made: dict[str, list[list[str]]]) -> None:
    """Objects that are found against the bitrate."""
    figure = blank_figure(9, 5)
    axes = figure.subplots()
    whole = float(made["bounds"][0][2])
    axes.axhline(whole, color="black", linewidth=0.8, label="original frames")
    for name, (colour, places) in lines_of(made).items():
        axes.plot(*zip(*places, strict=True), "o-", color=colour, label=name, markersize=4, linewidth=1.3)
    axes.set_xscale("log")
    plain_ticks(axes.xaxis)
    axes.set_xlabel("kbit/s, everything counted")
    axes.set_ylabel("objects that are one cluster, %")
    axes.grid(alpha=0.3, which="both", linewidth=0.5)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    figure.savefig(PICTURE, dpi=110)


TITLES: Final = {
    "bounds": "Objects within a bound",
    "purposes": "Objects by purpose, at a target bitrate",
    "codecs": "Objects by codec, `purpose=detect`",
    "reducers": "Objects by reducer, within a centimetre",
    "two-points": "The bitrate below which two percentage points of the objects are lost",
    "look-and-detect": "`purpose=detect` against `look`, `predictive`",
}


def main() -> None:
    """Measure and print; with --save, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", default=",".join(DRIVES))
    parser.add_argument("--frames", type=int, default=40, help="frames of each drive")
    parser.add_argument("--cache", type=Path, required=True, help="folder for what was measured")
    parser.add_argument("--save", action="store_true", help="write benchmarks/results/detection/ and the picture")
    args = parser.parse_args()
    kept, drives = Kept(args.cache, args.frames), args.drives.split(",")
    for name in drives:  # a drive at a time is in memory
        kept.measured(name, None, [])
        for settings in tables().values():
            for codec, pairs in settings:
                kept.measured(name, codec, pairs)
    original = together([kept.measured(name, None, [])[1] for name in drives])
    about = (
        f"{len(drives)} drives of {args.frames} frames, {len(original.tracks)} boxes of {len(set(original.tracks))} "
        "objects; differences in percentage points and millimetres."
    )
    heads = ["setting", "kbit/s", "found %", "difference", "returns %", "size, difference", "ground %"]
    heads += [kind for kind in KINDS if kind in original.kinds]
    heads += [f"{band} m" for band in scores(original, original, SEED)["distances"]]
    made = {name: (heads, list(rows(kept, drives, settings))) for name, settings in tables().items()}
    made["look-and-detect"] = (["target, kbit/s", "look", "detect", "found more"], list(purpose_rows(kept, drives)))
    every = {name: cells for name, (_, cells) in made.items()}
    made["two-points"] = (["", "kbit/s"], list(two_points_rows(every)))
    here = results.here() | {"command": f"python -m benchmarks.detection --cache DIR --frames {args.frames} --save"}
    for name, (columns, cells) in made.items():
        found = results.Result(here | {"title": TITLES[name], "about": about}, columns, cells)
        print(found.markdown(), "\n")
        if args.save:
            results.write(f"detection/{name}", found)
    if args.save:
        draw(every)


if __name__ == "__main__":
    main()
