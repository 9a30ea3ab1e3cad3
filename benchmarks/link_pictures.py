"""What a viewer sees while a link changes: the last frame of each part of `benchmarks.adaptive`, beside the original.

    python -m benchmarks.link_pictures [--source CAPTURE] [OUT]

Writes one picture, docs/links.jpg by default, with a row for each rate. All settings but the target are defaults. Gaps
between columns that were sent are filled in, as a viewer sees them.
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.adaptive import PARTS, SOURCE, play
from benchmarks.link_ends import Turns
from benchmarks.links import Namespaces
from benchmarks.scenes import FRAMING
from lidarcodec.apps.picture import picture_of
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of

OUT = Path(__file__).resolve().parents[1] / "docs" / "links.jpg"
WIDTH = 1100


def beside(originals: list[Frame], shown: list[tuple[float, Frame]]) -> Image.Image:
    """The originals at the left, what was shown at the right."""
    rows = []
    for kbit, frame in shown:
        original = originals[frame.index % len(originals)]
        both = picture_of(original, "original"), picture_of(frame, f"shown over {kbit / 1e3:g} Mbit/s")
        rows.append(np.hstack(both))
    whole = Image.fromarray(np.vstack(rows))
    return whole.resize((WIDTH, round(whole.height * WIDTH / whole.width)), Image.Resampling.LANCZOS)


def main() -> None:
    """Play, and draw."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.link_pictures", description=__doc__.splitlines()[0])
    parser.add_argument("--source", default=str(SOURCE))
    parser.add_argument("out", nargs="?", type=Path, default=OUT)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Namespaces(PARTS[0][0]) as link:
        times, _, receiver = play(link, "auto", options.source, keep=Path(folder))
        when = {one["index"]: one["at"] for one in receiver.said if "index" in one}
        kept = {int(path.stem): path for path in Path(folder).glob("*.pickle")}
        shown = []
        for (kbit, _), end in zip(PARTS[:-1], times[1:-1], strict=True):
            last = max(index for index in kept if when.get(index, np.inf) < end)
            shown.append((kbit, pickle.loads(kept[last].read_bytes())))
    turns = Turns(options.source)
    beside(list(frames_of(turns.packets(), turns.sensor, FRAMING)), shown).save(options.out, quality=80)


if __name__ == "__main__":
    main()
