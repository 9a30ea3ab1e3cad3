"""`--reduction`, `--keep-points`, `--keep-fraction`: short forms of `--set` for these settings.

>>> reduced(["intensity=off"], "voxel", "9000", None)
['intensity=off', 'reduction=voxel', 'keep_points=9000']
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from typer import Option

ReductionName = Annotated[
    str | None,
    Option(
        "--reduction",
        metavar="NAME",
        help="Which returns are sent: auto (default), all, voxel and others.",
    ),
]
KeepPoints = Annotated[
    str | None, Option("--keep-points", metavar="N", help="Number of returns to keep of each frame.")
]
KeepFraction = Annotated[
    str | None,
    Option("--keep-fraction", metavar="X", help="Instead of --keep-points: share of the returns to keep, up to 1."),
]


def reduced(
    pairs: Sequence[str] | None, reduction: str | None, keep_points: str | None, keep_fraction: str | None
) -> list[str]:
    """The pairs of `--set`, with the three options as further pairs."""
    options = {"reduction": reduction, "keep_points": keep_points, "keep_fraction": keep_fraction}
    return [*(pairs or []), *(f"{key}={value}" for key, value in options.items() if value is not None)]
