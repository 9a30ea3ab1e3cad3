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

from lidarcodec.codecs import table
from lidarcodec.codecs.riddle_learner import Offer
from lidarcodec.codecs.riddle_shelf import native_nets, networks_of, weights_of
from lidarcodec.codecs.riddle_update import update_of
from lidarcodec.codecs.riddle_weight_file import pack_weights
from lidarcodec.codecs.riddle_weights import CASES, Net
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import settings_from
from lidarcodec.wire import pack, unpack
from tests.fuzz import extremes, native_seeds

PLAIN: dict[str, dict[str, Any]] = {name: {"codec": name} for name in table.names()}
"""Each codec as it is by default."""

MORE: dict[str, dict[str, Any]] = {
    "zstd bounded": {"codec": "zstd", "max_error_m": 0.05, "intensity": "off"},
    "pcodec 1 cm": {"codec": "pcodec", "max_error_m": 0.01, "intensity": "levels=16"},
    "png bounded": {"codec": "png", "max_error_m": 20.0, "intensity": "levels=2"},
    "jxl effort 3": {"codec": "jxl", "codec_settings": {"effort": 3}, "intensity": "levels=256"},
    "riddle effort 1": {"codec": "riddle", "codec_settings": {"effort": 1}, "intensity": "levels=3"},
    "riddle effort 3": {"codec": "riddle", "max_error_m": 0.02, "codec_settings": {"effort": 3}},
    "riddle effort 4": {"codec": "riddle", "codec_settings": {"effort": 4}, "intensity": "off"},
    "riddle alone": {"codec": "riddle", "codec_settings": {"memory": False}, "max_error_m": 0.25},
    "predictive motion": {"codec": "predictive", "codec_settings": {"motion": True, "effort": 2}},
    "predictive bounded": {"codec": "predictive", "max_error_m": 0.05, "intensity": "levels=128"},
}
"""Other settings, each of which another part of a message follows."""

REDUCED: dict[str, dict[str, Any]] = {
    "raw columns": {"codec": "raw", "reduction": "columns:4"},
    "zstd random": {"codec": "zstd", "reduction": "random", "keep_fraction": 0.1},
    "pcodec voxel": {"codec": "pcodec", "reduction": "voxel", "keep_fraction": 0.3},
    "png random": {"codec": "png", "reduction": "random", "keep_fraction": 0.5},
    "jxl columns": {"codec": "jxl", "reduction": "columns:2"},
    "jpeg columns": {"codec": "jpeg", "reduction": "columns:3"},
    "jpeg-layered random": {"codec": "jpeg-layered", "reduction": "random", "keep_fraction": 0.4},
    "h264 columns": {"codec": "h264", "reduction": "columns:2"},
    "h264-log voxel": {"codec": "h264-log", "reduction": "voxel", "keep_fraction": 0.5},
    "riddle columns": {"codec": "riddle", "reduction": "columns:4"},
    "predictive random": {"codec": "predictive", "reduction": "random", "keep_points": 60},
}


class Stream(NamedTuple):
    """Messages of one stream, the first of them a key message, as bytes and as their parts.

    name, codec, size: a configuration; reduced: whether returns were left out; weights: whether networks are sent
    """

    name: str
    codec: str
    size: str
    reduced: bool
    weights: bool
    messages: tuple[bytes, ...]
    parts: tuple[Message, ...]

    @classmethod
    def of(cls, plan: Plan, messages: tuple[bytes, ...]) -> Stream:
        """The stream of a configuration, of its messages."""
        codec = plan.settings.get("codec", "riddle")
        return cls(plan.name, codec, plan.size, plan.reduced, plan.weights, messages, tuple(map(unpack, messages)))


class Plan(NamedTuple):
    """What makes a stream; `share`: how much of a long run is spent on it."""

    name: str
    settings: dict[str, Any]
    size: str
    share: float
    reduced: bool = False
    weights: bool = False


SHARES = {"extremes": 4.0, "tiny": 6.0, "slab": 1.0, "full-size": 0.2, "still": 0.7, "widest": 0.03}
_FAR_NS = 2**62


def plans() -> list[Plan]:
    """All configurations."""
    made = [Plan(name, given, size, SHARES[size]) for name, given in PLAIN.items() for size in extremes.SIZES]
    for name, given in MORE.items():
        made += [Plan(name, given, size, SHARES[size] / 2) for size in ("extremes", "tiny", "full-size")]
    for name, given in REDUCED.items():
        made += [Plan(name, given, size, SHARES[size] / 2, reduced=True) for size in ("extremes", "slab", "full-size")]
    for name in ("riddle own weights", "riddle updates"):
        made += [Plan(name, {}, size, SHARES[size] / 4, weights=True) for size in ("tiny", "slab", "full-size")]
    return made


def _coded(settings: dict[str, Any], made: list[Frame]) -> tuple[bytes, ...]:
    encoder = StreamEncoder(settings_from({"key_interval": 100_000, **settings}), stream_id=1)
    if settings["codec"] == "jpeg-layered":  # a group whose frames lie centuries apart is refused
        made = [frame for frame in made if abs(frame.stamp_ns) < _FAR_NS]
    messages = [message for frame in made for message in encoder.encode(frame, key=frame.index == made[0].index)]
    return tuple(map(pack, messages + encoder.flush()))


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


def _with_weights(made: list[Frame]) -> tuple[bytes, ...]:
    """A stream whose key message brings a weight file."""
    with tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-") as folder:
        path = Path(folder) / "own.lcrw"
        path.write_bytes(pack_weights(_other_nets(), {"trained on": "nothing"}))
        return _coded({"codec": "riddle", "codec_settings": {"weights": str(path)}}, made)


def _with_updates(made: list[Frame]) -> tuple[bytes, ...]:
    """A stream whose second message brings an update of weights, and a key message at its end that brings it again."""
    base = weights_of("")
    update = update_of(base, _other_nets(), (5, 6, 6, 5))
    offer = Offer(update.weights, native_nets(networks_of(update.weights, 2)), update, 0.0)
    encoder = StreamEncoder(settings_from({"codec": "riddle", "key_interval": 100_000}), stream_id=1)
    encoder._encoder._learner = _Taught(offer, (base.name, 0, True))  # type: ignore[attr-defined]
    messages = [message for frame in made for message in encoder.encode(frame, key=frame.index == made[0].index)]
    again = made[-1].with_(index=made[-1].index + 1)
    return tuple(map(pack, messages + encoder.encode(again, key=True)))


_SPECIAL = {"riddle own weights": _with_weights, "riddle updates": _with_updates}


def stream(plan: Plan, seed: int) -> Stream:
    """The stream of a configuration."""
    made = extremes.SIZES[plan.size](seed)
    messages = _SPECIAL[plan.name](made) if plan.name in _SPECIAL else _coded(plan.settings, made)
    return Stream.of(plan, messages)


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
