"""If these fail, a receiver codes on with other weights than the vehicle, or a hostile update takes it down."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    MissingReferenceError,
    SectionError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.network import networks as rw
from lidarcodec.network import update as ru
from lidarcodec.network.shelf import weights_of
from tests.network.test_weights import four_nets, with_cases, with_sum
from tests.sweeps import examples

FINENESS = (7, 6, 5, 4)


def base() -> rw.Weights:
    return ru.weights_with(four_nets())


def near(net: rw.Net, seed: int = 3, size: float = 40.0, cases: bool = True) -> rw.Net:
    """A network whose weights are a little others; cases: with biases of cases, at random."""
    rng = np.random.default_rng(seed)
    layers = []
    for layer in net.layers:
        weights = layer.weights + rng.normal(0, size, layer.weights.shape).astype(np.int16)
        bias = layer.bias + rng.normal(0, 64 * size, layer.bias.shape).astype(np.int32)
        layers.append(rw.Layer(weights, bias, layer.shift))
    found = rw.Net(net.expects, net.size, tuple(layers))
    return with_cases(found, seed) if cases else found


def test_an_update_gives_the_weights_that_it_says_to_within_its_grain() -> None:
    weights = base()
    wanted = [near(net) for net in weights.nets[:2]]
    update = ru.update_of(weights, wanted, FINENESS)
    found = ru.applied(update.data, {weights.name: weights}.__getitem__)
    assert (found.name, found.data) == (update.weights.name, update.weights.data)
    assert ru.names_of(update.data) == (weights.name, found.name)
    assert len(found.nets) == 2
    for net, target in zip(found.nets, wanted, strict=True):
        for layer, want, fine in zip(net.layers, target.layers, FINENESS[:3], strict=True):
            assert np.abs(layer.weights.astype(int) - want.weights).max() <= 1 << (layer.shift - fine - 1)
        differs = net.layers[0].cases.astype(int) - target.layers[0].cases
        assert np.abs(differs).max() <= 1 << (rw.CASE_BITS - FINENESS[3])


def test_an_update_is_a_third_of_a_file_that_says_the_same() -> None:
    weights = base()
    wanted = [near(net, cases=False) for net in weights.nets[:2]]
    assert len(ru.update_of(weights, wanted, FINENESS).data) < len(ru.weights_with(wanted).data) / 3


def test_an_update_may_give_a_network_its_first_biases_of_cases_and_the_next_one_others() -> None:
    """A network may have none; a stream teaches it some."""
    plain = base()
    first = ru.update_of(plain, [near(plain.nets[1])], FINENESS)
    known = {plain.name: plain, first.weights.name: first.weights}
    assert len(ru.applied(first.data, known.__getitem__).nets[0].layers[0].cases) == rw.CASES
    second = ru.update_of(first.weights, [near(plain.nets[1], seed=4)], FINENESS)
    assert ru.applied(second.data, known.__getitem__).name == second.weights.name


def test_networks_on_another_shift_are_met_as_well() -> None:
    """A network that grew is quantised on a smaller shift; in steps of what decoders have it means the same."""
    weights = base()
    net = weights.nets[0]
    halved = tuple(
        rw.Layer((la.weights // 2).astype(np.int16), (la.bias // 2).astype(np.int32), la.shift - 1) for la in net.layers
    )
    update = ru.update_of(weights, [rw.Net(net.expects, net.size, halved)], (13, 13, 13, 6))
    for layer, was in zip(update.weights.nets[0].layers, net.layers, strict=True):
        assert layer.shift == was.shift
        assert np.abs(layer.weights.astype(int) - was.weights).max() <= 1


def test_weights_at_the_end_of_their_range_stay_within_it() -> None:
    weights = base()
    layers = list(weights.nets[0].layers)
    edge = layers[0].weights.copy()
    edge[0, :8] = 32767
    layers[0] = rw.Layer(edge, layers[0].bias, layers[0].shift)
    net = rw.Net(False, 0, tuple(layers))
    found = ru.update_of(ru.weights_with([net]), [near(net, size=300)], FINENESS).weights.nets[0]
    assert found.layers[0].weights.max() <= 32767


def test_layers_in_bytes_stay_in_bytes() -> None:
    """Weights that grow past 8 bits in the stream would double the time of both sides."""
    floats = rw.in_floats(base().nets[0])
    first = np.rint(floats[0][0].clip(-1, 1) * 64) / 64, floats[0][1]
    net = rw.quantised(False, 0, [first, *floats[1:]])
    found = ru.update_of(ru.weights_with([net]), [near(net, size=100)], FINENESS).weights.nets[0]
    assert [layer.in_bytes for layer in found.layers] == [True, False, False]
    assert (found.layers[0].weights != net.layers[0].weights).mean() > 0.5


def test_updates_that_cannot_be_are_refused() -> None:
    weights = base()
    update = ru.update_of(weights, [near(weights.nets[0])], FINENESS)
    find = {weights.name: weights}.__getitem__
    data = update.data[:-4]
    head = 21
    for error, body in (
        (UnsupportedVersionError, data[:4] + b"\4" + data[5:]),
        (DecodeError, data[:4] + b"\2" + data[5:]),
        (SectionError, data[:head] + b"\0" + data[head + 1 :]),  # no network
        (SectionError, data[:head] + b"\4" + data[head + 1 : head + 7] * 4),  # one network four times
        (SectionError, data[: head + 1] + b"\7" + data[head + 2 :]),  # of an unknown kind
        (SectionError, data[: head + 3] + b"\xff" + data[head + 4 :]),  # a grain of 255 bits
        (SectionError, data[:13] + bytes(8) + data[head:]),  # gives something else than it says
        (DecodeError, data[: len(data) // 2]),
    ):
        with pytest.raises(error):
            ru.applied(with_sum(body), find)
    with pytest.raises(ChecksumError):
        ru.applied(data + bytes(4), find)
    for size in (0, 4, 5, 12, 20):
        with pytest.raises((TruncatedError, UnsupportedVersionError, ChecksumError)):
            ru.applied(data[:size], find)
    only = ru.weights_with([weights.nets[0]])
    with pytest.raises(SectionError, match="do not have"):
        ru.update_of(only, [weights.nets[1]], FINENESS)


@pytest.mark.drawn
def test_damaged_updates_raise_only_errors_of_decoding() -> None:
    weights = weights_of("")
    update = ru.update_of(weights, [near(weights.net(expects=True, size=0))], FINENESS)
    rng, refused = np.random.default_rng(8), 0

    def find(name: str) -> rw.Weights:
        if name != weights.name:
            raise MissingReferenceError(f"no weights {name}", 0)
        return weights

    for i in range(examples(300)):
        broken = bytearray(update.data[: int(rng.integers(len(update.data)))] if i % 3 == 0 else update.data)
        for at in rng.integers(0, max(len(broken), 1), 3) if broken else ():
            broken[at] ^= int(rng.integers(1, 256))
        data = with_sum(bytes(broken[:-4])) if i % 2 and len(broken) > 4 else bytes(broken)
        try:
            found = ru.applied(data, find)
        except DecodeError:
            refused += 1
        else:
            assert found.name == update.weights.name
    assert refused > 0.96 * examples(300)
