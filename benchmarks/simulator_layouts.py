"""Prints, as Markdown, what planes of simulated sensors cost beside those of real captures, plane by plane.

    python -m benchmarks.simulator_layouts [--save] [SENSOR ...]

The captures are those of the data folder: a few turns of each sensor, half of them at rest in rooms. Simulated are
turns with the layout of the capture, each at a place of its own: in the room where most of a capture is nearer than two
metres, in the garage for other captures in rooms, else in the town.
A cell has the bits a return of the capture, those of the simulation, and the difference. Bits are as in "rows, xz" of
benchmarks/other_sensors.py, over first and second returns: differences along the rows of a plane, byte by byte,
through xz.

--save writes benchmarks/results/simulator-layouts.csv.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.other_sensors import plane_xz
from benchmarks.scenes import DATA
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source

PLANES: Final = ("range", "range2", "intensity", "intensity2", "signal", "signal2", "near_ir")
LEAST_BITS: Final = 0.05
"""Planes that cost less in the capture are left out: they are nearly empty."""
SEEDS: Final = range(1, 7)
PLACES: Final = (40, 700)
"""Turns that are left out at the start of each drive."""


class Pair(NamedTuple):
    """A capture in the data folder, and the options and the scene of the simulated sensor."""

    capture: str
    options: str
    scene: str = "city"


PAIRS: Final = (
    Pair("sensors/velodyne/vlp16.pcap.xz", "sensor=vlp16&returns=dual", "room"),
    Pair("vlp16_sampleshort.pcap", "sensor=vlp16"),
    Pair("hdl32e_monterey_first800.pcap", "sensor=hdl32e"),
    Pair("sensors/velodyne/vlp32.pcap.xz", "sensor=vlp32c", "garage"),
    Pair("sensors/velodyne/vls128.pcap.xz", "sensor=vls128"),
    Pair("sensors/hesai/pandar_40p.pcap.xz", "sensor=pandar40p&returns=dual", "room"),
    Pair("sensors/hesai/pandar_64.pcap.xz", "sensor=pandar64&returns=dual", "room"),
    Pair("sensors/hesai/pandar_qt128.pcap.xz", "sensor=qt128&returns=dual", "garage"),
    Pair("sensors/hesai/pandar_xt16.pcap.xz", "sensor=xt16&returns=dual", "garage"),
    Pair("sensors/hesai/pandar_xt32m.pcap.xz", "sensor=xt32m&returns=dual", "garage"),
    Pair(
        "sensors/ouster/OS-0-32-U1_v2.2.0_1024x10.pcap.xz",
        "sensor=os0-32&profile=RNG19_RFL8_SIG16_NIR16_DUAL",
    ),
    Pair("sensors/ouster/OS-1-32-G_v2.1.1_1024x10.pcap.xz", "sensor=os1-32&profile=LEGACY"),
    Pair("sensors/ouster/OS-1-64_1024x10_fw20.pcap.xz", "sensor=os1-64&profile=LEGACY"),
    Pair("sensors/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap.xz", "sensor=os1-128&profile=RNG15_RFL8_NIR8"),
    Pair("sensors/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap.xz", "sensor=os2-128"),
)


def planes_of(frame: Frame) -> dict[str, npt.NDArray[np.unsignedinteger]]:
    """All planes by name."""
    return {"range": frame.range, "intensity": frame.intensity, **frame.planes}


def real(capture: str) -> list[Frame]:
    """Whole turns of a capture. First and last turns are parts: they are left out."""
    with open_source(DATA / capture) as source:
        frames = list(frames_of(source.packets(), source.sensor, "revolution"))
    return frames[1:-1] if len(frames) > 2 else frames


def simulated(pair: Pair) -> Iterator[Frame]:
    """A turn at each of a few places of each of a few towns."""
    for seed in SEEDS:
        for place in PLACES:
            with open_source(f"sim:{pair.scene}?seed={seed}&skip={place}&frames=2&{pair.options}") as source:
                frames = list(frames_of(source.packets(), source.sensor, "revolution"))
                yield max(frames, key=lambda frame: frame.width)


class Cost(NamedTuple):
    """Bits a return of each plane; share of cells with a return; share of those whose second return is the same."""

    bits: dict[str, float]
    returns: float
    same: float


def cost(frames: Iterable[Frame]) -> Cost:
    """What frames cost, each alone."""
    sizes: dict[str, int] = defaultdict(int)
    returns = cells = first = same = 0
    for frame in frames:
        planes = planes_of(frame)
        for name in PLANES:
            if name in planes:
                sizes[name] += plane_xz(planes[name])
        seen = frame.range > 0
        first += int(np.count_nonzero(seen))
        cells += frame.range.size
        returns += sum(int(np.count_nonzero(planes[name])) for name in ("range", "range2") if name in planes)
        if "range2" in planes:
            same += int(np.count_nonzero((planes["range2"] == frame.range) & seen))
    return Cost({name: 8 * size / returns for name, size in sizes.items()}, first / cells, same / first)


def row(pair: Pair) -> str:
    """The row of a capture."""
    theirs, ours = cost(real(pair.capture)), cost(simulated(pair))
    cells = [pair.options.removeprefix("sensor=").replace("&", " ").replace("returns=", "").replace("profile=", "")]
    cells.append(pair.scene)
    cells.append(f"{100 * theirs.returns:.0f} / {100 * ours.returns:.0f}")
    for name in PLANES:
        bits = theirs.bits.get(name, 0.0)
        if bits < LEAST_BITS:
            cells.append("-")
            continue
        off = ours.bits[name] / bits - 1
        cells.append(f"{bits:.2f} / {ours.bits[name]:.2f} / {100 * off:+.0f} %")
    cells.append(f"{100 * theirs.same:.1f} / {100 * ours.same:.1f}" if theirs.same > 0 else "-")
    return f"| {' | '.join(cells)} |"


def table(chosen: Iterable[Pair]) -> Iterator[str]:
    """Its lines."""
    yield f"| sensor | scene | cells with a return, % | {' | '.join(PLANES)} | second return the same, % |"
    yield "|---|" + "---|" * (len(PLANES) + 3)
    yield from map(row, chosen)


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/simulator-layouts.csv")
    parser.add_argument("sensors", nargs="*", metavar="SENSOR", help="only these")
    given = parser.parse_args()
    lines = []
    for line in table(
        pair for pair in PAIRS if not given.sensors or any(name in pair.options for name in given.sensors)
    ):
        print(line, flush=True)
        lines.append(line)
    if given.save:
        results.save("simulator-layouts", "\n".join(lines), title="Simulated sensors: bits a return of each plane")


if __name__ == "__main__":
    main()
