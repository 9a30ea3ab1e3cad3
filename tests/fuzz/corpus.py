"""Valid messages of every codec and configuration at its extremes, made from a seed: what the fuzzers begin with.

The idea is zstd's decodecorpus. A fuzzer that starts with valid extremes damages what lies deep inside of a decoder,
where one that starts with nothing seldom comes.

    python -m tests.fuzz.corpus --seed 1 OUT

writes a folder of messages for each configuration, and one for each harness of native/fuzz with what it reads.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.network.learner import Offer
from lidarcodec.network.networks import CASES, Net
from lidarcodec.network.shelf import native_nets, networks_of, weights_of
from lidarcodec.network.update import update_of
from lidarcodec.network.weight_file import pack_weights
from lidarcodec.packet_rest import PacketRest
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import settings_from
from lidarcodec.wire import pack, unpack
from tests.fuzz import configurations, extremes, native_seeds, other_sensors


class Stream(NamedTuple):
    """Messages of one stream, the first of them a key message, as bytes and as their parts.

    name, size: a configuration
    """

    name: str
    size: str
    messages: tuple[bytes, ...]
    parts: tuple[Message, ...]

    @classmethod
    def of(cls, plan: Plan, messages: tuple[bytes, ...]) -> Stream:
        """The stream of a configuration, of its messages."""
        return cls(plan.name, plan.size, messages, tuple(map(unpack, messages)))


class Plan(NamedTuple):
    """What makes a stream; `share`: how much of a long run is spent on it."""

    name: str
    settings: dict[str, Any]
    size: str
    share: float
    weights: bool = False

    @property
    def reduced(self) -> bool:
        """Whether returns were left out of frames of all columns."""
        return not self.thinned and "reduction" in self.settings

    @property
    def thinned(self) -> bool:
        """Whether columns were left out."""
        return str(self.settings.get("reduction")).startswith("lattice")

    @property
    def other(self) -> bool:
        """Whether its frames are of another sensor than an HDL-64E, or point clouds."""
        return self.size in other_sensors.SIZES

    @property
    def follows(self) -> bool:
        """Whether each frame of another sensor goes on from what the one before taught."""
        own = self.settings.get("codec_settings", {})
        return self.other and self.size != "clouds" and self.settings["codec"] == "riddle" and own.get("memory", True)

    @property
    def free(self) -> bool:
        """Whether ranges are free within a bound."""
        bounded = self.settings["codec"] in ("riddle", "predictive") and "max_error_m" in self.settings
        return not self.other and bounded and self.settings.get("shape") != "rounded"

    @property
    def few(self) -> bool:
        """Whether intensities have few values."""
        return self.settings.get("intensity", "auto").partition("=")[0] in ("levels", "error")

    @property
    def aimed(self) -> bool:
        """Whether there is a target bitrate."""
        return "target_kbps" in self.settings


SHARES = {
    "extremes": 4.0,
    "tiny": 6.0,
    "slab": 1.0,
    "full-size": 0.2,
    "still": 0.7,
    "positions": 2.0,
    "widest": 0.03,
}
OTHER_SHARES = {model: {"os0-128": 0.3, "os0-16": 1.5, "clouds": 5.0}.get(model, 1.0) for model in other_sensors.SIZES}
_FAR_NS = 2**62
_SOME = ("extremes", "tiny", "slab", "full-size")
_OF: tuple[tuple[configurations.Named, float, tuple[str, ...]], ...] = (
    (configurations.PLAIN, 1, tuple(SHARES)),
    (configurations.MORE, 1 / 2, ("extremes", "tiny", "full-size")),
    (configurations.FEW, 1 / 2, ("extremes", "slab")),
    (configurations.FREE, 1, _SOME),
    (configurations.ROUNDED, 1 / 2, _SOME),
    (configurations.REDUCED, 1 / 2, ("extremes", "slab", "full-size")),
    (configurations.THINNED, 3 / 4, ("extremes", "slab", "positions", "full-size")),
    (configurations.AIMED, 1, ("slab", "full-size")),
    (configurations.WEIGHTS, 1 / 4, ("tiny", "slab", "full-size")),
    (configurations.OTHERS, 1, ("vlp16", "pandar64", "xt32", "os0-16")),
    (
        configurations.OTHER_PLAIN,
        1,
        ("puck_hires", "hdl32e", "vlp32c", "vls128", "pandar40p", "qt64", "qt128", "xt16", "xt32m", "os0-128"),
    ),
    (configurations.CLOUDS, 1, ("clouds",)),
)
"""Configurations, how much of a size's share each gets, and in which sizes it is made."""


def plans() -> list[Plan]:
    """All configurations."""
    shares = SHARES | OTHER_SHARES
    return [
        Plan(name, given, size, shares[size] * part, weights=of is configurations.WEIGHTS)
        for of, part, sizes in _OF
        for name, given in of.items()
        for size in sizes
    ]


def _coded(settings: dict[str, Any], made: list[Frame]) -> tuple[bytes, ...]:
    encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
    if settings["codec"] == "jpeg-layered":  # a group whose frames lie centuries apart is refused
        made = [frame for frame in made if abs(frame.stamp_ns) < _FAR_NS]
    begins = zip(made, [None, *made[:-1]], strict=True)
    messages = [message for frame, before in begins for message in encoder.encode(frame, key=_begins(frame, before))]
    return tuple(map(pack, messages + encoder.flush()))


def _begins(frame: Frame, before: Frame | None) -> bool:
    """Whether a frame is sent as a key frame: the first one, and of other sensors each after one of another kind."""
    if before is None or not isinstance(frame.side, PacketRest) or not isinstance(before.side, PacketRest):
        return before is None
    return (frame.sensor.hash, frame.side.layout) != (before.sensor.hash, before.side.layout)


class _Taught:
    """Stands for a learner that has something to offer after the first frame, and then no more."""

    def __init__(self, offer: Offer, of: tuple[str, int, bool]) -> None:
        self.of, self._offer, self._frames = of, offer, 0

    def offered(self) -> Offer | None:
        self._frames += 1
        return self._offer if self._frames == 2 else None

    def samples_of(self, frame: Frame, *, expects: bool) -> None:
        """Nothing: it learns no more."""


@cache
def _other_nets() -> tuple[Net, Net]:
    """Networks as those of the package, and not the same: alone, expecting; with biases of cases."""
    base, numbers, nets = weights_of(""), np.random.default_rng(3), []
    for expects in (False, True):
        first, *rest = (
            replace(of, weights=(of.weights + numbers.normal(0, 30, of.weights.shape)).astype(np.int16))
            for of in base.net(expects=expects, size=0).layers
        )
        cases = numbers.integers(-60, 60, (CASES, len(first.bias))).astype(np.int8)
        nets.append(Net(expects, 0, (replace(first, cases=cases), *rest)))
    return nets[0], nets[1]


def _with_weights(settings: dict[str, Any], made: list[Frame]) -> tuple[bytes, ...]:
    """A stream whose key message brings a weight file."""
    with tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-") as folder:
        path = Path(folder) / "own.lcrw"
        path.write_bytes(pack_weights(_other_nets(), {"trained on": "nothing"}))
        return _coded({**settings, "codec_settings": {"weights": str(path)}}, made)


def _with_updates(settings: dict[str, Any], made: list[Frame]) -> tuple[bytes, ...]:
    """A stream whose second message brings an update of weights, and a key message at its end that brings it again."""
    base = weights_of("")
    update = update_of(base, _other_nets(), (5, 6, 6, 5))
    offer = Offer(update.weights, native_nets(networks_of(update.weights, 2)), update, 0.0)
    encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
    encoder._encoder._ranges._learner = _Taught(offer, (base.name, 0, True))  # type: ignore[attr-defined]
    messages = [message for frame in made for message in encoder.encode(frame, key=frame.index == made[0].index)]
    again = made[-1].with_(index=made[-1].index + 1)
    return tuple(map(pack, messages + encoder.encode(again, key=True)))


def stream(plan: Plan, seed: int) -> Stream:
    """The stream of a configuration."""
    coded = _coded
    if plan.weights:
        coded = _with_updates if "updates" in plan.name else _with_weights
    made = (extremes.SIZES | other_sensors.SIZES)[plan.size](seed)
    return Stream.of(plan, coded(plan.settings, made))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only-native", action="store_true", help="only what the harnesses of native/fuzz read")
    options = parser.parse_args()
    for plan in [] if options.only_native else plans():
        _write(options.out / f"{plan.name}, {plan.size}".replace(" ", "_"), stream(plan, options.seed).messages)
    for harness in native_seeds.HARNESSES:
        _write(options.out / harness, native_seeds.seeds(harness, options.seed))


def _write(folder: Path, made: Sequence[bytes]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(made):
        (folder / f"{number:04}").write_bytes(data)


if __name__ == "__main__":
    main()
