"""CALIBRATION sections of form 3, and PLANES, REST and CLOUD sections, with damage inside of what they pack.

As in `inside`: packed bytes are unpacked, damaged and packed anew, with sizes and hashes that agree.
"""

from __future__ import annotations

import hashlib
import json
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import zstandard

from lidarcodec.entropy.rest_coder import decode_rest, encode_rest
from lidarcodec.entropy.varint import VarintReader, put_varint
from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import LidarCodecError
from lidarcodec.packet_rest import PacketRest
from lidarcodec.planes.clouds.section import COLUMNS, ZSTD
from lidarcodec.planes.plane_section import PlaneKind, read_head
from tests.fuzz.mutations import EXTREMES, wounded

_CALIBRATION = struct.Struct("<BIBBBI")
_HASH_BYTES = 8
_MOST = 1 << 22
_NUMBERS: tuple[Any, ...] = (
    0,
    -1,
    1,
    16,
    128,
    1e308,
    -1e308,
    5e-324,
    2**63,
    10**400,
    1.5,
    float("nan"),
    True,
    None,
    "1",
)


def damaged_description(data: bytes, rng: random.Random) -> bytes:
    """A sensor that describes itself, with one part of its description damaged; its hash is right, but now and then."""
    plain = _unpacked(data[13:])
    if data[:1] != b"\3" or plain is None or len(plain) < _CALIBRATION.size:
        return wounded(data, rng)
    head = list(_CALIBRATION.unpack_from(plain))
    parts, at = [], _CALIBRATION.size
    for size in (head[2], head[3], head[5]):
        parts.append(plain[at : at + size])
        at += size
    name, model, description, table = *parts, plain[at:]
    match rng.randrange(8):
        case 0:
            head[0], head[1] = rng.choice((0, 1, 2, 255)), rng.choice((0, 1, 4, 2**32 - 1))
        case 1:
            name = rng.choice((b"", b"\xff", b"\xc3\xa9" * 100, b"\0"))
        case 2:
            model = rng.choice(
                (b"", b"hdl64e", b"vlp16", b"os1-128", b"pointcloud2", b"\xff", wounded(model, rng)[:255])
            )
        case 3:
            head[4] = rng.choice((0, 1, head[4] - 1, head[4] + 1, 255)) & 255
            table = (table * 2)[: 44 * head[4]] if rng.random() < 0.8 else table
        case 4:
            limits = np.frombuffer(rng.randbytes(len(table) // 4 * 4), "<i4") >> rng.choice((0, 8, 20))
            table = limits.astype("<i4").tobytes()
        case _:
            description = damaged_json(description, rng)
    head[2], head[3], head[5] = len(name), len(model), len(description)
    plain = _CALIBRATION.pack(*head) + name + model + description + table
    if rng.random() < 0.1:
        plain = wounded(plain, rng)
    of = hashlib.sha256(name + b"\0" + table + b"\0" + model + b"\0" + description).digest()[:_HASH_BYTES]
    return data[:1] + (of if rng.random() < 0.9 else data[1:9]) + len(plain).to_bytes(4, "little") + compress(plain, 1)


def damaged_json(data: bytes, rng: random.Random) -> bytes:
    """A JSON with a value that is another one, missing, or repeated; or its bytes wounded."""
    try:
        tree = json.loads(data)
        tree = tree if isinstance(tree, dict | list) else {}
    except (ValueError, RecursionError):
        return rng.choice((wounded(data, rng), b"{}", b"[" * 5000, b'{"a":' * 300 + b"1"))
    places: list[tuple[Any, Any]] = []
    _collect(tree, places)
    if not places or rng.random() < 0.3:
        return wounded(data, rng)
    for _ in range(rng.choice((1, 1, 2, 4))):
        inside, key = rng.choice(places)
        if key not in (inside if isinstance(inside, dict) else range(len(inside))):
            continue
        match rng.randrange(5):
            case 0:
                del inside[key]
            case 1:
                inside[key] = rng.choice(_NUMBERS)
            case 2:
                inside[key] = rng.choice(
                    ([], {}, "", [0] * 200, [[[]]], "\0", "\ud800", "RNG15_RFL8_NIR8", "LEGACY", "1024x10")
                )
            case 3 if isinstance(inside[key], list):
                inside[key] = inside[key] * 2 if rng.random() < 0.5 else inside[key][:-1]
            case _:
                inside[key] = rng.choice(rng.choice(places)[0:1])
    try:
        return json.dumps(tree).encode()
    except (ValueError, RecursionError):  # a part that holds itself
        return wounded(data, rng)


def _collect(tree: Any, places: list[tuple[Any, Any]]) -> None:
    for key in tree if isinstance(tree, dict) else range(min(len(tree), 4)):
        places.append((tree, key))
        if isinstance(tree[key], dict | list):
            _collect(tree[key], places)


def damaged_planes(data: bytes, rng: random.Random) -> bytes:
    """A PLANES section whose numbers are damaged, behind a head that is whole; or the head."""
    try:
        head = read_head(data)
    except LidarCodecError:
        return wounded(data, rng)
    begin, body = data[: head.size], data[head.size :]
    if rng.random() < 0.3:
        return wounded(begin, rng) + body
    if head.kind != PlaneKind.ZSTD:
        return begin + wounded(body, rng)
    return begin + _packed_anew(body, lambda plain: wounded(plain, rng)[: len(plain)].ljust(len(plain), b"\xff"), rng)


def damaged_rest(data: bytes, packets: int, rng: random.Random) -> bytes:
    """A REST section with one part that is another one: layout, times, a series, or odd packets."""
    try:
        rest = decode_rest(data, packets)
    except LidarCodecError:
        return wounded(data, rng)
    layout, series = rest.layout, {name: values.copy() for name, values in rest.series.items()}
    times, odd, payloads = rest.packet_ns.copy(), list(rest.odd.tolist()), list(rest.odd_packets)
    match rng.randrange(6):
        case 0:
            layout = rng.choice(("", "single", "dual", "single_2", "dual_2", "legacy", "x" * 32))
        case 1 if len(times):
            times[rng.randrange(len(times))] = rng.choice((0, 2**59, -(2**59), 10**15))
        case 2 | 3 if series:
            name = rng.choice(list(series))
            values = series[name]
            if len(values) and rng.random() < 0.8:
                values[rng.randrange(len(values))] = rng.choice(EXTREMES) & int(np.iinfo(values.dtype).max)
            elif rng.random() < 0.5:
                series[name] = values.astype(rng.choice((np.uint8, np.uint64)))
            else:
                series[name] = np.concatenate((values, values[:1]))
        case 4 if packets:
            place = rng.randrange(packets)
            if place not in odd:
                odd.append(place)
                payloads.append(rng.randbytes(rng.choice((0, 1, 1206, 1248))))
                payloads = [one for _, one in sorted(zip(odd, payloads, strict=True), key=lambda one: one[0])]
                odd.sort()
        case _:
            payloads = [wounded(one, rng)[:65_507] for one in payloads]
    try:
        places = np.array(odd, np.uint16)
        made = encode_rest(PacketRest(layout, times, places, tuple(payloads), series))
    except LidarCodecError:
        return wounded(data, rng)
    return made if rng.random() < 0.8 else wounded(made, rng)


def damaged_cloud(data: bytes, rng: random.Random) -> bytes:
    """A CLOUD section whose message, or its head, is damaged inside; or any of its bytes."""
    if len(data) < 3 or data[0] not in (ZSTD, COLUMNS) or rng.random() < 0.3:
        return wounded(data, rng)
    reader = VarintReader(data)
    out = bytearray([reader.byte()])
    try:
        if data[0] == ZSTD:
            reader.varint(_MOST)
            plain = wounded(_unpacked(data[reader.offset :]) or b"", rng)
            put_varint(out, len(plain))
            return bytes(out) + compress(plain, 1)
        put_varint(out, reader.varint(_MOST) if rng.random() < 0.9 else rng.choice((0, 1, 10**8)))
        reader.varint(_MOST)
        head = _unpacked(reader.take(reader.varint(len(reader)))) or b""
        rest = data[reader.offset :]
    except LidarCodecError:
        return wounded(data, rng)
    if (kind := rng.random()) < 0.6:
        head = _other_head(head, rng)
    if kind > 0.5:
        rest = wounded(rest, rng)
    packed = compress(head, 1)
    put_varint(out, len(head))
    put_varint(out, len(packed))
    return bytes(out) + packed + rest


def _other_head(head: bytes, rng: random.Random) -> bytes:
    """The head of a message with one of its numbers near what it was, or far from it; or wounded."""
    out = bytearray(head)
    if len(out) < 64 or rng.random() < 0.2:
        return wounded(head, rng)
    at = rng.choice((rng.randrange(16, 48), rng.randrange(len(out) - 16), len(out) - rng.randrange(4, 14)))
    at -= (at - 4) % 4
    number = int.from_bytes(out[at : at + 4], "little")
    number = rng.choice((0, 1, 2, 3, 7, 8, number + 1, number - 1, number * 2, rng.choice(EXTREMES)))
    out[at : at + 4] = (number & 0xFFFFFFFF).to_bytes(4, "little")
    return bytes(out)


def _unpacked(data: bytes) -> bytes | None:
    """The bytes of a zstd frame; None if it is none, or too long."""
    try:
        size = zstandard.get_frame_parameters(data[:18]).content_size
        return decompress(data, size) if size <= _MOST else None
    except (LidarCodecError, zstandard.ZstdError):
        return None


def _packed_anew(data: bytes, change: Callable[[bytes], bytes], rng: random.Random) -> bytes:
    plain = _unpacked(data)
    return wounded(data, rng) if plain is None else compress(change(plain), 1)
