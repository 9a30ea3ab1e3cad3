"""Prints, as Markdown, a target bitrate against what came of it: five targets a codec, and switches in mid-stream.

    python -m benchmarks.rate_table NAME=SOURCE... [--codecs pcodec,zstd] [--set intensity=off] [--switch-kbps 2000]

Targets lie at a tenth, 30 %, half, 70 % and 90 % of the way (on a logarithmic scale) between what the codec takes at
the two ends of its knob. `5 s` is the worst mean of five seconds within a stream, `1 s` the highest of one second; both
leave out the first second, in which the stream settles. Codecs switch to the next of the list in the middle of the
source, the last one to the first; `second after` is the mean of the second that begins one second after the switch. A
source is run to and fro until it covers 11 s, so that it goes on without a jump.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from benchmarks.scenes import FRAMING
from lidarcodec import api
from lidarcodec.codecs import table
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.units import PACKET_INTERVAL_US
from lidarcodec.wire import pack

FRACTIONS = (0.1, 0.3, 0.5, 0.7, 0.9)
SECONDS = 11.0
FIRST_S = 1.0


@dataclass(frozen=True)
class Sent:
    """A run: seconds and bits of each frame, those of a group spread evenly; the encoder's last report; its values."""

    seconds: np.ndarray
    bits: np.ndarray
    rate: dict

    def means(self, window_s: float, first_s: float = FIRST_S) -> np.ndarray:
        """(N,) kbit/s of every stretch of `window_s` that ends with a frame and starts after `first_s`."""
        at = np.concatenate([[0.0], np.cumsum(self.seconds)])
        total = np.concatenate([[0.0], np.cumsum(self.bits)])
        ends = at[at >= first_s + window_s - 1e-9]
        starts = np.interp(ends - window_s, at, total)
        return (np.interp(ends, at, total) - starts) / window_s / 1e3


def long_enough(frames: list[Frame], seconds: float = SECONDS) -> list[Frame]:
    """Frames to and fro until they cover so many seconds, numbered and stamped as one stream."""
    if not frames or frames[0].side is None:
        return frames
    there_and_back = frames + frames[-2:0:-1]
    out: list[Frame] = []
    stamp_ns = frames[0].stamp_ns
    while (stamp_ns - frames[0].stamp_ns) * 1e-9 < seconds:
        frame = there_and_back[len(out) % len(there_and_back)]
        out.append(frame.with_(index=len(out), stamp_ns=stamp_ns))
        stamp_ns += 1000 * PACKET_INTERVAL_US * (frame.side.packets if frame.side else 0)
    return out


def run(frames: list[Frame], settings: StreamSettings, changes: dict[int, dict] | None = None) -> Sent:
    """Encode the frames. changes: settings to change before the frame of that position."""
    encoder = StreamEncoder(settings, stream_id=1)
    bits = np.zeros(len(frames))
    done = 0

    def take(messages: list) -> None:
        nonlocal done
        for message in messages:
            bits[done : done + message.frame_count] = 8 * len(pack(message)) / message.frame_count
            done += message.frame_count

    for position, frame in enumerate(frames):
        if changes and position in changes:
            encoder.apply(encoder.settings.changed(**changes[position]))
        take(encoder.encode(frame))
        done += encoder.left_out
    take(encoder.flush())
    seconds = np.array([frame.side.packets * PACKET_INTERVAL_US * 1e-6 for frame in frames])  # type: ignore[union-attr]
    return Sent(seconds, bits, encoder.rate or {})


def ends_kbps(frames: list[Frame], codec: str, others: dict) -> tuple[float, float]:
    """What the codec takes at the ends of its knob."""
    low = run(frames, settings_from({"codec": codec, "target_kbps": 1, **others})).means(5.0).mean()
    high = run(frames, settings_from({"codec": codec, "target_kbps": 1e6, **others})).means(5.0).mean()
    return float(low), float(high)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", metavar="NAME=SOURCE")
    steered = [name for name in table.names() if table.codec(name).knob is not None]
    parser.add_argument("--codecs", default=",".join(steered))
    parser.add_argument("--switch-kbps", type=float, default=2000.0, help="target of the streams that switch")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    others = dict(item.split("=", 1) for item in given.set)
    drives = {
        name: long_enough(list(api.read_frames(spec, FRAMING)))
        for name, _, spec in (s.partition("=") for s in given.sources)
    }
    print("| drive | codec | can send | target | mean | worst 5 s | highest 1 s |\n|---|---|---|---|---|---|---|")
    for name, frames in drives.items():
        for codec in given.codecs.split(","):
            low, high = ends_kbps(frames, codec, others)
            for fraction in FRACTIONS:
                target = round(math.exp(math.log(low) + fraction * math.log(high / low)), -1)
                sent = run(frames, settings_from({"codec": codec, "target_kbps": target, **others}))
                five, one = sent.means(5.0), sent.means(1.0)
                worst = five[np.argmax(abs(five / target - 1))] / target - 1
                print(f"| {name} | {codec} | {low:.0f} - {high:.0f} | {target:.0f} | {five.mean():.0f} |"
                      f" {100 * worst:+.1f} % | {one.max() / target:.2f} |", flush=True)  # fmt: skip
    target, codecs = given.switch_kbps, given.codecs.split(",")
    print("\n| drives | switch | target | worst 5 s | highest 1 s | second after |\n|---|---|---|---|---|---|")
    for name, frames in drives.items():
        for one, other in pairwise([*codecs, codecs[0]] if len(codecs) > 1 else codecs):
            middle = len(frames) // 2
            settings = settings_from({"codec": one, "target_kbps": target, **others})
            _row(name, f"{one} to {other}", target, run(frames, settings, {middle: {"codec": other}}), middle)
    if len(drives) > 1:
        halves = [frames[: len(frames) // 2] for frames in drives.values()]
        joined = [frame.with_(index=i) for i, frame in enumerate(chain.from_iterable(halves))]
        for codec in codecs:
            settings = settings_from({"codec": codec, "target_kbps": target, **others})
            _row(" then ".join(drives), f"scene, {codec}", target, run(joined, settings), len(halves[0]))


def _row(name: str, what: str, target: float, sent: Sent, switch: int) -> None:
    five = sent.means(5.0) / target - 1
    begin = sent.seconds[:switch].sum()
    after = sent.means(1.0, begin + 1.0)[0] / target - 1
    print(f"| {name} | {what} | {target:.0f} | {100 * five[np.argmax(abs(five))]:+.1f} % |"
          f" {sent.means(1.0).max() / target:.2f} | {100 * after:+.1f} % |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
