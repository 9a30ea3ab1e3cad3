"""Where codec `riddle` finds its weights: those of the package, those of a folder by name, and those of a file.

A message says by name, the hash of their file, with which weights it is coded. Those of the package are on every
machine; others travel with the key messages.
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
"""Without a network, with the small ones, with the large ones, with the largest."""
_FOLDER: Final = Path(__file__).parent / "weights"
SUFFIX: Final = ".lcrw"
FOLDER_VARIABLE: Final = "LIDARCODEC_WEIGHTS_DIR"
"""Names the folder of own weights, for this process and for those that it starts to code in."""


@cache
def shipped() -> dict[str, Weights]:
    """The weights of the package, by name."""
    return {weights.name: weights for weights in map(read_weights, sorted(_FOLDER.glob("*.lcrw")))}


def shipped_file(name: str) -> bytes | None:
    """The weight file of the package that has this name; None if there is none."""
    found = shipped().get(name)
    return None if found is None else found.data


@cache
def _default() -> Weights:
    return read_weights(_FOLDER / f"{DEFAULT}.lcrw")


def look_in(folder: Path) -> None:
    """Look for weights by name in a folder, too, here and in processes that are started from now on.

    Raises SettingsError when it is not there.
    """
    if not folder.is_dir():
        raise SettingsError(f"weights_dir: there is no folder {folder}", "weights_dir")
    os.environ[FOLDER_VARIABLE] = str(folder.resolve())


def weights_of(given: str) -> Weights:
    """Those of a name or of a file, read anew each time; by default the package's own.

    given: a name is looked for in the package, then in the folder of `look_in`. What has a slash,
           or the ending of weight files, is a path: only this machine's command line and files may say one
    Raises UnknownNameError for a name that is nowhere, else as `read_weights`.
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
    """Those of an effort that has some: alone, expecting. Raises UnknownNameError if a kind is missing."""
    return [weights.net(expects=expects, size=effort - EFFORTS[1]) for expects in (False, True)]


def native_nets(networks: list[Net]) -> entropy.NativeNets:
    """Networks as the coder of ranges takes them."""
    nets = entropy.NativeNets()
    for net in networks:
        nets.add([layer.given for layer in net.layers])
    return nets
