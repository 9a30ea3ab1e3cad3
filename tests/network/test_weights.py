"""If these fail, a weight file means something else on another machine, or a hostile one takes the program down."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec._native import crc32c
from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    HeaderError,
    LidarCodecError,
    SectionError,
    SettingsError,
    SourceError,
    TruncatedError,
    UnknownNameError,
    UnsupportedVersionError,
)
from lidarcodec.network import networks as rw
from lidarcodec.network import weight_file as rf
from lidarcodec.network.shelf import native_nets

Floats = npt.NDArray[np.float64]


def float_layers(inputs: int, hidden: tuple[int, int], seed: int = 1) -> list[tuple[Floats, Floats]]:
    """Layers of random weights, of the size that trained ones have."""
    rng = np.random.default_rng(seed)
    dims = (inputs, *hidden, 32)
    return [(rng.normal(0, 1 / np.sqrt(into), (out, into)), rng.normal(0, 0.3, out)) for into, out in pairwise(dims)]


def four_nets() -> list[rw.Net]:
    """A file's usual contents."""
    return [
        rw.quantised(expects, size, float_layers(112 if expects else 72, ((32, 32), (96, 32))[size]))
        for expects in (False, True)
        for size in (0, 1)
    ]


def with_cases(net: rw.Net, seed: int = 5) -> rw.Net:
    """The network with biases of rows and scales."""
    cases = np.random.default_rng(seed).integers(-128, 128, (rw.CASES, net.dims[1])).astype(np.int8)
    return replace(net, layers=(replace(net.layers[0], cases=cases), *net.layers[1:]))


def without_tiles(
    layers: list[tuple[Floats, Floats]], share: float, rng: np.random.Generator
) -> list[tuple[Floats, Floats]]:
    """The layers with so large a share of their tiles, of sixteen sums and four inputs; the first block has none."""
    made = []
    for weights, biases in layers:
        left = rng.random((-(-len(weights) // 16), weights.shape[1] // 4)) < share
        left[0] = False
        made.append((weights * left.repeat(16, 0)[: len(weights)].repeat(4, 1), biases))
    return made


def with_sum(body: bytes) -> bytes:
    """The bytes with a right checksum."""
    return body + int(crc32c(body)).to_bytes(4, "little")


def test_a_file_comes_back_whole(tmp_path: Path) -> None:
    nets = four_nets()
    data = rf.pack_weights(nets, {"licence": "CC0", "steps": 12, "straße": ["ß"]})
    (tmp_path / "some.weights").write_bytes(data)
    found = rf.read_weights(tmp_path / "some.weights")
    assert dict(found.provenance) == {"licence": "CC0", "steps": 12, "straße": ["ß"]}
    assert [(net.expects, net.size, net.dims) for net in found.nets] == [
        (net.expects, net.size, net.dims) for net in nets
    ]
    for net, was in zip(found.nets, nets, strict=True):
        for layer, before in zip(net.layers, was.layers, strict=True):
            assert np.array_equal(layer.weights, before.weights)
            assert np.array_equal(layer.bias, before.bias)
            assert layer.shift == before.shift
    assert found.data == data
    assert rf.pack_weights(found.nets, found.provenance) == data
    with pytest.raises(ValueError, match="read-only"):
        found.nets[0].layers[0].weights[0, 0] = 1


def test_biases_of_cases_come_back_and_take_nothing_where_there_are_none() -> None:
    plain, mixed = four_nets(), [with_cases(net) if net.expects else net for net in four_nets()]
    data = rf.pack_weights(mixed, {})
    found = rf.unpack_weights(data)
    for net, was in zip(found.nets, mixed, strict=True):
        assert np.array_equal(net.layers[0].cases, was.layers[0].cases)
    assert rf.pack_weights(found.nets, {}) == data
    assert len(data) - len(rf.pack_weights(plain, {})) == rw.CASES * (32 + 96)


def test_a_row_and_a_scale_have_biases_of_their_own() -> None:
    """Of a first layer that is 0 else, what hidden values are is what the row's and the scale's biases add up to."""
    layers = [(np.zeros((out, into)), np.zeros(out)) for into, out in ((72, 8), (8, 8), (8, 32))]
    layers[1][0][:, 0] = layers[2][0][:, 0] = 1.0
    cases = np.zeros((rw.CASES, 8))
    cases[:64, 0], cases[64:, 0] = np.arange(64) / 64, np.arange(32) / 32
    net = rw.quantised(False, 0, layers, cases)
    inputs = np.zeros((64 * 32, 72), np.int8)
    inputs[:, 52], inputs[:, 47] = np.repeat(2 * np.arange(64) - 64, 32), np.tile(4 * np.arange(32) - 50, 64)
    wanted = np.add.outer(np.arange(64) / 64, np.arange(32) / 32).ravel()
    found = rw.run(net, inputs)[:, 3] / rw.OUTPUT_UNIT
    assert np.abs(found - wanted).max() < 0.063  # hidden values have eighths, and are rounded
    for row, scale in ((-128, -128), (127, 127)):  # what no coder gives, but anybody may ask
        inputs[0, 52], inputs[0, 47] = row, scale
        assert 0 <= rw.run(net, inputs[:1])[0, 3] < 2.01 * rw.OUTPUT_UNIT


def test_only_a_first_layer_has_biases_of_cases_and_all_of_them() -> None:
    net = with_cases(four_nets()[0])
    first, second, third = net.layers
    cases = np.zeros((rw.CASES, len(second.bias)), np.int8)
    for wrong in (
        (first, replace(second, cases=cases), third),
        (replace(first, cases=first.cases[:-1]), second, third),
        (replace(first, cases=first.cases[:, :-1]), second, third),
        (replace(first, cases=first.cases.astype(np.int16)), second, third),
    ):
        with pytest.raises(SectionError):
            native_nets([replace(net, layers=wrong)])
    with pytest.raises(SettingsError, match="finite"):
        rw.quantised(False, 0, float_layers(72, (32, 32)), np.full((rw.CASES, 32), np.nan))


def test_the_name_is_that_of_the_bytes() -> None:
    nets = four_nets()[:1]
    first, second = (rf.unpack_weights(rf.pack_weights(nets, {"steps": steps})) for steps in (1, 2))
    assert len(first.name) == 16
    assert first.name != second.name
    assert rf.unpack_weights(first.data).name == first.name


def test_the_size_that_is_missing_is_stood_in_for_by_the_nearest() -> None:
    weights = rf.unpack_weights(rf.pack_weights(four_nets()[2:3], {}))
    assert weights.net(expects=True, size=1).size_name == "small"
    with pytest.raises(UnknownNameError, match="alone"):
        weights.net(expects=False, size=0)
    both = rf.unpack_weights(rf.pack_weights(four_nets(), {}))
    assert both.net(expects=False, size=2).size_name == "large"


@pytest.mark.parametrize("expects", [False, True])
def test_whole_numbers_say_what_floats_say(expects: bool) -> None:
    layers = float_layers(112 if expects else 72, (48, 32))
    net = rw.quantised(expects, 1, layers)
    inputs = np.random.default_rng(2).integers(-128, 128, (500, net.inputs)).astype(np.int8)
    values = inputs / 32
    for weights, bias in layers[:-1]:
        values = np.clip(values @ weights.T + bias, 0, rw.MIDDLE_TOP / 8)
    wanted = np.clip((values @ layers[-1][0].T + layers[-1][1]) * 32768 / 6, -32768, 32767)
    assert np.abs(rw.run(net, inputs) - wanted).mean() < 165  # 0.03 of a natural unit: hidden values have 8 bits
    assert np.abs(rw.run(net, inputs)).max() > 5000


def test_sums_are_rounded_half_up_also_below_zero() -> None:
    """The native core adds a half and shifts arithmetically: a reference that rounds otherwise gives other bytes."""
    for bias, odds in ((-1, 0), (-8, 0), (-9, -1), (-24, -1), (-25, -2), (7, 0), (8, 1)):
        layers = tuple(
            rw.Layer(np.zeros((out, into), np.int16), np.full(out, of, np.int32), 13)
            for into, out, of in ((72, 8, 0), (8, 8, 0), (8, 32, bias))
        )
        net, inputs = rw.Net(False, False, layers), np.zeros((1, 72), np.int8)
        out = rw.run(net, inputs)
        assert out.dtype == np.int16
        assert out.tolist() == [[odds] * 32]
        assert native_nets([net]).run(inputs).tolist() == out.tolist()


def test_a_first_layer_that_fits_bytes_is_kept_in_them() -> None:
    """A file that travels with every key message would be twice as large, and the network slower."""
    floats = float_layers(72, (32, 32))
    first = np.rint(floats[0][0].clip(-1, 1) * 64) / 64, floats[0][1]
    net = rw.quantised(False, 0, [first, *floats[1:]])
    assert [layer.in_bytes for layer in net.layers] == [True, False, False]
    data = rf.pack_weights([net], {})
    assert rf.unpack_weights(data).nets[0].layers[0].weights.tolist() == net.layers[0].weights.tolist()
    assert len(rf.pack_weights([rw.quantised(False, 0, floats)], {})) - len(data) == 72 * 32
    again = rw.quantised(False, 0, rw.in_floats(net))
    assert [layer.weights.tolist() for layer in again.layers] == [layer.weights.tolist() for layer in net.layers]


def test_sums_that_may_pass_32_bits_are_refused() -> None:
    def net(weight: int, bias: int) -> rw.Net:
        first = rw.Layer(np.ones((256, 72), np.int16), np.zeros(256, np.int32), 6)
        second = rw.Layer(np.full((8, 256), weight, np.int16), np.full(8, bias, np.int32), 6)
        return rw.Net(False, False, (first, second, rw.Layer(np.ones((32, 8), np.int16), np.zeros(32, np.int32), 9)))

    net(32767, 0)
    for weight, bias in ((32767, 10_000_000), (-32768, 10_000_000), (32767, -(2**31)), (1, 2**31 - 1000)):
        with pytest.raises(SectionError, match="32 bits"):
            net(weight, bias)


def test_large_weights_take_a_smaller_shift_and_too_large_ones_are_refused() -> None:
    layers = float_layers(72, (32, 32))
    large = [(layers[0][0] * 100, layers[0][1]), *layers[1:]]
    assert rw.quantised(False, 0, large).layers[0].shift < rw.quantised(False, 0, layers).layers[0].shift
    for wrong in (1e5, np.nan, np.inf):
        with pytest.raises(SettingsError, match="layer 1"):
            rw.quantised(False, 0, [(layers[0][0] * wrong, layers[0][1]), *layers[1:]])


@pytest.mark.parametrize("hidden", [(4, 32), (32, 264), (20, 32)])
def test_only_sizes_that_the_core_knows_are_read(hidden: tuple[int, int]) -> None:
    with pytest.raises(SectionError, match="network of"):
        rw.quantised(False, 0, float_layers(72, hidden))


def test_files_cut_anywhere_raise_what_is_documented() -> None:
    data = rf.pack_weights([with_cases(four_nets()[0])], {"steps": 3})
    for end in [*range(80), *range(80, len(data), 97)]:
        with pytest.raises((HeaderError, TruncatedError, ChecksumError, SectionError)):
            rf.unpack_weights(data[:end])
        with pytest.raises(DecodeError):
            rf.unpack_weights(with_sum(data[:end]))


def test_mutated_files_raise_only_our_errors_and_take_no_memory() -> None:
    nets = four_nets()[:2]
    data = rf.pack_weights([nets[0], with_cases(nets[1])], {"steps": 3, "of": ["a", {"b": None}]})
    rng = np.random.default_rng(7)
    read = 0
    tracemalloc.start()
    for _ in range(1500):
        body = bytearray(data[:-4])
        for _ in range(int(rng.integers(1, 6))):
            body[int(rng.integers(0, 90 if rng.random() < 0.8 else len(body)))] = int(rng.integers(0, 256))
        try:
            weights = rf.unpack_weights(with_sum(bytes(body)))
        except LidarCodecError:
            continue
        read += 1
        rw.run(weights.nets[0], np.full((1, weights.nets[0].inputs), -128, np.int8))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert read > 20  # mutated weights are weights
    assert peak < 4 << 20


def test_what_a_file_claims_is_checked_before_it_is_used() -> None:
    net = four_nets()[0]
    data = rf.pack_weights([net], {})
    body = data[:-4]
    head = 4 + 1 + 4 + 2  # magic, version, length of the provenance, {}
    for changed, error in (
        (b"LCRX" + body[4:], HeaderError),
        (body[:4] + b"\x00" + body[5:], UnsupportedVersionError),
        (body[:4] + b"\x02" + body[5:], UnsupportedVersionError),
        (body[:5] + (2**32 - 1).to_bytes(4, "little") + body[9:], SectionError),
        (body[:5] + (60_000).to_bytes(4, "little") + body[9:], TruncatedError),
        (body[:9] + b"[]" + body[11:], SectionError),
        (body[:9] + b"{x" + body[11:], SectionError),
        (body[:5] + (60_000).to_bytes(4, "little") + b"[" * 60_000 + body[11:], SectionError),
        (body[:head] + b"\x00", SectionError),
        (body[:head] + b"\xff" + body[head + 1 :], SectionError),
        (body[:head] + b"\x02" + body[head + 1 :] * 2, SectionError),
        (body + b"\x00", SectionError),
    ):
        with pytest.raises(error):
            rf.unpack_weights(with_sum(changed))
    with pytest.raises(ChecksumError):
        rf.unpack_weights(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(SectionError, match="possible"):
        rf.unpack_weights(bytes(rf.MAX_FILE + 1))


@pytest.mark.parametrize("in_bytes", [False, True])
def test_tiles_without_weights_take_a_bit_of_a_file(in_bytes: bool) -> None:
    rng = np.random.default_rng(2)
    every = float_layers(112, (200, 40))
    if in_bytes:
        every[0] = rng.integers(-128, 128, every[0][0].shape) / 64, every[0][1]
    few = without_tiles(every, 0.25, rng)
    files = [rf.pack_weights([with_cases(rw.quantised(True, 2, layers))], {}) for layers in (every, few)]
    assert len(files[1]) < 0.5 * len(files[0])
    (net,) = rf.unpack_weights(files[1]).nets
    for layer, wanted in zip(net.layers, rw.quantised(True, 2, few).layers, strict=True):
        assert layer.shift == wanted.shift
        np.testing.assert_array_equal(layer.weights, wanted.weights)
        np.testing.assert_array_equal(layer.bias, wanted.bias)
    assert rf.pack_weights([net], {}) == files[1]


def test_tiles_of_a_file_are_those_that_have_weights() -> None:
    few = without_tiles(float_layers(72, (24, 40)), 0.5, np.random.default_rng(3))
    body = rf.pack_weights([rw.quantised(False, 2, few)], {})[:-4]
    first = 4 + 1 + 4 + 2 + 1 + 3 + 2 * 4 + 3  # the first layer's 36 bits: of two blocks of 18 the first is empty
    bits, tile = int.from_bytes(body[first : first + 5], "little"), 2 * 16 * 4
    behind = body[first + 5 + tile * bits.bit_count() :]
    for changed in (
        body[: first + 4] + bytes([body[first + 4] | 1 << 5]) + body[first + 5 :],  # a bit beyond the last tile
        body[:first] + (bits | 1).to_bytes(5, "little") + bytes(tile) + body[first + 5 :],  # an empty tile
        body[:first] + (2**36 - 1).to_bytes(5, "little") + b"\1" * tile * 36 + behind,  # all tiles
        body[: first + 5 + tile - 1] + b"\1" + body[first + 5 + tile :],  # a weight of a sum that there is not
        body[: first - 3] + bytes([body[first - 3] & ~32]) + body[first - 2 :],  # no word of tiles
    ):
        with pytest.raises(DecodeError):
            rf.unpack_weights(with_sum(changed))
    for end in range(first, len(body), 97):
        with pytest.raises(DecodeError):
            rf.unpack_weights(with_sum(body[:end]))


def test_what_cannot_be_packed_or_read_says_so(tmp_path: Path) -> None:
    net = four_nets()[0]
    for nets in ([], [net, net], [net] * 5):
        with pytest.raises(SettingsError, match="networks"):
            rf.pack_weights(nets, {})
    with pytest.raises(SettingsError, match="provenance"):
        rf.pack_weights([net], {"x": "y" * 70_000})
    with pytest.raises(SourceError, match="cannot read"):
        rf.read_weights(tmp_path / "none.weights")
    with pytest.raises(SectionError, match="inputs"):
        rw.run(net, np.zeros((2, 112), np.int8))
