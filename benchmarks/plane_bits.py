"""Prints, as Markdown, where the bits of lossless frames of sensors beside the HDL-64E are, plane by plane.

    python -m benchmarks.plane_bits [--save]

The captures are those of benchmarks/other_sensors.py; bits are over first and second returns, and each frame is coded
alone. "Folded, xz": differences along the rows of a plane, with the sign in the lowest bit, in as few bytes as they
need, byte by byte, through xz. "Noise" is about what a plane would take if a decoder knew the picture behind the noise:
the entropy of a normal distribution with the spread that there is around each cell, as second differences along the row
tell it. A plane can take less where its values have gaps, or where another plane tells of it, as reflectivities do of
signals. "Rest" is all that is no plane: time stamps, azimuths, calibration, headers.

--save writes benchmarks/results/plane-bits.csv.
"""

from __future__ import annotations

import argparse
import lzma
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.other_sensors import XZ_LEVEL, Capture, captures, coded
from lidarcodec.codecs.plane_content import shift_of
from lidarcodec.entropy.plane_coder import encode_planes, form_table, in_order
from lidarcodec.entropy.varint import VarintReader
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of

Image = npt.NDArray[np.unsignedinteger]

NOISY: Final = ("range", "intensity", "signal", "signal2", "near_ir")
LEAST_BITS: Final = 0.05
"""Planes that cost less by folded rows are left out: they are nearly empty."""
_CONSTANT, _SPARSE, _ATTRIBUTE = 0, 3, 2
_NORMAL: Final = 0.6745
"""The median size of a normal distribution, in standard deviations."""


def folded_xz(plane: Image) -> int:
    """Bytes of differences along the rows of a plane, sign in the lowest bit, byte by byte, through xz."""
    steps = plane.astype(np.int64)
    steps[:, 1:] -= steps[:, :-1].copy()
    folded = (steps << 1) ^ (steps >> 63)
    size = max(1, (int(folded.max()).bit_length() + 7) // 8)
    columns = folded.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :size]
    return len(lzma.compress(columns.T.tobytes(), preset=XZ_LEVEL))


def planes_of(frame: Frame) -> Mapping[str, Image]:
    """All planes of a frame by name, as they are sent."""
    found = layout_of(frame)
    assert found is not None
    return images_of(frame, found[1]).planes


def streams(frame: Frame) -> dict[str, int]:
    """Bytes of each plane's stream in `predictive`."""
    found = layout_of(frame)
    assert found is not None
    forms = in_order(found[1].planes)
    reader = VarintReader(encode_planes(forms, planes_of(frame), shift_of(frame)))
    reader.byte()
    sizes = {}
    for number, (form, (role, _, _, like)) in enumerate(zip(forms, form_table(forms).tolist(), strict=True)):
        way = reader.byte()
        if role == _ATTRIBUTE and like == number:
            reader.varint(1 << 20)
        if way in (_CONSTANT, _SPARSE):
            reader.varint(1 << 20)
        if role == _ATTRIBUTE and way != _CONSTANT:
            reader.byte()
        sizes[form.name] = 0 if way == _CONSTANT else reader.varint(1 << 31)
    return sizes


def noise(name: str, planes: Mapping[str, Image]) -> float:
    """Bits of a plane, all together, that are noise."""
    values = planes[name].astype(np.float64)
    coded_cells = np.ones(values.shape, bool)
    if name == "range":
        coded_cells = values > 0
        last = np.maximum.accumulate(np.where(coded_cells, np.arange(values.shape[1]), 0), axis=1)
        values = np.take_along_axis(values, last, axis=1)
    bend = np.abs(np.roll(values, 1, 1) - 2 * values + np.roll(values, -1, 1))
    around = [np.roll(bend, (row, column), (0, 1)) for row in (-1, 0, 1) for column in (-2, -1, 0, 1, 2)]
    spread = np.median(around, axis=0) / _NORMAL / np.sqrt(6)
    bits = np.log2(np.maximum(spread, 0.25) * np.sqrt(2 * np.pi * np.e))
    return float(np.maximum(bits, 0)[coded_cells].sum())


def lines_of(capture: Capture) -> Iterator[str]:
    """The rows of a capture."""
    a_return = 8 / capture.returns
    sensor = capture.name.split(",")[0].split(" (")[0]
    images = [planes_of(frame) for frame in capture.frames]
    ours = [streams(frame) for frame in capture.frames]
    whole, in_planes = coded(capture, "predictive").size * a_return, 0.0
    plain = 0.0
    for name in images[0]:
        rows = sum(folded_xz(planes[name]) for planes in images) * a_return
        bits = sum(sizes[name] for sizes in ours) * a_return
        plain, in_planes = plain + rows, in_planes + bits
        if rows < LEAST_BITS:
            continue
        floor = f"{sum(noise(name, planes) for planes in images) / capture.returns:.2f}" if name in NOISY else "-"
        yield f"| {sensor} | {name} | {rows:.2f} | {bits:.2f} | {100 * (1 - bits / rows):.0f} % | {floor} |"
    yield f"| {sensor} | rest | - | {whole - in_planes:.2f} | - | - |"
    yield f"| {sensor} | all | {plain:.2f} | {whole:.2f} | {100 * (1 - whole / plain):.0f} % | - |"


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/plane-bits.csv")
    given = parser.parse_args()
    lines = ["| sensor | plane | folded, xz | `predictive` | less | noise, about |", "|---|" + "---|" * 5]
    for capture in captures():
        lines += lines_of(capture)
    text = "\n".join(lines)
    print(text)
    if given.save:
        results.save("plane-bits", text, title="Other sensors: bits a return of each plane, lossless")


if __name__ == "__main__":
    main()
