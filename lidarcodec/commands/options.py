"""An option of the command line, which is also a variable of the environment."""

from __future__ import annotations

from typing import Any

import typer


def option(*names: str, **about: Any) -> Any:
    """An option that can also be given as LIDARCODEC_<ITS NAME>."""
    variable = names[0].split("/")[0].lstrip("-").replace("-", "_").upper()
    return typer.Option(*names, envvar=f"LIDARCODEC_{variable}", **about)
