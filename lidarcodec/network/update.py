"""Updates of weights: what networks became that were trained in a stream, as differences to weights known before.

An update names the weights that it begins with and those that it gives. Both are files (networks.py), and a name is
the hash of its file, so a decoder that has applied an update knows that it has what the encoder has. Differences are
whole numbers of 2^grain steps of a weight, a grain for each layer. They are small, and entropy-coded: 3 to 30 kB, where
a file of the same networks takes up to 105. docs/wire-format-riddle-weights.md has the format.

>>> from lidarcodec.network.networks import quantised
>>> rng = np.random.default_rng(1)
>>> sizes = [(8, 72), (8, 8), (32, 8)]
>>> net = quantised(False, 0, [(rng.normal(0, 0.2, size), np.zeros(size[0])) for size in sizes])
>>> base = weights_with([net])
>>> update = update_of(base, [net], (7, 7, 7, 5))
>>> applied(update.data, lambda name: base).name == update.weights.name
True
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec._native import crc32c
from lidarcodec.entropy.fast import decode_numbers, encode_numbers
from lidarcodec.errors import ChecksumError, SectionError, UnsupportedVersionError
from lidarcodec.network.networks import CASE_BITS, CASES, SIZES, Layer, Net, Weights
from lidarcodec.network.weight_file import Reader, pack_weights, unpack_weights

MAGIC: Final = b"LCRU"
VERSION: Final = 1
MAX_GRAIN: Final = 12
_BIAS_BITS: Final = (5, 3, 3)
"""A step of a bias is so many bits smaller than one of a weight, in each layer."""
_NAME_BYTES: Final = 8
_HEAD_BYTES: Final = len(MAGIC) + 1 + 2 * _NAME_BYTES + 1
_NET_BYTES: Final = 6
"""Kind, size, and the grains of three layers and of biases of cases."""
_MOST: Final = 1 << 32
_INT8: Final = 2**7 - 1
_INT16: Final = 2**15 - 1
_INT32: Final = 2**31 - 1

Whole = npt.NDArray[np.int64]
Stored = npt.NDArray[np.int16] | npt.NDArray[np.int32] | Whole


@dataclass(frozen=True, eq=False)
class Update:
    """An update. data: its bytes; weights: what it gives; base: name of what it begins with."""

    data: bytes
    weights: Weights
    base: str


def weights_with(nets: Sequence[Net]) -> Weights:
    """Weights of these networks, without a provenance: what is in use is sent, no more."""
    return unpack_weights(pack_weights(nets, {}))


def is_update(data: bytes) -> bool:
    """Whether the bytes of a WEIGHTS section are an update, and not a file."""
    return data[: len(MAGIC)] == MAGIC


def update_of(base: Weights, nets: Sequence[Net], fineness: tuple[int, int, int, int]) -> Update:
    """What turns `base` into networks near `nets`: weights of layer i differ by multiples of 2^-fineness[i], biases of
    cases by those of 2^-fineness[3], or of what they are kept in, if that is more. Layers that fit 8 bits go on fitting
    them, and all networks then have biases of cases.

    nets: of kinds and sizes that `base` has, layers alike; they need not be on the same shifts
    Raises SectionError for others, or if sums may pass 32 bits.
    """
    heads, streams, given = [], [], []
    for net in nets:
        before = _net_of(base, net.expects, net.size)
        if before.dims != net.dims:
            raise SectionError(f"a network of {net.dims} cannot come of one of {before.dims}")
        layers = []
        grains = [max(0, layer.shift - fine) for layer, fine in zip(before.layers, fineness[:3], strict=True)]
        of_cases = max(0, CASE_BITS - fineness[3])
        for old, new, grain, more in zip(before.layers, net.layers, grains, _BIAS_BITS, strict=True):
            scale = 2.0 ** (old.shift - new.shift)
            weights = _steps(new.weights * scale, old.weights, grain, np.int64(_INT8 if old.in_bytes else _INT16))
            bias = _steps(new.bias * scale, old.bias, grain + more, np.int64(_INT32))
            streams += [_folded(weights), _folded(bias)]
            layers.append(_moved(old, weights, bias, grain, grain + more))
        was, wanted = _cases(before), _cases(net)
        cases = _steps(wanted, was, of_cases, np.int64(_INT8))
        streams.append(_folded(cases))
        layers[0] = replace(layers[0], cases=_moved_cases(was, cases, of_cases))
        given.append(Net(net.expects, net.size, tuple(layers)))
        heads.append(bytes([net.expects, net.size, *grains, of_cases]))
    weights_after = weights_with(given)
    names = bytes.fromhex(base.name) + bytes.fromhex(weights_after.name)
    body = b"".join([MAGIC, bytes([VERSION]), names, bytes([len(nets)]), *heads, encode_numbers(streams)])
    return Update(body + int(crc32c(body)).to_bytes(4, "little"), weights_after, base.name)


def names_of(data: bytes) -> tuple[str, str]:
    """Names of the weights that an update begins with, and of those that it gives.

    Raises TruncatedError, UnsupportedVersionError or ChecksumError.
    """
    reader = Reader(data[:-4])
    reader.take(len(MAGIC))
    if (version := reader.number(1)) != VERSION:
        raise UnsupportedVersionError(
            f"an update of weights of version {version}: this build reads version {VERSION}", len(MAGIC)
        )
    names = reader.take(_NAME_BYTES).hex(), reader.take(_NAME_BYTES).hex()
    if int(crc32c(data[:-4])) != int.from_bytes(data[-4:], "little"):
        raise ChecksumError("the checksum of an update of weights does not match", len(data) - 4)
    return names


def applied(data: bytes, find: Callable[[str], Weights]) -> Weights:
    """The weights that an update gives, from anybody: nothing is used before it is checked. find: weights by name.

    Raises what `find` does, else TruncatedError, UnsupportedVersionError, ChecksumError or SectionError.
    """
    of, to = names_of(data)
    base = find(of)
    reader = Reader(data[:-4])
    reader.take(_HEAD_BYTES - 1)
    changed = [_named(base, reader) for _ in range(reader.number(1))]
    if not 1 <= len(changed) <= len(base.nets):
        raise SectionError(f"an update of {len(changed)} networks", reader.at)
    if len({(net.expects, net.size) for net, _ in changed}) != len(changed):
        raise SectionError("an update with two networks of one kind and size", reader.at)
    counts = []
    for net, _ in changed:
        counts += [values.size for layer in net.layers for values in (layer.weights, layer.bias)]
        counts.append(_cases(net).size)
    streams = iter(decode_numbers(reader.take(reader.left), counts))
    nets = []
    for net, grains in changed:
        layers = []
        for layer, grain, more in zip(net.layers, grains[:3], _BIAS_BITS, strict=True):
            weights = _unfolded(next(streams)).reshape(layer.weights.shape)
            layers.append(_moved(layer, weights, _unfolded(next(streams)), grain, grain + more))
        cases = _moved_cases(_cases(net), _unfolded(next(streams)).reshape(_cases(net).shape), grains[3])
        layers[0] = replace(layers[0], cases=cases)
        nets.append(Net(net.expects, net.size, tuple(layers)))
    given = weights_with(nets)
    if given.name != to:
        raise SectionError(f"an update gives weights {given.name} and says {to}")
    return given


def _net_of(weights: Weights, expects: bool, size: int) -> Net:
    for net in weights.nets:
        if (net.expects, net.size) == (expects, size):
            return net
    raise SectionError(f"an update of a network that weights {weights.name} do not have")


def _named(base: Weights, reader: Reader) -> tuple[Net, bytes]:
    expects, size, *grains = reader.take(_NET_BYTES)
    if expects > 1 or size >= len(SIZES) or max(grains) > MAX_GRAIN:
        raise SectionError(f"an update of a network of kind {expects}, size {size}, grains {grains}", reader.at)
    return _net_of(base, bool(expects), size), bytes(grains)


def _steps(wanted: npt.NDArray[np.floating[Any]] | Whole, was: Stored, grain: int, top: np.int64) -> Whole:
    """Differences in units of 2^grain, such that sums are `top` at most on either side."""
    least, most = -((was + top) >> grain), (top - was) >> grain
    found: Whole = np.clip(np.rint((wanted - was) * 2.0**-grain).astype(np.int64), least, most)
    return found


def _moved(layer: Layer, weights: Whole, bias: Whole, grain: int, bias_grain: int) -> Layer:
    """A layer with steps added. Raises SectionError where a number does not fit."""
    w, b = layer.weights + (weights << grain), layer.bias + (bias << bias_grain)
    if np.abs(w).max() > _INT16 or np.abs(b).max() > _INT32:
        raise SectionError("an update of a weight beyond what it can be")
    return Layer(w.astype(np.int16), b.astype(np.int32), layer.shift, layer.cases)


def _cases(net: Net) -> Whole:
    """(96, out): biases of cases, 0 where there are none."""
    first = net.layers[0]
    return first.cases.astype(np.int64) if len(first.cases) else np.zeros((CASES, len(first.bias)), np.int64)


def _moved_cases(cases: Whole, steps: Whole, grain: int) -> npt.NDArray[np.int8]:
    """With steps added. Raises SectionError where a number does not fit."""
    moved = cases + (steps << grain)
    if np.abs(moved).max() > _INT8:
        raise SectionError("an update of a bias beyond what it can be")
    return moved.astype(np.int8)


def _folded(steps: Whole) -> npt.NDArray[np.uint64]:
    """Whole numbers of both signs as such of one: 0, -1, 1, -2, ... as 0, 1, 2, 3, ..."""
    flat = steps.ravel()
    return np.where(flat < 0, -2 * flat - 1, 2 * flat).astype(np.uint64)


def _unfolded(numbers: npt.NDArray[np.uint64]) -> Whole:
    if numbers.max(initial=0) >= _MOST:
        raise SectionError("an update of a weight beyond what it can be")
    whole = numbers.astype(np.int64)
    return np.where(whole & 1, -(whole >> 1) - 1, whole >> 1)
