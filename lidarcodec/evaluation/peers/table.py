"""The peers by name. Modules are named as text and imported on first use, so that what is not installed is not missed.

>>> names()[:3]
('peer:zstd', 'peer:xz', 'peer:draco')
>>> is_peer("pcodec"), is_peer("peer:draco")
(False, True)
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Final, cast

from lidarcodec.errors import MissingExtraError, UnknownNameError
from lidarcodec.evaluation.peers.base import Peer

PREFIX: Final = "peer:"
NO_PACKAGE: Final = "Python's standard library"
_TABLE: Final = {
    f"{PREFIX}{name}": f"lidarcodec.evaluation.peers.{module}"
    for name, module in {
        "zstd": "packets_zstd",
        "xz": "packets_xz",
        "draco": "draco",
        "laszip": "laszip",
        "xz-rows": "rows_xz",
        "pcodec": "pcodec_returns",
        "jpegls": "jpegls",
        "lerc": "lerc",
        "ffv1": "ffv1",
    }.items()
}


def names() -> tuple[str, ...]:
    """Names of all peers."""
    return tuple(_TABLE)


def is_peer(name: str) -> bool:
    """Whether a name in `--codec` means a peer."""
    return name.startswith(PREFIX)


def peer(name: str) -> Peer:
    """A peer that can run here.

    Raises UnknownNameError, or MissingExtraError naming the package that is not installed.
    """
    if name not in _TABLE:
        raise UnknownNameError("peer", name, _TABLE)
    try:
        found = cast(Peer, import_module(_TABLE[name]).PEER)
    except ImportError as error:
        raise MissingExtraError(f"{name} ({error.name or error} is not installed)", "peers") from None
    versions(found)
    return found


def versions(found: Peer) -> str:
    """The packages of a peer with their versions, such as `DracoPy 2.2.0`.

    Raises MissingExtraError naming one that is not installed.
    """
    try:
        return ", ".join(f"{name} {version(name)}" for name in found.packages) or NO_PACKAGE
    except PackageNotFoundError as error:
        raise MissingExtraError(f"a peer ({error.name} is not installed)", "peers") from None
