"""Options of `convert`, `decode`, `encode` and `cut` that choose frames by time, and say where points lie."""

from __future__ import annotations

from typing import Annotated

from typer import Option

FormName = Annotated[
    str | None,
    Option("--as", metavar="FORMAT", help="Format of the output. Default: by the ending of OUT."),
]
FromTime = Annotated[
    str | None,
    Option(
        "--from",
        metavar="TIME",
        help="Begin here: seconds from the beginning, RFC 3339, or nanoseconds since 1970.",
    ),
]
ToTime = Annotated[
    str | None, Option("--to", metavar="TIME", help="End before this time, in the same forms as --from.")
]
Region = Annotated[
    str | None,
    Option(
        "--region",
        metavar="X,Y,Z,X,Y,Z",
        help="Keep only points in this box: lowest x, y and z, then highest, in metres. Four numbers: x and y only.",
    ),
]
Transform = Annotated[
    str | None,
    Option(
        "--transform",
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="Move the points: metres and degrees, or the 12 numbers of a 3 x 4 matrix, row by row.",
    ),
]
Merge = Annotated[
    bool,
    Option("--merge", help="Put all frames into one cloud: each is placed by its pose, seen from the first frame."),
]
WhichReturns = Annotated[
    str,
    Option(
        "--returns",
        metavar="first|all",
        help="Which returns of each beam are points. With `all` a field says which one a point is.",
    ),
]
