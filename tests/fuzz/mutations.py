"""Seeded damage to bytes: what a bad disk, a bad link or a bad neighbour does."""

from __future__ import annotations

import random

EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63, 2**64 - 1)


_NEAR = 64
"""Bytes at the beginning of a section that are damaged as often as all the rest: there it says how much there is."""


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


def wounded(data: bytes, rng: random.Random) -> bytes:
    """The bytes with one to eight wounds, half of them near the beginning."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not out:
            return rng.randbytes(rng.randrange(40))
        at = rng.randrange(min(len(out), _NEAR)) if rng.random() < 0.5 else rng.randrange(len(out))
        match rng.randrange(10):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                size = rng.randrange(1, 9)
                out[at : at + size] = rng.randbytes(size)
            case 2:
                del out[at:]
            case 3:
                del out[at : at + rng.choice((1, 2, 4, 64, 1000))]
            case 4:
                out[at:at] = rng.randbytes(rng.choice((1, 2, 4, 64)))
            case 5:
                size = rng.choice((8, 64, 1024))
                out[at : at + size] = bytes(len(out[at : at + size]))
            case 6:
                size = rng.choice((1, 2, 4, 8))
                out[at : at + size] = (rng.choice(EXTREMES) % 256**size).to_bytes(size, "little")
            case 7:
                size, other = rng.choice((4, 32, 512)), rng.randrange(len(out))
                out[at : at + size] = out[other : other + size]
            case 8:
                out[at : at + 64] = b"\xff" * len(out[at : at + 64])
            case _:
                out[at] = (out[at] + rng.choice((1, 255))) & 255
    return bytes(out)
