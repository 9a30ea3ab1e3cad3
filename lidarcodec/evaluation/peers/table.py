"""The peers by name. Modules are imported at first use, so packages of unused peers need not be installed.

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
    """Whether a name in `--codec` is a peer."""
    return name.startswith(PREFIX)


def peer(name: str) -> Peer:
    """A peer that can run here.

    Raises UnknownNameError, or MissingExtraError with the name of the missing package.
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

    Raises MissingExtraError with the name of a missing package.
    """
    try:
        return ", ".join(f"{name} {version(name)}" for name in found.packages) or NO_PACKAGE
    except PackageNotFoundError as error:
        raise MissingExtraError(f"a peer ({error.name} is not installed)", "peers") from None
