"""Prints, as Markdown, target bitrates against what came of them with sensors beside the HDL-64E.

    python -m benchmarks.sensor_targets [--codec predictive] [--save]

The whole turns of a capture, or of a simulated drive, are run to and fro for 6 s, ten a second. `sent` is the mean
without the first second, `worst 1 s` the mean of a second that is furthest from the target. Chamfer distances are of
the last frame, of what was sent and with what a receiver fills in. `false` are returns in cells that had none; of what
was filled in, those further than half a metre from every return. `of the best`: what is missing from the picture, over
that of the best of all settings of a grid that take no more bits than were sent; what is missing is as in
docs/codecs.md, "Target bitrate".

--save writes benchmarks/results/sensor-targets.csv.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from benchmarks import results
from benchmarks.scenes import DATA
from benchmarks.working_points import apart
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.ratecontrol.curve import missed
from lidarcodec.settings import settings_from
from lidarcodec.sources import open_source
from lidarcodec.wire import pack

CAPTURES = {
    "ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap.xz": (500, 1000, 2000, 4000, 8000),
    "velodyne/vlp16.pcap.xz": (100, 200, 400, 800),
    "hesai/pandar_64.pcap.xz": (300, 600, 1200, 2400, 4800),
    "sim:city?sensor=os1-128&profile=RNG15_RFL8_NIR8&frames=6": (1000, 2000, 4000),
    "sim:city?sensor=vlp16&frames=6": (100, 200, 400),
    "sim:city?sensor=pandar64&frames=6": (600, 1200, 2400),
}
"""Capture in `sensors/` of the data folder, or simulated drive -> targets, kbit/s."""
TURNS = 60
TURN_NS = 100_000_000
SETTLED = 10
STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
BOUNDS_M = (0.3, 0.2, 0.1, 0.048, 0.02, 0.008, 0.0)
LEVELS = ("off", "levels=2", "levels=4", "levels=8", "levels=16", "levels=32", "lossless")
FALSE_M = 0.5


class Sent(NamedTuple):
    """bits: (N,) of the frames; rate: the last report; frame, decoded: the last pair."""

    bits: np.ndarray
    rate: dict
    frame: Frame
    decoded: Frame


class Picture(NamedTuple):
    """What a frame shows: Chamfer distances in metres, RMSE of intensity of 255, false returns, and of filled ones."""

    sent_m: float
    filled_m: float
    shades: float
    invented: int
    false: int

    @property
    def missing_m(self) -> float:
        """What is missing, in metres."""
        return self.filled_m + float(missed(np.array([self.shades]))[0])


def turns_of(name: str) -> tuple[str, list[Frame]]:
    """Name of the sensor and the whole turns of a capture, without the first and the last of more than two."""
    simulated = name.startswith("sim:")
    with open_source(name if simulated else DATA / "sensors" / name) as source:
        frames = list(frames_of(source.packets(), source.sensor, "revolution"))
        return source.sensor.name + ", simulated" * simulated, frames[1:-1] if len(frames) > 2 else frames


def run(frames: list[Frame], settings: dict) -> Sent:
    """The frames to and fro, as one stream."""
    to_and_fro = frames + frames[-2:0:-1]
    encoder, decoder = StreamEncoder(settings_from(settings), 1), StreamDecoder()
    bits, pair = np.zeros(TURNS), None
    for index in range(TURNS):
        frame = to_and_fro[index % len(to_and_fro)].with_(index=index, stamp_ns=10**18 + index * TURN_NS)
        for message in encoder.encode(frame):
            bits[index] = 8 * len(pack(message))
            pair = frame, decoder.decode(message)[0]
    assert pair is not None
    return Sent(bits, encoder.rate or {}, *pair)


def picture(frame: Frame, decoded: Frame) -> Picture:
    """What the decoded frame shows of the frame."""
    cloud, shown = Cloud(xyz_of(frame.cloud())), filled(decoded)
    both = (frame.range > 0) & (shown.range > 0)
    off = shown.intensity[both].astype(float) - frame.intensity[both]
    points = xyz_of(shown.cloud())
    far = np.linalg.norm(points - cloud.points[cloud.nearest(points)], axis=1) > FALSE_M
    return Picture(
        float(apart(cloud, xyz_of(decoded.cloud())).max()),
        float(apart(cloud, points).max()),
        float(np.sqrt(np.square(off).mean())),
        int(np.count_nonzero((decoded.range > 0) & (frame.range == 0))),
        int(np.count_nonzero(far)),
    )


class Grid(NamedTuple):
    """bits and missing_m: (N,) of every setting of the grid."""

    bits: np.ndarray
    missing_m: np.ndarray

    def best_m(self, bits: float) -> float:
        """The least that is missing for so many bits."""
        return float(self.missing_m[self.bits <= max(bits, self.bits.min())].min())


def grid_of(frame: Frame, codec: str) -> Grid:
    """Bits and picture of every step, bound and number of levels; bits of attributes are taken to be the same at every
    bound."""

    def coded(**more: object) -> tuple[int, Frame]:
        (message,) = StreamEncoder(settings_from({"codec": codec, **more}), 1).encode(frame)
        return 8 * len(pack(message)), StreamDecoder().decode(message)[0]

    bits, missing_m = [], []
    for step in STEPS:
        reduction = f"lattice:{step}" if step > 1 else "all"
        bare = {bound: coded(reduction=reduction, max_error_m=bound, intensity="off") for bound in BOUNDS_M}
        shown = {bound: picture(frame, decoded) for bound, (_, decoded) in bare.items()}
        for levels in LEVELS:
            size, decoded = coded(reduction=reduction, max_error_m=0.1, intensity=levels)
            shades = picture(frame, decoded).shades
            for bound in BOUNDS_M:
                bits.append(bare[bound][0] + size - bare[0.1][0])
                missing_m.append(shown[bound]._replace(shades=shades).missing_m)
    return Grid(np.array(bits), np.array(missing_m))


def rows_of(capture: str, codec: str) -> list[str]:
    """Rows of the table."""
    name, frames = turns_of(capture)
    grid = grid_of(frames[0], codec)
    rows = []
    for target in CAPTURES[capture]:
        sent = run(frames, {"codec": codec, "target_kbps": target})
        kbps = sent.bits[SETTLED:].mean() * 1e9 / TURN_NS / 1e3
        seconds = np.convolve(sent.bits[SETTLED:], np.ones(10) / 10, "valid") * 1e9 / TURN_NS / 1e3
        worst = seconds[np.argmax(np.abs(seconds - target))]
        seen = picture(sent.frame, sent.decoded)
        rate = sent.rate
        cells = [name, f"{target:,}", f"{kbps:,.0f}", f"{100 * (kbps / target - 1):+.1f} %"]
        cells += [f"{100 * (worst / target - 1):+.1f} %", f"{rate['max_error_m']:g}", rate["intensity"]]
        cells += [str(rate["step"]), str(rate["frames_left_out"]), f"{1e3 * seen.sent_m:.1f}"]
        cells += [f"{1e3 * seen.filled_m:.1f}", f"{seen.shades:.1f}", str(seen.invented), str(seen.false)]
        cells.append(f"{seen.missing_m / grid.best_m(kbps * TURN_NS / 1e6):.2f}")
        rows.append(f"| {' | '.join(cells)} |")
        print(rows[-1], flush=True)
    return rows


def table(codec: str) -> str:
    """The table."""
    heads = ["sensor", "target, kbit/s", "sent", "off", "worst 1 s", "bound, m", "intensity", "every n-th column"]
    heads += ["frames left out", "Chamfer, mm", "filled, mm", "RMSE of intensity", "false", "false, filled"]
    heads.append("of the best")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for capture in CAPTURES:
        lines += rows_of(capture, codec)
    return "\n".join(lines)


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--codec", default="predictive")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/sensor-targets.csv")
    given = parser.parse_args()
    text = table(given.codec)
    if given.save:
        results.save("sensor-targets", text, title=f"Other sensors: targets, {given.codec}")


if __name__ == "__main__":
    main()
