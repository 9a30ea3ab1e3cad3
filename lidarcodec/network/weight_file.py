"""Weight files of codec `riddle`: networks, what they were trained on, and a name that is their hash.

The format is docs/wire-format-riddle-weights.md.

>>> from lidarcodec.network.networks import quantised
>>> rng = np.random.default_rng(1)
>>> sizes = [(8, 72), (8, 8), (32, 8)]
>>> net = quantised(False, 0, [(rng.normal(0, 0.2, size), np.zeros(size[0])) for size in sizes])
>>> weights = unpack_weights(pack_weights([net], {"trained on": "nothing"}))
>>> len(weights.name), weights.provenance["trained on"], weights.net(expects=False, size=0).inputs
(16, 'nothing', 72)
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from lidarcodec._native import crc32c
from lidarcodec.budgets import FileTooLargeError, largest, read_file
from lidarcodec.errors import (
    ChecksumError,
    HeaderError,
    SectionError,
    SettingsError,
    SourceError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.network.networks import CASES, LAYERS, SIZES, Layer, Net, Weights, check_dims
from lidarcodec.network.tiles import packed, unpacked
from lidarcodec.untrusted.json import JsonRefusedError, read_object

MAGIC: Final = b"LCRW"
VERSION: Final = 1
MAX_FILE: Final = largest("weights") or 0
MAX_PROVENANCE: Final = 1 << 16
MAX_NETS: Final = 6
_IN_BYTES: Final = 128
"""Added to the shift of a layer whose weights are kept in 8 bits."""
_WITH_CASES: Final = 64
"""Added to that of a first layer with biases of cases."""
_FEW_TILES: Final = 32
"""Added to that of a layer some of whose tiles are left out."""


def pack_weights(nets: Sequence[Net], provenance: Mapping[str, Any]) -> bytes:
    """The bytes of a weight file. provenance: what JSON can hold

    Raises SettingsError for no or too many networks, two of one kind and size, or a provenance of over 64 KiB.
    """
    text = json.dumps(dict(provenance), ensure_ascii=False, sort_keys=True).encode()
    if not 1 <= len(nets) <= MAX_NETS or len({(net.expects, net.size) for net in nets}) != len(nets):
        raise SettingsError(f"a weight file holds 1 to {MAX_NETS} networks of different kinds, not {len(nets)}")
    if len(text) > MAX_PROVENANCE:
        raise SettingsError(f"a provenance of {len(text)} bytes: {MAX_PROVENANCE} are possible")
    parts = [MAGIC, bytes([VERSION]), len(text).to_bytes(4, "little"), text, bytes([len(nets)])]
    for net in nets:
        parts.append(bytes([net.expects, net.size, len(net.layers)]))
        parts.append(np.array(net.dims, "<u2").tobytes())
        parts.append(bytes(map(_shift_byte, net.layers)))
        for layer in net.layers:
            kept = "i1" if layer.in_bytes else "<i2"
            parts.append(packed(layer.weights, kept) if layer.few_tiles else layer.weights.astype(kept).tobytes())
            parts += [layer.bias.astype("<i4").tobytes(), layer.cases.tobytes()]
    body = b"".join(parts)
    return body + int(crc32c(body)).to_bytes(4, "little")


def _shift_byte(layer: Layer) -> int:
    flags = _IN_BYTES * layer.in_bytes + _WITH_CASES * bool(len(layer.cases)) + _FEW_TILES * layer.few_tiles
    return layer.shift + flags


class Reader:
    """Takes bytes one after the other, never more than there are."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def take(self, count: int) -> bytes:
        if count > len(self._data) - self.at:
            raise TruncatedError("weights end before what they announce", len(self._data))
        self.at += count
        return self._data[self.at - count : self.at]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    @property
    def left(self) -> int:
        return len(self._data) - self.at


def unpack_weights(data: bytes) -> Weights:
    """The weights of a file's bytes, from anybody: nothing is used before it is checked.

    Raises HeaderError, UnsupportedVersionError, TruncatedError, ChecksumError or SectionError.
    """
    if len(data) > MAX_FILE:
        raise SectionError(f"weights of {len(data)} bytes: {MAX_FILE} are possible")
    if data[: len(MAGIC)] != MAGIC:
        raise HeaderError("not a weight file")
    reader = Reader(data[:-4])
    reader.take(len(MAGIC))
    if (version := reader.number(1)) != VERSION:
        raise UnsupportedVersionError(f"weights of version {version}: this build reads version {VERSION}", len(MAGIC))
    if int(crc32c(data[:-4])) != int.from_bytes(data[-4:], "little"):
        raise ChecksumError("the checksum of the weights does not match", len(data) - 4)
    provenance = _provenance(reader)
    count = reader.number(1)
    if not 1 <= count <= MAX_NETS:
        raise SectionError(f"weights of {count} networks: 1 to {MAX_NETS} are possible", reader.at)
    nets = tuple(_net(reader) for _ in range(count))
    if len({(net.expects, net.size) for net in nets}) != count:
        raise SectionError("weights with two networks of one kind and size", reader.at)
    if reader.left:
        raise SectionError(f"weights with {reader.left} bytes too many", reader.at)
    return Weights(nets, provenance, hashlib.sha256(data).hexdigest()[:16], bytes(data))


def _provenance(reader: Reader) -> Mapping[str, Any]:
    size = reader.number(4)
    if size > MAX_PROVENANCE:
        raise SectionError(f"a provenance of {size} bytes: {MAX_PROVENANCE} are possible", reader.at)
    try:
        found = read_object(reader.take(size), MAX_PROVENANCE)
    except JsonRefusedError as error:
        raise SectionError(f"the provenance of the weights: {error}", reader.at) from None
    return MappingProxyType(found)


def _net(reader: Reader) -> Net:
    expects, size, layers = reader.take(3)
    if expects > 1 or size >= len(SIZES) or layers != LAYERS:
        raise SectionError(f"a network of kind {expects}, size {size} and {layers} layers", reader.at)
    dims = np.frombuffer(reader.take(2 * (layers + 1)), "<u2").tolist()
    check_dims(bool(expects), dims)
    shifts = reader.take(layers)
    made = []
    for into, out, shift in zip(dims, dims[1:], shifts, strict=False):
        in_bytes = shift >= _IN_BYTES
        kept = "i1" if in_bytes else "<i2"
        if shift & _FEW_TILES:
            weights = unpacked(reader.take, (out, into), kept)
        else:
            taken = np.frombuffer(reader.take((2 - in_bytes) * into * out), kept)
            weights = taken.astype(np.int16).reshape(out, into)
        bias = np.frombuffer(reader.take(4 * out), "<i4").astype(np.int32)
        rows = CASES if shift & _WITH_CASES else 0
        cases = np.frombuffer(reader.take(rows * out), np.int8).reshape(rows, out)
        made.append(Layer(weights, bias, shift & ~(_IN_BYTES | _WITH_CASES | _FEW_TILES), cases))
        if made[-1].in_bytes != in_bytes:
            raise SectionError("a layer that fits bytes and is not kept in them", reader.at)
        if made[-1].few_tiles != bool(shift & _FEW_TILES):
            raise SectionError("a layer with empty tiles that are not left out", reader.at)
    return Net(bool(expects), size, tuple(made))


def read_weights(path: Path) -> Weights:
    """The weights in a file. Raises SourceError if it cannot be read, else as `unpack_weights`."""
    try:
        return unpack_weights(read_file(path, "weights"))
    except FileTooLargeError as error:
        raise SourceError(f"cannot read the weights {path}: {error}") from None
    except OSError as error:
        raise SourceError(f"cannot read the weights {path}: {error.strerror or error}") from None
    except ValueError as error:  # a name that no file can have
        raise SourceError(f"cannot read the weights {str(path)!r}: {error}") from None
