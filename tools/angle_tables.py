"""Prints the constants of native/src/motion/fixed_angle.hpp, in whole numbers only: the same on every machine."""

from __future__ import annotations

BITS = 160
ROTATIONS = 30


def arctangent(power: int) -> int:
    """atan(2**-power), scaled by 2**BITS."""
    if power == 0:  # Machin: pi / 4 = 4 atan(1/5) - atan(1/239)
        return 4 * _inverse_arctangent(5) - _inverse_arctangent(239)
    return _inverse_arctangent(1 << power)


def _inverse_arctangent(x: int) -> int:
    total, term, n = 0, (1 << BITS) // x, 1
    while term:
        total += term // n if n % 4 == 1 else -(term // n)
        term //= x * x
        n += 2
    return total


def _root(value: int) -> int:
    """Square root of a number scaled by 2**BITS."""
    guess = 1 << BITS
    for _ in range(200):
        guess = (guess + (value << BITS) // guess) // 2
    return guess


def inverse_gain(rotations: int) -> int:
    """1 / CORDIC gain, the product of sqrt(1 + 4**-i) over the rotations, scaled by 2**30."""
    product = 1 << BITS
    for i in range(rotations):
        product += product >> (2 * i)
    return (((1 << (2 * BITS)) // _root(product)) + (1 << (BITS - 31))) >> (BITS - 30)


if __name__ == "__main__":
    turn = 8 * arctangent(0)
    print("kArctangent:", [((arctangent(i) << 40) + turn // 2) // turn for i in range(ROTATIONS)])
    print("kInverseCordicGain, 30 rotations:", inverse_gain(30), " 20 rotations:", inverse_gain(20))
    print("kAnglePerRadian, 2^32 / (2 pi):", ((1 << (32 + BITS)) + turn // 2) // turn)
    print("kTableStepsPerTurn, 2 pi in steps of 1e-8:", (turn * 10**8 + (1 << (BITS - 1))) >> BITS)
