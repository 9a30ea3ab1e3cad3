"""Seeded damage to bytes: what a bad disk, a bad link or a bad neighbour does."""

from __future__ import annotations

import random

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
