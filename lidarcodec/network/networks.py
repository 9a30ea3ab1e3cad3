"""Networks of codec `riddle`: small, in whole numbers, and in a file together with what they were trained on.

A network looks at int8 inputs, 32 of them to a unit, and gives 32 log odds, of which 32768 are six natural units. Two
hidden layers of 0..255 (8 to a unit); all sums fit 32 bits, which is checked when a network is made, so that any order
of adding gives the same. `run` is the reference of what the native core does; files are weight_file.py.

>>> rng = np.random.default_rng(1)
>>> sizes = [(8, 72), (8, 8), (32, 8)]
>>> net = quantised(False, 0, [(rng.normal(0, 0.2, size), np.zeros(size[0])) for size in sizes])
>>> run(net, np.zeros((2, 72), np.int8)).shape
(2, 32)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, SettingsError, UnknownNameError
from lidarcodec.network.tiles import tiles_left

INPUTS_ALONE: Final = 72
"""Inputs of a network for frames without expected ranges."""
INPUTS_EXPECTING: Final = 112
OUTPUTS: Final = 32
"""Log odds: 1 to 15 of the nodes of the tree of leaves, 16 to 31 of the first offset bit in leaf 0 to 15."""
INPUT_UNIT: Final = 32
MIDDLE_BITS: Final = 3
MIDDLE_TOP: Final = (1 << (5 + MIDDLE_BITS)) - 1
"""Largest output of a hidden layer, just under 32 units."""
OUTPUT_UNIT: Final = 32768 / 6
"""Output of one natural unit of log odds."""
SHIFTS: Final = (range(3, 14), range(3, 14), range(9, 14))
"""By how many bits the weights of each layer may be shifted."""
_MORE: Final = (2, 0, -9)
"""Additional shift of the sums of each layer. Units of its inputs and outputs: 32 and 8, 8 and 8, 8 and 4096."""
_MOST_HALF: Final = 1 << 14
"""Largest number that is added to a sum to round it."""
LAYERS: Final = 3
ROW_CASES: Final = 64
SCALE_CASES: Final = 32
CASES: Final = ROW_CASES + SCALE_CASES
"""Rows and scales, each of which may have biases of its own in the first layer."""
CASE_BITS: Final = 6
"""Fraction bits of these biases: a unit has 64 steps."""
_ROW_INPUT: Final = 52
_SCALE_INPUT: Final = 47
_HIDDEN: Final = range(8, 257, 8)
_INT32: Final = 2**31 - 1
_LARGEST_INPUT: Final = (128, MIDDLE_TOP, MIDDLE_TOP)
SIZES: Final = ("small", "large", "largest")
"""Size classes of networks, by number."""

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer: weights (out, in) int16 shifted by `shift` bits, bias (out,) int32 in units of the sums. Read-only.

    cases: (96, out) int8, more biases, of which a return has those of its row (64) and those of its scale (32); or
           (0, out): no such biases, as in all layers but a first one
    """

    weights: npt.NDArray[np.int16]
    bias: npt.NDArray[np.int32]
    shift: int
    cases: npt.NDArray[np.int8] = field(default_factory=lambda: np.empty((0, 0), np.int8))

    def __post_init__(self) -> None:
        if not self.cases.size:
            object.__setattr__(self, "cases", np.empty((0, len(self.bias)), np.int8))
        self.weights.flags.writeable = self.bias.flags.writeable = self.cases.flags.writeable = False

    @property
    def given(self) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.int32], int, npt.NDArray[np.int8]]:
        """As the native core takes it."""
        return self.weights, self.bias, self.shift, self.cases

    @property
    def few_tiles(self) -> bool:
        """Whether some tiles have no weights: files and processors leave them out."""
        return not tiles_left(self.weights).all()

    @property
    def in_bytes(self) -> bool:
        """Whether all weights fit 8 bits: files keep them so, and processors multiply them twice as fast."""
        return bool(self.weights.min(initial=0) >= -128 and self.weights.max(initial=0) <= 127)


@dataclass(frozen=True, eq=False)
class Net:
    """A network of three layers. expects: whether it takes expected ranges (112 inputs, else 72); size: class 0 to 2

    Raises SectionError for layers that do not fit each other, a shift out of range, or sums that may pass 32 bits.
    """

    expects: bool
    size: int
    layers: tuple[Layer, ...]

    def __post_init__(self) -> None:
        check_dims(self.expects, self.dims)
        for number, (layer, largest) in enumerate(zip(self.layers, _LARGEST_INPUT, strict=True)):
            out, into = self.dims[number + 1], self.dims[number]
            weights, bias = layer.weights, layer.bias
            if weights.dtype != np.int16 or bias.dtype != np.int32 or bias.shape != (out,) or weights.ndim != 2:
                raise SectionError(f"layer {number + 1} is {weights.dtype}{weights.shape} and {bias.dtype}{bias.shape}")
            if weights.shape[1] != into:
                raise SectionError(f"layer {number + 1} takes {weights.shape[1]} values, not {into}")
            if layer.cases.dtype != np.int8 or layer.cases.shape not in [(0, out), (CASES, out)][: 2 - (number > 0)]:
                raise SectionError(f"layer {number + 1} has biases of cases {layer.cases.dtype}{layer.cases.shape}")
            if layer.shift not in (shifts := SHIFTS[number]):
                raise SectionError(
                    f"layer {number + 1} shifted by {layer.shift} bits: {shifts[0]} to {shifts[-1]} are possible"
                )
            wide = layer.weights.astype(np.int64), layer.bias.astype(np.int64)
            if _largest_sum(*wide, largest, layer.shift if len(layer.cases) else 0) > _INT32:
                raise SectionError(f"sums of layer {number + 1} of a network may pass 32 bits")

    @property
    def dims(self) -> tuple[int, ...]:
        """Inputs, the two hidden layers, outputs."""
        if len(self.layers) != LAYERS:
            raise SectionError(f"a network of {len(self.layers)} layers, not {LAYERS}")
        return (int(self.layers[0].weights.shape[1]), *(len(layer.weights) for layer in self.layers))

    @property
    def inputs(self) -> int:
        """72 or 112."""
        return self.dims[0]

    @property
    def size_name(self) -> str:
        """`small`, `large` or `largest`."""
        return SIZES[self.size]


@dataclass(frozen=True, eq=False)
class Weights:
    """A weight file. name: the first 8 bytes of its SHA-256, 16 hex digits; data: its bytes, to be sent as they are.

    provenance: on what the networks were trained, how long, under which licence
    """

    nets: tuple[Net, ...]
    provenance: Mapping[str, Any]
    name: str
    data: bytes

    def net(self, *, expects: bool, size: int) -> Net:
        """The network of this kind and size; of the nearest size that the file has, of two the smaller.

        Raises UnknownNameError if the file has none of the kind.
        """
        kind = sorted(
            (net for net in self.nets if net.expects == expects), key=lambda net: (abs(net.size - size), net.size)
        )
        if not kind:
            wanted = "expecting" if expects else "alone"
            raise UnknownNameError(
                "network", wanted, sorted({"expecting" if n.expects else "alone" for n in self.nets})
            )
        return kind[0]


def check_dims(expects: bool, dims: Sequence[int]) -> None:
    """Checks inputs, hidden layers and outputs of a network. Raises SectionError."""
    inputs = INPUTS_EXPECTING if expects else INPUTS_ALONE
    inside = dims[1:-1]
    if len(dims) != LAYERS + 1 or dims[0] != inputs or dims[-1] != OUTPUTS or any(n not in _HIDDEN for n in inside):
        raise SectionError(
            f"a network of {'-'.join(map(str, dims))}: {inputs}, twice 8 to 256 by 8, and {OUTPUTS} are possible"
        )


def _largest_sum(weights: Integers, bias: Integers, largest: int, case_shift: int) -> int:
    """The largest sum of a layer. case_shift: its shift if it has biases of rows and scales, else 0."""
    of_cases = 2 * 128 << case_shift - 1 if case_shift else 0
    return int((np.abs(weights).sum(axis=1) * largest + np.abs(bias)).max()) + of_cases + _MOST_HALF


def quantised(
    expects: bool,
    size: int,
    layers: Sequence[tuple[npt.NDArray[np.floating[Any]], npt.NDArray[np.floating[Any]]]],
    cases: npt.NDArray[np.floating[Any]] | None = None,
) -> Net:
    """The network in integers: each layer shifted by as much as fits. layers: weights (out, in) and bias (out,), float.

    cases: (96, out) biases of rows and scales in the first layer, kept within what 8 bits hold; None: there are none
    A first layer that is exact in 8 bits is kept in them: it takes half the time where processors multiply bytes.
    Raises SettingsError for weights that are not finite or too large.
    """
    made = []
    for number, ((weights, bias), largest) in enumerate(zip(layers, _LARGEST_INPUT, strict=True)):
        scale = OUTPUT_UNIT / 4096 if number == LAYERS - 1 else 1.0
        unit = INPUT_UNIT if number == 0 else 1 << MIDDLE_BITS
        wanted = np.asarray(weights, np.float64) * scale, np.asarray(bias, np.float64) * scale
        if not all(np.isfinite(values).all() and np.abs(values).max(initial=0) < 2**24 for values in wanted):
            raise SettingsError(f"layer {number + 1} has weights that are not finite, or far too large")
        for shift in [*_exact_in_bytes(wanted[0], number), *reversed(SHIFTS[number])]:
            w, b = (np.rint(values * 2.0**shift * times).astype(np.int64)
                    for values, times in zip(wanted, (1, unit), strict=True))  # fmt: skip
            of_cases = _whole_cases(None if number else cases, len(b))
            if np.abs(w).max() <= 32767 and _largest_sum(w, b, largest, shift if len(of_cases) else 0) <= _INT32:
                made.append(Layer(w.astype(np.int16), b.astype(np.int32), shift, of_cases))
                break
        else:
            raise SettingsError(f"the weights of layer {number + 1} are too large for whole numbers")
    return Net(expects, size, tuple(made))


def _whole_cases(cases: npt.NDArray[np.floating[Any]] | None, out: int) -> npt.NDArray[np.int8]:
    if cases is None:
        return np.empty((0, out), np.int8)
    if not np.isfinite(cases).all():
        raise SettingsError("biases of cases that are not finite")
    whole: npt.NDArray[np.int8] = np.clip(np.rint(cases * 2.0**CASE_BITS), -127, 127).astype(np.int8)
    return whole


def cases_in_floats(net: Net) -> npt.NDArray[np.float64] | None:
    """Biases of rows and scales as `quantised` takes them; None where there are none."""
    cases = net.layers[0].cases
    return cases.astype(np.float64) * 2.0**-CASE_BITS if len(cases) else None


def in_floats(net: Net) -> list[tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]:
    """Weights (out, in) and bias (out,) of each layer as `quantised` takes them."""
    found = []
    for number, layer in enumerate(net.layers):
        scale = 2.0**-layer.shift / (OUTPUT_UNIT / 4096 if number == LAYERS - 1 else 1.0)
        unit = INPUT_UNIT if number == 0 else 1 << MIDDLE_BITS
        found.append((layer.weights.astype(np.float64) * scale, layer.bias * scale / unit))
    return found


def _exact_in_bytes(weights: npt.NDArray[np.float64], layer: int) -> list[int]:
    """The smallest shift at which the weights of the first layer are whole numbers of 8 bits, if there is one."""
    if layer > 0:
        return []
    scaled = [(shift, weights * 2.0**shift) for shift in SHIFTS[layer]]
    return [n for n, w in scaled if w.min() >= -128 and w.max() <= 127 and np.array_equal(w, np.rint(w))][:1]


def run(net: Net, inputs: npt.NDArray[np.int8]) -> npt.NDArray[np.int16]:
    """(n, 32) int16 log odds of (n, 72 or 112) int8 inputs; raises SectionError for another shape or type."""
    if inputs.dtype != np.int8 or inputs.ndim != 2 or inputs.shape[1] != net.inputs:
        raise SectionError(f"inputs are {inputs.dtype}{inputs.shape}, not int8(n, {net.inputs})")
    first, second, third = net.layers
    hidden = np.clip(_sums(first, inputs, _MORE[0], _of_cases(first, inputs)), 0, MIDDLE_TOP)
    hidden = np.clip(_sums(second, hidden, _MORE[1]), 0, MIDDLE_TOP)
    odds: npt.NDArray[np.int16] = np.clip(_sums(third, hidden, _MORE[2]), -32768, 32767).astype(np.int16)
    return odds


def cases_of(inputs: Any) -> tuple[Any, Any]:
    """Which of the 96 cases the row and the scale of returns are, (n,) each. inputs: (n, 72 or 112) whole numbers, an
    array or a tensor, wider than 8 bits."""
    row = ((inputs[:, _ROW_INPUT] + 64) >> 1).clip(0, ROW_CASES - 1)
    return row, ROW_CASES + ((inputs[:, _SCALE_INPUT] + 50) >> 2).clip(0, SCALE_CASES - 1)


def _of_cases(layer: Layer, inputs: npt.NDArray[np.int8]) -> Integers:
    """What biases of cases add to sums: they have 64 steps to a unit, sums 32 times 2^shift."""
    if not len(layer.cases):
        return np.zeros((1, len(layer.bias)), np.int64)
    wide = layer.cases.astype(np.int64) << (layer.shift - 1)
    rows, scales = cases_of(inputs.astype(np.int64))
    added: Integers = wide[rows] + wide[scales]
    return added


def _sums(layer: Layer, values: npt.NDArray[np.signedinteger[Any]], more: int, add: Integers | int = 0) -> Integers:
    """Sums of a layer, in units of its outputs, rounded."""
    shift = layer.shift + more
    exact = values.astype(np.float64) @ layer.weights.T.astype(np.float64)  # below 2^53, so exact in any order
    sums: Integers = exact.astype(np.int64) + layer.bias + add + ((1 << shift) >> 1)
    return sums >> shift
