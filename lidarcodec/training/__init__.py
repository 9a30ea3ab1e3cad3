"""Training of networks, with torch: the extra `learned`. Nothing that encodes or decodes needs it.

Commands and benchmarks load a module of this package with `training_module`, so that a machine without torch is told
what to install.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from lidarcodec.errors import MissingExtraError

__all__ = ["training_module"]


def training_module(name: str) -> Any:
    """The module lidarcodec.training.`name`.

    Raises MissingExtraError when torch is not installed.
    """
    try:
        return import_module(f"lidarcodec.training.{name}")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "torch":
            raise
        raise MissingExtraError("training", "learned") from None
