"""MapAnswers: answers questions about the maps of a shelf, on all keys under `lidarcodec/v1/@maps`.

Lists are JSON. Parts of tiles are bytes behind HEAD, which says to which version of the tile they belong: one that
changed while it was being fetched begins anew by itself. Names that are not on the shelf are left to other processes.
"""

from __future__ import annotations

import struct
from functools import partial
from typing import Any, Final

from lidarcodec.errors import SettingsError
from lidarcodec.maps.served.manifest import HASH, KEY, PATH, Manifest
from lidarcodec.maps.served.shelf import MapShelf, ShelvedMap
from lidarcodec.transport import Transport
from lidarcodec.transport.allowance import Allowance
from lidarcodec.transport.answering import TooOftenError, answered
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.part_size import MAX_PART

PART: Final = 1
HEAD: Final = struct.Struct("<BII32s")
"""PART, bytes of the whole piece, offset of this part, SHA-256 of the piece. No JSON begins with a byte 1."""
LISTS_PER_S, LISTS_AT_ONCE = 20.0, 100
"""Rate limit of lists, for all clients together."""


class MapAnswers:
    """Answers from a shelf."""

    def __init__(self, shelf: MapShelf) -> None:
        self._shelf = shelf
        self._take = Allowance(LISTS_PER_S, LISTS_AT_ONCE).take

    def declare(self, transport: Transport) -> Closeable:
        """Begin to answer."""
        return transport.answer_under(f"{KEY}/**", self.answer)

    def answer(self, key: str, data: bytes) -> bytes | None:
        """The answer to one question; None for a map that is not here."""
        parts = key.removeprefix(KEY).split("/")[1:]
        if not parts:
            return answered(self._list)(data)
        shelved = self._shelf.get(parts[0])
        if shelved is None:
            return None
        if len(parts) == 1:
            return answered(partial(self._manifest, shelved.manifest))(data)
        return self._piece(shelved, parts[1:], data)

    def _list(self, query: dict[str, Any]) -> dict[str, Any]:
        self._allow()
        return {"maps": [one.manifest.summary() for one in self._shelf.all()]}

    def _manifest(self, manifest: Manifest, query: dict[str, Any]) -> dict[str, Any]:
        self._allow()
        if query.get("have") == manifest.version:
            return {"name": manifest.name, "version": manifest.version, "same": True}
        return manifest.page(_whole(query, "from"))

    def _piece(self, shelved: ShelvedMap, tail: list[str], data: bytes) -> bytes:
        found: list[bytes] = []

        def tell(query: dict[str, Any]) -> dict[str, Any]:
            piece = shelved.pieces.get(_place(tail))
            if piece is None:
                raise SettingsError(f"map '{shelved.name}' has no tile {'/'.join(tail)[:40]}", "tile")
            if query.get("have") == piece.hash:
                return {"same": True, "hash": piece.hash}
            wanted = query.get("hash", piece.hash)
            if not isinstance(wanted, str) or not HASH.fullmatch(wanted):
                raise SettingsError("hash must have 64 hexadecimal digits", "hash")
            offset = _whole(query, "offset") if wanted == piece.hash else 0
            if offset > piece.size:
                raise SettingsError(f"the tile has {piece.size} bytes", "offset")
            size = min(_whole(query, "bytes", MAX_PART), MAX_PART)
            head = HEAD.pack(PART, piece.size, offset, bytes.fromhex(piece.hash))
            found.append(head + shelved.read(piece, offset, size))
            return {}

        told = answered(tell)(data)
        return found[0] if found else told

    def _allow(self) -> None:
        retry_s = self._take()
        if retry_s:
            raise TooOftenError("lists of maps are requested", retry_s)


def _place(tail: list[str]) -> tuple[int, int] | None:
    """The place of a tile in its key; None for the path. Raises SettingsError."""
    if tail == [PATH]:
        return None
    try:
        x, y = (int(part) for part in tail if len(part) <= 12)
    except ValueError:
        raise SettingsError(f"'{'/'.join(tail)[:40]}' is neither a tile, as in 3/-2, nor {PATH}", "tile") from None
    return x, y


def _whole(query: dict[str, Any], field: str, default: int = 0) -> int:
    value = query.get(field, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
        raise SettingsError(f"{field} must be a whole number", field)
    return value
