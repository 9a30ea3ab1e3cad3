"""Training of networks, with torch: the extra `learned`. Nothing that encodes or decodes needs it.

Commands and benchmarks load its modules with `training_module`, so that on a machine without torch the error names what
to install.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from lidarcodec.errors import MissingExtraError

__all__ = ["training_module"]


def training_module(name: str) -> Any:
    """The module lidarcodec.training.`name`.

    Raises MissingExtraError if torch is not installed.
    """
    try:
        return import_module(f"lidarcodec.training.{name}")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "torch":
            raise
        raise MissingExtraError("training", "learned") from None
