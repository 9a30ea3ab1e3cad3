"""The built page: files of the folder `web/`, ready to be sent.

The build gives every file below `assets/` a name made from its content, so a browser may cache these files for good. It
asks again for the others, and gets 304 while they are unchanged. A file is compressed once, at its first request.
"""

from __future__ import annotations

import gzip
import mimetypes
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path

WEB = Path(__file__).parent / "web"
MANIFEST = "sources.json"
KEPT = "assets/"
TYPES = {".js": "text/javascript; charset=utf-8", ".wasm": "application/wasm", ".html": "text/html; charset=utf-8"}
WORTH_BYTES = 1024
"""Smaller files are not compressed: it would not save a packet."""


@dataclass(frozen=True)
class WebFile:
    """One file: its path below the page, and its content."""

    name: str
    content: bytes

    @property
    def media_type(self) -> str:
        return TYPES.get(Path(self.name).suffix) or mimetypes.guess_type(self.name)[0] or "application/octet-stream"

    @property
    def cache_control(self) -> str:
        return "public, max-age=31536000, immutable" if self.name.startswith(KEPT) else "no-cache"

    @cached_property
    def etag(self) -> str:
        return f'"{sha256(self.content).hexdigest()[:32]}"'

    @cached_property
    def compressed(self) -> bytes | None:
        """The content as gzip, or None if that saves too little."""
        if len(self.content) < WORTH_BYTES:
            return None
        packed = gzip.compress(self.content, 9, mtime=0)
        return packed if len(packed) < 0.9 * len(self.content) else None


@cache
def web_files() -> dict[str, WebFile]:
    """The files of the page by name; empty when the package was installed without them."""
    found = (path for path in sorted(WEB.rglob("*")) if path.is_file() and path.name != MANIFEST)
    files = (WebFile(path.relative_to(WEB).as_posix(), path.read_bytes()) for path in found)
    return {file.name: file for file in files}
