"""Where codec `riddle` finds its weights: in the package, in a folder of the user's own, or in a file.

A message names the weights that it is coded with, by the hash of their file. The weights of the package are on every
machine; others travel in the key messages.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Final

from lidarcodec import entropy
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.network.networks import Net, Weights
from lidarcodec.network.weight_file import read_weights

DEFAULT: Final = "riddle-sim"
"""Stem of the file that is used unless settings name another."""
EFFORTS: Final = (1, 2, 3, 4)
"""Code without a network, with the small networks, with the large ones, with the largest."""
_FOLDER: Final = Path(__file__).parent / "weights"
SUFFIX: Final = ".lcrw"
"""Ending of weight files."""
FOLDER_VARIABLE: Final = "LIDARCODEC_WEIGHTS_DIR"
"""Variable that names the folder of own weights. Coding processes that are started inherit it."""


@cache
def shipped() -> dict[str, Weights]:
    """The weights of the package, by name."""
    return {weights.name: weights for weights in map(read_weights, sorted(_FOLDER.glob(f"*{SUFFIX}")))}


def shipped_file(name: str) -> bytes | None:
    """The weight file of the package that has this name; None if there is none."""
    found = shipped().get(name)
    return None if found is None else found.data


@cache
def _default() -> Weights:
    return read_weights(_FOLDER / (DEFAULT + SUFFIX))


def look_in(folder: Path) -> None:
    """Look for weights by name in this folder, too: here, and in processes that are started from now on.

    Raises SettingsError if the folder does not exist.
    """
    if not folder.is_dir():
        raise SettingsError(f"weights_dir: there is no folder {folder}", "weights_dir")
    os.environ[FOLDER_VARIABLE] = str(folder.resolve())


def weights_of(given: str) -> Weights:
    """The weights of a name or a file, read anew each time.

    given: a name is looked for in the package, then in the folder of `look_in`. A text with a slash or with the ending
           of weight files is a path; only the command line and files of this machine may give one. Empty: the default
    Raises UnknownNameError for a name that is nowhere, and all that `read_weights` raises.
    """
    if not given:
        return _default()
    if "/" in given or given.endswith(SUFFIX):
        return read_weights(Path(given))
    folders = [_FOLDER, *([Path(folder)] if (folder := os.environ.get(FOLDER_VARIABLE)) else [])]
    found = next((path for each in folders if (path := each / (given + SUFFIX)).is_file()), None)
    if found is None:
        known = sorted({path.stem for each in folders for path in each.glob(f"*{SUFFIX}")})
        raise UnknownNameError("weights", given, known)
    return read_weights(found)


def networks_of(weights: Weights, effort: int) -> list[Net]:
    """Two networks of an effort from 2 on: for frames alone, and for frames with an expectation.

    Raises UnknownNameError if the weights lack one of them.
    """
    return [weights.net(expects=expects, size=effort - EFFORTS[1]) for expects in (False, True)]


def native_nets(networks: list[Net]) -> entropy.NativeNets:
    """The networks in the form that the native range coder takes."""
    nets = entropy.NativeNets()
    for net in networks:
        nets.add([layer.given for layer in net.layers])
    return nets
