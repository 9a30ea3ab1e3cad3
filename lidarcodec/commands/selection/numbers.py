"""Numbers in the text of an option, with commas between.

>>> numbers_of("--around", "120,-40.5", "X,Y in metres", 2)
[120.0, -40.5]
>>> numbers_of("--around", "120", "X,Y in metres", 2)
Traceback (most recent call last):
lidarcodec.errors.SettingsError: --around 120: write X,Y in metres
"""

from __future__ import annotations

import math

from lidarcodec.errors import SettingsError


def shares_of(option: str, text: str) -> list[float]:
    """Shares of 0 to 1, written in per cent with commas between. Raises SettingsError.

    >>> shares_of("--keep", "20%, 5%")
    [0.2, 0.05]
    """
    shares = []
    for part in text.split(","):
        try:
            share = float(part.strip().removesuffix("%")) / 100
        except ValueError:
            share = 0.0
        if not (part.strip().endswith("%") and 0 < share <= 1):
            raise SettingsError(f"{option} {text}: write shares as in 20%,5%", option.lstrip("-"))
        shares.append(share)
    return shares


def numbers_of(option: str, text: str, form: str, *counts: int) -> list[float]:
    """The numbers of an option. form: how they are written;  counts: how many there may be

    Raises SettingsError for another count, and for numbers that are not finite.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise SettingsError(f"{option} {text}: write {form}", option.lstrip("-"))
    return numbers
