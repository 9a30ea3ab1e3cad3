"""What is left of labelled objects in coded frames, by bound, bitrate, purpose and reducer.

    python -m benchmarks.detection --cache DIR [--drives city,0001] --save

It measures as `lidarcodec evaluate detection` does, on simulated drives with known boxes and on KITTI's labelled ones.
What was measured is kept in DIR, so that it can be stopped and continued. Objects of all drives are taken together.
Intensity is left out, but for one row: neither ground nor clusters use it. The detector has the weights of the package
on simulated drives, and those that were trained on other drives of KITTI on KITTI's. Pedestrians are measured on
simulated drives only. `--save` writes
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
from lidarcodec.evaluation.detection.detector.network import KINDS as DETECTED
from lidarcodec.evaluation.detection.detector.network import SHIPPED, read_network
from lidarcodec.evaluation.detection.detector.precision import Hits, Precision, precisions
from lidarcodec.evaluation.detection.evaluate import Detection
from lidarcodec.evaluation.detection.labels import read_labels
from lidarcodec.evaluation.detection.report import difference, percent
from lidarcodec.evaluation.detection.scores import Tally, mean_and_error, scores
from lidarcodec.evaluation.plots import blank_figure, plain_ticks

LABELS: Final = DATA / "sensors" / "labels"
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
WEIGHTS: Final = Path(__file__).with_name("weights") / "detector-kitti.npz"
SEED: Final = 1
DRIVES: Final[dict[str, dict[str, Any]]] = {
    "city": {"spec": "sim:city?seed=1", "frames": 16},
    "city-2": {"spec": "sim:city?seed=2", "frames": 16},
    "city-5": {"spec": "sim:city?seed=5&skip=300", "frames": 16},
    "0001": {
        "spec": DATA / "kitti_0001_f000-089.pcap.xz",
        "labels": (LABELS / "drive_0001_tracklet_labels.xml",),
        "skip": 60,
        "frames": 30,
    },
    "0005": {
        "spec": DATA / "kitti_0005.pcap.xz",
        "labels": (LABELS / "0000.txt", LABELS / "calib_0000.txt"),
        "skip": 60,
        "frames": 80,
    },
}
BOUNDS: Final = ("0.01", "0.03", "0.1", "0.2", "0.5")
RATES: Final = ("300", "500", "1000", "2000")
PURPOSES: Final = ("look", "detect", "localise")
OTHERS: Final = ("pcodec", "jpeg", "h264")
KINDS: Final = ("car", "van", "cyclist", "pedestrian")
COLOURS: Final = {"look": "#2563eb", "detect": "#16a34a", "localise": "#dc2626", "pcodec": "#7c3aed", "jpeg": "#f59e0b",
                  "h264": "#0891b2"}  # fmt: skip
FEW: Final = ("pedestrian",)
"""Kinds of which KITTI's drives have too few to measure anything."""
LEARNED_FROM: Final = "0001"
"""The detector's weights for KITTI were trained on this drive, so they are not tested on it."""
DARK: Final = ("zstd", ["intensity=off"])
"""All returns as they were, but without intensity, which the detector uses where there is one."""
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
    intensity = [
        DARK,
        ("predictive", ["max_error_m=0.01", "intensity=lossless"]),
        ("predictive", ["max_error_m=0.02", "intensity=levels=10"]),
        ("predictive", ["purpose=look", "target_kbps=1000"]),
    ]
    return {"bounds": bound, "purposes": rate, "codecs": codecs, "reducers": reduced, "intensity": intensity}


def drive_of(name: str) -> Detection:
    """A drive with its boxes."""
    given = dict(DRIVES[name])
    labels = given.pop("labels", None)
    calibration = None if labels is None else CALIBRATION
    known = None if labels is None else read_labels(*labels)
    detector = read_network(SHIPPED if known is None else WEIGHTS)
    spec = given.pop("spec")
    return Detection(spec, known, calibration=calibration, seed=SEED, detector=detector, **given)


class Kept:
    """What was measured, in a folder: bitrates and tallies by drive and setting."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._drive: tuple[str, Detection] | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def measured(self, name: str, codec: str | None, pairs: list[str]) -> tuple[float | None, Tally, Precision]:
        """Bitrate and what was found of a drive with a setting; codec None: of the original frames."""
        key = hashlib.sha256(json.dumps([name, codec, pairs]).encode()).hexdigest()[:24]
        path = self._folder / f"{key}.json"
        if not path.exists():
            drive = self._read(name)
            kbps, tally, precision = None, drive.tally, drive.precision
            if codec is not None:
                about, tally, precision = drive.measured(one_setting(codec, pairs))
                kbps = about["kbps"]
            values = {field: np.array(value).tolist() for field, value in asdict(tally).items() if field != "kinds"}
            hits = {kind: asdict(one) for kind, one in precision.hits.items()}
            kept = {"kbps": kbps, "kinds": tally.kinds, "hits": hits, "runs": precision.runs}
            path.write_text(json.dumps(kept | values))
            print(name, codec, *pairs, kbps, file=sys.stderr, flush=True)
        found = json.loads(path.read_text())
        sizes = {field: [np.array(size) for size in found.pop(field)] for field in ("size_m", "label_m")}
        precision = Precision()
        precision.runs = found.pop("runs")
        for kind, hits in found.pop("hits").items():
            objects = {int(run): count for run, count in hits.pop("objects").items()}
            if kind not in FEW or "labels" not in DRIVES[name]:
                precision.hits[kind] = Hits(**hits, objects=objects)
        return found.pop("kbps"), Tally(**found, **sizes), precision

    def _read(self, name: str) -> Detection:
        if self._drive is None or self._drive[0] != name:
            self._drive = name, drive_of(name)
        return self._drive[1]


def together(tallies: list[Tally]) -> Tally:
    """The tallies of several drives as one. No object is in two drives."""
    whole = Tally()
    for number, one in enumerate(tallies):
        whole.tracks += [track + (number << 40) for track in one.tracks]
        for field in ("kinds", "distances_m", "returns", "found", "size_m", "label_m", "ground"):
            getattr(whole, field).extend(getattr(one, field))
    return whole


def all_precisions(parts: list[Precision]) -> Precision:
    """What was found in several drives as one."""
    whole = Precision()
    for one in parts:
        whole.extend(one)
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
        kbps = float(np.mean([one for one, _, _ in found if one is not None]))
        words = [pair for pair in pairs if pair != "intensity=off"]
        yield row_of(" ".join([codec, *words]), kbps, together([tally for _, tally, _ in found]), original)


def kinds_of(kept: Kept, drives: list[str]) -> list[str]:
    """The kinds of the detector that the drives have."""
    original = all_precisions([kept.measured(name, None, [])[2] for name in drives])
    return [kind for kind in DETECTED if sum(original.hits[kind].objects.values())]


def detector_rows(kept: Kept, drives: list[str], settings: list[tuple[str, list[str]]]) -> Iterator[list[str]]:
    """A row for the original frames, and one for each setting: average precision of each kind."""
    original = all_precisions([kept.measured(name, None, [])[2] for name in drives])
    before = precisions(original, original, SEED)
    kinds = [kind for kind in DETECTED if kind in before]
    yield ["original", "-", *(percent(before[kind]["ap"]) for kind in kinds)]
    for codec, pairs in settings:
        found = [kept.measured(name, codec, pairs) for name in drives]
        kbps = float(np.mean([one for one, _, _ in found if one is not None]))
        words = [pair for pair in pairs if pair != "intensity=off"]
        score = precisions(all_precisions([one for _, _, one in found]), original, SEED)
        yield [
            f"`{' '.join([codec, *words])}`",
            f"{kbps:,.0f}",
            *(difference(score[kind], "ap", 100) for kind in kinds),
        ]


def purpose_rows(kept: Kept, drives: list[str]) -> Iterator[list[str]]:
    """For each bitrate: how many objects more are found with `detect` than with `look`, in percentage points."""
    for rate in RATES:
        pairs = [["intensity=off", f"purpose={purpose}", f"target_kbps={rate}"] for purpose in ("look", "detect")]
        found = [[kept.measured(name, "predictive", pair) for name in drives] for pair in pairs]
        look, detect = (together([tally for _, tally, _ in one]) for one in found)
        sent = [np.mean([kbps for kbps, _, _ in one if kbps is not None]) for one in found]
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


def detector_two_points(kept: Kept, drives: list[str], made: dict[str, list[list[str]]]) -> Iterator[list[str]]:
    """The same for average precision of vehicles, against lossless ranges without intensity."""
    original = all_precisions([kept.measured(name, None, [])[2] for name in drives])
    dark = all_precisions([kept.measured(name, *DARK)[2] for name in drives])
    level = 100 * precisions(dark, original, SEED)["vehicle"]["ap_difference"] - 2
    whole = {name: [[row[0], row[1], row[2].split()[0]] for row in rows] for name, rows in made.items()}
    for name, (_, places) in lines_of(whole).items():
        yield [name, falling(places, level)]


def two_points_rows(made: dict[str, list[list[str]]]) -> Iterator[list[str]]:
    """The bitrate below which at least two percentage points fewer objects are found, straight between two results on
    a logarithmic scale."""
    level = float(made["bounds"][0][2]) - 2
    for name, (_, places) in lines_of(made).items():
        yield [name, falling(places, level)]


def falling(places: list[tuple[float, float]], level: float) -> str:
    """The bitrate below which values are under a level."""
    worse = [at for at, (_, found) in enumerate(places) if found < level]
    if not worse:
        return f"below {places[0][0]:,.0f}"
    if worse[-1] == len(places) - 1:
        return "not reached"
    (low, bad), (high, good) = places[worse[-1]], places[worse[-1] + 1]
    return f"{low * (high / low) ** ((level - bad) / (good - bad)):,.0f}"


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
    "intensity": "Objects with intensity",
    "detector-bounds": "The detector within a bound",
    "detector-purposes": "The detector by purpose, at a target bitrate",
    "detector-codecs": "The detector by codec, `purpose=detect`",
    "detector-reducers": "The detector by reducer, within a centimetre",
    "detector-intensity": "The detector with and without intensity",
    "detector-two-points": "The bitrate below which two points of average precision of vehicles are lost",
    "look-and-detect": "`purpose=detect` against `look`, `predictive`",
}


def main() -> None:
    """Measure and print; with --save, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", default=",".join(DRIVES))
    parser.add_argument("--cache", type=Path, required=True, help="folder for what was measured")
    parser.add_argument("--save", action="store_true", help="write benchmarks/results/detection/ and the picture")
    args = parser.parse_args()
    kept, drives = Kept(args.cache), args.drives.split(",")
    for name in drives:  # a drive at a time is in memory
        kept.measured(name, None, [])
        for settings in tables().values():
            for codec, pairs in settings:
                kept.measured(name, codec, pairs)
    original = together([kept.measured(name, None, [])[1] for name in drives])
    about = (
        f"{len(drives)} drives, {sum(DRIVES[name]['frames'] for name in drives)} frames, {len(original.tracks)} boxes "
        f"of {len(set(original.tracks))} objects; differences in percentage points and millimetres."
    )
    hits = all_precisions([kept.measured(name, None, [])[2] for name in drives if name != LEARNED_FROM]).hits
    of_detector = (
        "Average precision of the original frames in percent, then differences in points. Objects: "
        + ", ".join(f"{sum(one.objects.values()):,} of kind {kind}" for kind, one in hits.items())
    )
    heads = ["setting", "kbit/s", "found %", "difference", "returns %", "size, difference", "ground %"]
    heads += [kind for kind in KINDS if kind in original.kinds]
    heads += [f"{band} m" for band in scores(original, original, SEED)["distances"]]
    made = {name: (heads, list(rows(kept, drives, settings))) for name, settings in tables().items()}
    made["look-and-detect"] = (["target, kbit/s", "look", "detect", "found more"], list(purpose_rows(kept, drives)))
    every = {name: cells for name, (_, cells) in made.items()}
    made["two-points"] = (["", "kbit/s"], list(two_points_rows(every)))
    others = [name for name in drives if name != LEARNED_FROM]
    found = {name: list(detector_rows(kept, others, settings)) for name, settings in tables().items()}
    columns = ["setting", "kbit/s", *(f"AP {kind}" for kind in kinds_of(kept, others))]
    made |= {f"detector-{name}": (columns, cells) for name, cells in found.items()}
    made["detector-two-points"] = (["", "kbit/s"], list(detector_two_points(kept, others, found)))
    here = results.here() | {"command": "python -m benchmarks.detection --cache DIR --save"}
    for name, (columns, cells) in made.items():
        result = results.Result(
            here | {"title": TITLES[name], "about": of_detector if name.startswith("detector") else about},
            columns,
            cells,
        )
        print(result.markdown(), "\n")
        if args.save:
            results.write(f"detection/{name}", result)
    if args.save:
        draw(every)


if __name__ == "__main__":
    main()
