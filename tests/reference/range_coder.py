"""The range coder and its models in pure Python: what the native core does, in the same order, with the same bytes.

For reading and for tests; `fast` is for work. The arithmetic is explained in docs/wire-format-sections.md.

>>> coder = BitWriter()
>>> model = BitModel()
>>> for bit in [1, 1, 1, 0, 1, 1, 1, 1]:
...     _ = model.code(coder, bit)
>>> data = coder.finish()
>>> reader, model = BitReader(data), BitModel()
>>> data.hex(), [model.code(reader) for _ in range(8)]
('46', [1, 1, 1, 0, 1, 1, 1, 1])
>>> reader.finish()
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from lidarcodec.errors import SectionError, TruncatedError

RANGE_TOP = 1 << 24
RANGE_START = 0xFFFFFFFF
PROBABILITY_BITS = 16
"""A probability is that of a one, in steps of 2^-16: 1 to 65535."""


class RangeEncoder:
    """Writes decisions into `out`."""

    def __init__(self) -> None:
        self.out = bytearray()
        self._low, self._range = 0, RANGE_START

    def encode(self, bit: int, probability: int) -> None:
        """Write one decision."""
        bound = self._range * probability >> PROBABILITY_BITS
        if bit:
            self._range = bound
        else:
            self._low += bound
            self._range -= bound
        while self._range < RANGE_TOP:
            self._carry()
            self.out.append(self._low >> 24)
            self._low = self._low << 8 & 0xFFFFFFFF
            self._range <<= 8

    def finish(self) -> bytes:
        """All bytes; the last one is the fewest that are needed."""
        self._carry()
        if self._low:
            if self._low + self._range > 1 << 32:
                self._low = 1 << 32
                self._carry()
            else:
                self.out.append((self._low + RANGE_TOP - 1) >> 24)
        return bytes(self.out)

    def _carry(self) -> None:
        if self._low >> 32:
            at = len(self.out) - 1
            while self.out[at] == 0xFF:
                self.out[at] = 0
                at -= 1
            self.out[at] += 1
            self._low &= 0xFFFFFFFF


class RangeDecoder:
    """Reads decisions. Raises TruncatedError or SectionError on bytes that `RangeEncoder` cannot have written."""

    def __init__(self, data: bytes) -> None:
        self._data, self._read, self._window, self._range = data, 0, 0, RANGE_START
        for _ in range(4):
            self._next()
        self._code = self._window
        if self._code == RANGE_START:
            raise SectionError("a range coded stream cannot begin with four bytes of 255")

    def decode(self, probability: int) -> int:
        """Read one decision."""
        bound = self._range * probability >> PROBABILITY_BITS
        bit = int(self._code < bound)
        if bit:
            self._range = bound
        else:
            self._code -= bound
            self._range -= bound
        while self._range < RANGE_TOP:
            self._code = self._code << 8 | self._next()
            self._range <<= 8
        return bit

    def finish(self) -> None:
        """Raises SectionError unless the stream ends here, in the bytes that the encoder writes."""
        moved = self._read - 4
        if len(self._data) > moved + 1:
            raise SectionError("bytes after the end of a range coded stream", moved + 1)
        if len(self._data) == moved:
            return
        low = self._window - self._code & 0xFFFFFFFF
        needed = low != 0 and low + self._range <= 1 << 32
        if not needed or self._code >= RANGE_TOP:
            raise SectionError("the end of a range coded stream does not fit its decisions", moved)

    def _next(self) -> int:
        byte = 0
        if self._read < len(self._data):
            byte = self._data[self._read]
        elif self._read >= len(self._data) + 4:
            raise TruncatedError("a range coded stream ends too early", len(self._data))
        self._read += 1
        self._window = (self._window << 8 | byte) & 0xFFFFFFFF
        return byte


class Bits(Protocol):
    """One way to write a model for both directions."""

    def bit(self, value: int, probability: int) -> int:
        """Encode `value` and return it, or decode and return."""

    def bits(self, value: int, count: int) -> int:
        """The `count` low bits of `value`, highest first, each as likely one as zero."""


class BitWriter:
    """Encodes what it is given."""

    def __init__(self) -> None:
        self._coder = RangeEncoder()

    def bit(self, value: int, probability: int) -> int:
        """Encode one decision."""
        self._coder.encode(value, probability)
        return value

    def bits(self, value: int, count: int) -> int:
        """Encode `count` bits of even chance."""
        for place in reversed(range(count)):
            self._coder.encode(value >> place & 1, 1 << (PROBABILITY_BITS - 1))
        return value & ((1 << count) - 1)

    def finish(self) -> bytes:
        """All bytes."""
        return self._coder.finish()


class BitReader:
    """Decodes; the values given are not looked at."""

    def __init__(self, data: bytes) -> None:
        self._coder = RangeDecoder(data)

    def bit(self, value: int, probability: int) -> int:
        """Decode one decision."""
        return self._coder.decode(probability)

    def bits(self, value: int, count: int) -> int:
        """Decode `count` bits of even chance."""
        value = 0
        for _ in range(count):
            value = value << 1 | self._coder.decode(1 << (PROBABILITY_BITS - 1))
        return value

    def finish(self) -> None:
        """Raises SectionError unless the stream ends here."""
        self._coder.finish()


COUNT_LIMIT = 253
RATES = [65536 // (n + 2) for n in range(COUNT_LIMIT + 1)]
"""The n-th decision of a context moves its probability by 1 / (n + 2), from the 254th on by 1 / 255."""
MIN_PROBABILITY = 16
"""Probabilities handed to the coder stay this far (of 65536) from 0 and 1."""


class BitModel:
    """Adaptive probability of a one: 22 bits, and how many decisions it has seen.

    With a `probability`, 16 bits, to start from, it believes it as if it had seen two.
    """

    def __init__(self, probability: int | None = None) -> None:
        self.p = 1 << 21 if probability is None else probability << 6
        self.n = 0 if probability is None else 2

    def probability(self) -> int:
        """16 bits, for the coder."""
        return max(MIN_PROBABILITY, min(65536 - MIN_PROBABILITY, self.p >> 6))

    def update(self, bit: int) -> None:
        """Learn a decision."""
        if bit:
            self.p += (0x3FFFFF - self.p) * RATES[self.n] >> 16
        else:
            self.p -= self.p * RATES[self.n] >> 16
        self.n = min(self.n + 1, COUNT_LIMIT)

    def code(self, bits: Bits, value: int = 0) -> int:
        """Code one decision by this model alone, and learn it."""
        bit = bits.bit(value, self.probability())
        self.update(bit)
        return bit


def _squash_table() -> list[int]:
    table, power = [0] * 4096, 1 << 31  # power: e^(-d / 256) in Q31
    for d in range(2049):
        up = (1 << 47) // ((1 << 31) + power)
        if d < 2048:
            table[2048 + d] = up
        if d > 0:
            table[2048 - d] = 65536 - up
        power = (power * 2139111403 + (1 << 30)) >> 31  # round(2^31 * e^(-1/256))
    return table


SQUASH = _squash_table()
"""SQUASH[i]: 16-bit probability whose log odds are (i - 2048) / 256."""


def _stretch_table() -> list[int]:
    table, at = [], 0
    for i in range(4096):
        while at < 4095 and SQUASH[at] < i * 16 + 8:
            at += 1
        table.append(at - 2048)
    return table


STRETCH = _stretch_table()
"""STRETCH[i]: log odds, steps of 1/256, of the probability (i + 1/2) / 4096."""


class Mixer:
    """Weighs the log odds of two models; the weights follow the error."""

    HEAVIEST = 1 << 20

    def __init__(self) -> None:
        self._weights, self._inputs, self._mixed = [39322, 39322], [0, 0], 0  # 0.6 in Q16

    def mix(self, a: BitModel, b: BitModel) -> int:
        """16-bit probability, for the coder."""
        self._inputs = [STRETCH[a.p >> 10], STRETCH[b.p >> 10]]
        total = sum(w * x for w, x in zip(self._weights, self._inputs, strict=True)) >> 16
        self._mixed = SQUASH[max(-2048, min(2047, total)) + 2048]
        return max(MIN_PROBABILITY, min(65536 - MIN_PROBABILITY, self._mixed))

    def update(self, bit: int) -> None:
        """Learn the decision that was mixed for."""
        error = bit * 65536 - self._mixed
        for i, x in enumerate(self._inputs):
            moved = self._weights[i] + ((error * x + 0x8000) >> 16)
            self._weights[i] = max(-self.HEAVIEST, min(self.HEAVIEST, moved))


class NumberModel:
    """Models of one stream of whole numbers: length in unary, two high bits by models, the rest as they are.

    Context of the length: how many of the last two numbers were not 0.
    """

    def __init__(self) -> None:
        self._longer = [[BitModel() for _ in range(64)] for _ in range(3)]
        self._high = [[BitModel() for _ in range(4)] for _ in range(64)]
        self._recent = self._last = 0

    def code(self, bits: Bits, value: int = 0) -> int:
        """Encode `value`, 0 to 2^64 - 1, or decode one."""
        wanted, length = value.bit_length(), 0
        while length < 64 and self._longer[self._recent][length].code(bits, int(wanted > length)):
            length += 1
        result, left, node = int(length > 0), length - 1, 1
        while left > 0 and node < 4:
            left -= 1
            bit = self._high[length - 1][node].code(bits, value >> left & 1)
            node, result = node << 1 | bit, result << 1 | bit
        if left > 0:
            result = result << left | bits.bits(value, left)
        self._recent, self._last = int(length > 0) + self._last, int(length > 0)
        return result


def encode_numbers(streams: Iterable[Iterable[int]]) -> bytes:
    """Bytes of several streams of whole numbers, each with models of its own."""
    bits = BitWriter()
    for stream in streams:
        model = NumberModel()
        for value in stream:
            model.code(bits, value)
    return bits.finish()


def decode_numbers(data: bytes, counts: Sequence[int]) -> list[list[int]]:
    """Streams of `counts` numbers."""
    bits, streams = BitReader(data), []
    for count in counts:
        model = NumberModel()
        streams.append([model.code(bits) for _ in range(count)])
    bits.finish()
    return streams
