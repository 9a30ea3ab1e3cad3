"""`open_store`: the store of a folder or an address."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Final

from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.errors import MissingExtraError, SourceError, UnknownNameError

SCHEMES: Final = ("s3", "gs", "az")


def open_store(where: str | Path | Store, retry_s: int = 90) -> Store:
    """The store of a folder, or of `s3://BUCKET/PREFIX`, `gs://...` or `az://...`. A Store is returned as it is.

    retry_s: how long requests are repeated that a bucket may answer later

    Raises UnknownNameError for another address, MissingExtraError without obstore, SourceError.
    """
    if isinstance(where, Store):
        return where
    scheme, colon, _ = str(where).partition("://")
    if isinstance(where, Path) or not colon:
        return FolderStore(Path(where))
    if scheme not in SCHEMES:
        raise UnknownNameError("kind of store", scheme, ("a folder", *SCHEMES))
    if find_spec("obstore") is None:
        raise MissingExtraError("object storage", "archive")
    from lidarcodec.archive.stores.bucket import BucketStore

    return BucketStore(str(where), retry_s=retry_s)


def check_there(store: Store) -> Store:
    """The store itself. Raises SourceError for a folder that does not exist, which is not an empty one."""
    if not store.is_there():
        raise SourceError(f"{store.url} is not a folder")
    return store
