"""What few values of attributes cost and show with sensors beside the HDL-64E: a table for the rate control.

    python -m benchmarks.attribute_points [--write]

Of one turn of every capture in `sensors/` of the data folder, for each number of levels: bits per first return and
plane of attributes, beyond what the ranges take, and RMSE of the intensity on its scale of 255
(`attribute_values.py`); the mean of all captures. With --write it goes to
lidarcodec/ratecontrol/working_points_attributes.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.other_sensors import captures
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.planes.attribute_values import scale_of
from lidarcodec.ratecontrol.image_curve import kind_of
from lidarcodec.settings import settings_from
from lidarcodec.wire import size_of

OUT: Final = Path(__file__).parents[1] / "lidarcodec/ratecontrol/working_points_attributes.json"
LEVELS: Final = (0, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 128, 256)


def coded(frame: Frame, levels: int) -> tuple[int, Frame]:
    """Bits of a frame, and what comes back."""
    intensity = {0: "off", 256: "lossless"}.get(levels, f"levels={levels}")
    settings = settings_from({"codec": "predictive", "intensity": intensity})
    (message,) = StreamEncoder(settings, 1).encode(frame)
    return 8 * size_of(message), StreamDecoder().decode(message)[0]


def measured(frame: Frame) -> tuple[list[float], list[float]]:
    """Bits per return and plane, and RMSE of the intensity, of each number of levels."""
    found = layout_of(frame)
    assert found is not None
    bits = next(plane.bits for plane in found[1].planes if plane.name == "intensity")
    planes, returns = kind_of(frame).attributes, frame.points
    bare, _ = coded(frame, 0)
    cost, rmse = [], []
    for levels in LEVELS:
        size, came = coded(frame, levels)
        cost.append((size - bare) / returns / planes)
        off = scale_of(came.intensity[frame.valid], bits) - scale_of(frame.intensity[frame.valid], bits)
        rmse.append(float(np.sqrt(np.square(off).mean())))
    return cost, rmse


def main() -> None:
    """Measure and print; with --write, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="keep the result")
    given = parser.parse_args()
    found = np.array([measured(capture.frames[0]) for capture in captures()])
    bits, rmse = found.mean(axis=0).round(4).tolist()
    text = json.dumps({"levels": LEVELS, "bits": bits, "rmse": rmse}, indent=1) + "\n"
    print(text)
    if given.write:
        OUT.write_text(text)


if __name__ == "__main__":
    main()
