"""Seeded damage to bytes: what a bad disk, a bad link or a bad neighbour does."""

from __future__ import annotations

import random
from dataclasses import replace

from lidarcodec.wire import HEADER_BYTES, pack, unpack
from lidarcodec.wire.checksum import with_checksum
from lidarcodec.wire.header import CHECKSUM_BYTES

EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63, 2**64 - 1)


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The bytes with one to four wounds."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        if not out:
            return rng.randbytes(rng.randrange(64))
        at = rng.randrange(len(out))
        match rng.randrange(8):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                out[at : at + rng.randrange(1, 9)] = rng.randbytes(rng.randrange(1, 9))
            case 2:
                del out[at:]
            case 3:
                del out[at : at + rng.randrange(1, 65)]
            case 4:
                out[at:at] = rng.randbytes(rng.randrange(1, 65))
            case 5:
                out[at : at + 64] = bytes(len(out[at : at + 64]))
            case 6:
                size = rng.choice((1, 2, 4, 8))
                out[at : at + size] = (rng.choice(EXTREMES) % 256**size).to_bytes(size, "little")
            case 7:
                other = rng.randrange(len(out))
                out[at : at + 32] = out[other : other + 32]
    return bytes(out)


def mutated_message(data: bytes, rng: random.Random, *, resealed: bool) -> bytes:
    """A damaged message; `resealed`: whole and with a right checksum again, so that what lies behind is tested."""
    if not resealed:
        return mutated(data, rng)
    if rng.random() < 0.7:
        message = unpack(data)
        sections = list(message.sections)
        at = rng.randrange(len(sections))
        match rng.randrange(12):
            case 0:
                del sections[at]
            case 1:
                sections.append(sections[at])
            case 2:
                sections[at] = sections[at]._replace(type=rng.randrange(15), ordinal=rng.choice((0, 0, 1, 255)))
            case _:
                sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
        return pack(replace(message, sections=tuple(sections)))
    header = bytearray(data[:HEADER_BYTES])
    for _ in range(rng.choice((1, 2))):
        at, size = rng.randrange(5, HEADER_BYTES), rng.choice((1, 2, 4))
        header[at : at + size] = rng.choice((rng.randbytes(size), (rng.choice(EXTREMES) % 256**size).to_bytes(size)))
    body = header[:HEADER_BYTES] + data[HEADER_BYTES:-CHECKSUM_BYTES]
    body[8:12] = (len(body) + CHECKSUM_BYTES).to_bytes(4, "little")
    return with_checksum(bytes(body))
