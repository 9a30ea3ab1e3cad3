"""FrameDataset: frames of an archive as a torch dataset (extra `torch`). `Archive.dataset` makes it.

Segments are listed once, when it is made, so that all workers know the same ones. What each reads follows from
their number, the seed and the epoch alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from random import Random
from typing import Any, Final

import torch
from torch import distributed
from torch.utils.data import IterableDataset, get_worker_info

from lidarcodec.archive.messages import Chosen, decoded_frames, messages_of
from lidarcodec.archive.shares import Piece, Share, mixed, share_of
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.frame import Frame

MAX_BUFFER: Final = 100_000
"""Most frames that a worker mixes."""
_AT_ONCE: Final = 4
"""Pieces that a worker reads from at once."""
_READ: Final = 8 << 20
"""Bytes of a request, for each of these."""


class FrameDataset(IterableDataset):  # type: ignore[misc]
    """Frames in an order of their own for each epoch. Over all workers and ranks each frame comes once in an epoch.

    Give a DataLoader `batch_size=None`, a `collate_fn`, or this a `transform` that makes arrays of one size. All ranks
    need the same number of workers. It can be pickled; keys of a store are not in it.
    """

    def __init__(
        self,
        store: Store,
        segments: Sequence[Chosen],
        limits: tuple[int, int] | None,
        transform: Callable[[Frame], Any] | None,
        shuffle: bool,
        seed: int,
        buffer: int,
        rank: int | None,
        world: int | None,
    ) -> None:
        """Arguments as of `Archive.dataset`. limits: first and last time in ns"""
        super().__init__()
        if not segments:
            raise SourceError(f"{store.url} has no such segment")
        if not 1 <= buffer <= MAX_BUFFER:
            raise SettingsError(f"the buffer must have 1 to {MAX_BUFFER:,} frames, not {buffer}", "buffer")
        if (rank is None) != (world is None) or (rank is not None and world is not None and not 0 <= rank < world):
            raise SettingsError("give rank and world, with 0 <= rank < world, or neither", "rank")
        self._store, self._segments, self._limits = store, segments, limits
        self._transform, self._shuffle, self._seed, self._buffer = transform, shuffle, seed, buffer
        self._ranks = None if rank is None or world is None else Share(rank, world)
        self._epoch = torch.zeros(1, dtype=torch.int64).share_memory_()  # workers that stay see it change

    @property
    def digest(self) -> str:
        """A hash of the segments, what is read of them, and their order in this epoch. Ranks with equal ones share out
        the same frames."""
        found = hashlib.sha256(f"{self._limits} {self._order()}\n".encode())
        for one in self._segments:
            offsets = None if one.offsets is None else sorted(one.offsets)
            found.update(f"{one.commit.name} {offsets}\n".encode())
        return found.hexdigest()

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next iteration. Call it before each epoch, in the process of the DataLoader."""
        if not 0 <= epoch < 1 << 63:
            raise SettingsError(f"the epoch must be 0 or more, not {epoch}", "epoch")
        self._epoch[0] = epoch

    def __iter__(self) -> Iterator[Any]:
        """Frames, or what `transform` makes of them, of this worker and rank.

        Raises SourceError if a segment is damaged or was removed meanwhile, or the store fails.
        """
        worker, ranks = get_worker_info(), self._ranks_now()
        workers = 1 if worker is None else worker.num_workers
        share = Share(ranks.number * workers + (0 if worker is None else worker.id), ranks.of * workers)
        order = self._order()
        pieces = map(self._frames, share_of(self._segments, lambda one: one.commit.segment, share, order))
        found: Iterator[Frame]
        if order is None:
            found = chain.from_iterable(pieces)
        else:
            found = mixed(pieces, _AT_ONCE, self._buffer, Random(f"{order}/{share.number}/{share.of}"))
        return found if self._transform is None else map(self._transform, found)

    def __getstate__(self) -> dict[str, Any]:
        """A spawned worker knows no torch.distributed. A process that will be a rank asks it, once that is begun."""
        return self.__dict__ | {"_ranks": self._ranks_now() if _distributed() else self._ranks}

    def _order(self) -> str | None:
        """What the order of segments follows from; None for that of the archive."""
        return f"{self._seed}/{int(self._epoch[0])}" if self._shuffle else None

    def _ranks_now(self) -> Share:
        if self._ranks is not None:
            return self._ranks
        return Share(distributed.get_rank(), distributed.get_world_size()) if _distributed() else Share(0, 1)

    def _frames(self, piece: Piece[Chosen]) -> Iterator[Frame]:
        chosen = piece.segment
        try:
            messages = messages_of(self._store, chosen, self._limits, piece.part, _READ)
            yield from decoded_frames(messages, self._limits)
        except FileNotFoundError as error:
            raise SourceError(
                f"{error}: it was removed after the dataset was opened, so open the dataset again"
            ) from None
        except (LidarCodecError, OSError) as error:  # one kind, which a DataLoader can carry to its own process
            commit = chosen.commit
            name = f"{commit.vehicle}/{commit.sensor}/{commit.segment}"
            raise SourceError(f"{self._store.url}: segment {name}: {error}") from None


def _distributed() -> bool:
    """Whether this process is a rank of torch.distributed."""
    return bool(distributed.is_available() and distributed.is_initialized())
