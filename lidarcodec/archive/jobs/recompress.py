"""The jobs `recompress` and `reduce`: encode a recording of the archive with other settings.

The new segment replaces the old one in one step, by its commit. What the old one's error bound lost stays lost,
and the errors of both add up.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from itertools import chain
from typing import Any, Final

from lidarcodec.archive.names import Commit, id_of
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.product import About, publish, write_product
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.pipeline import StreamEncoder, check_offline
from lidarcodec.settings import settings_from
from lidarcodec.wire.header import MAJOR, MINOR

REDUCING: Final = frozenset({"reduction", "keep_points", "keep_fraction"})
"""Settings of a reduction."""


def recompress(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Encode a segment again. value: `commit` (fields of Commit), `settings`, `delete_old`, `dry`

    `settings` are all of them, or with `adds` those that are added to the settings of the segment.

    `older` has the segments that this one replaced (fields of each), if their recordings are still there.

    A reduction that the segment has had already is not done once more.

    With `dry` nothing is written. With `delete_old` the old recording and its table are deleted after the new
    recording was read back from the store. A segment that has these settings already is left as it is.
    """
    del source
    commit = Commit(*value["commit"])
    found = read_commit(target, commit)
    older = [read_commit(target, Commit(*one)) for one in value.get("older", ())]
    settings = found["settings"] | value["settings"] if value.get("adds") else value["settings"]
    if found["settings"] == settings:
        if older and not value["dry"]:
            _delete(older, found, target)
        return {"unchanged": 1}
    if value["dry"]:
        return {"bytes_before": found["bytes"], "frames": found["frames"]}
    segment = id_of("recompress", commit.segment, found["sha256"], settings, [MAJOR, MINOR])
    about = {"job": "recompress", "input": found["object"], "not_kept": found["not_kept"]}
    known = About(commit.vehicle, commit.sensor, commit.segment, segment, about, (found["bound_m"], found["error_m"]))
    encoder = StreamEncoder(check_offline(settings_from(_left(settings, found["settings"]))), known.stream_id)
    with scratch_folder() as folder:
        old = folder / "old.mcap"
        target.download(found["object"], old)
        frames = RecordedFrames(old)
        pictures = iter(frames)
        first = next(pictures, None)
        if first is None:
            raise SourceError(f"{found['object']} has no frame that can be decoded")
        encoder.prepare(first.sensor)
        product = write_product(chain((first,), pictures), encoder, known, folder)
        product = replace(product, value=product.value | {"settings": settings})
        if product.value["frames"] != found["frames"]:
            raise SourceError(f"{found['object']} has lost frames and was left unchanged")
        won = publish(target, product)
    if value["delete_old"]:
        _delete([found, *older], read_commit(target, product.commit), target)
    return {"won": won, "frames": found["frames"], "bytes": product.value["bytes"], "bytes_before": found["bytes"]}


def _left(settings: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """Settings to encode with. A reduction that the segment has had already would reduce what it left once more."""
    if any(settings[name] != before.get(name) for name in REDUCING):
        return settings
    return {name: value for name, value in settings.items() if name not in REDUCING}


def _delete(olds: list[dict[str, Any]], new: dict[str, Any], store: Store) -> None:
    """Delete old recordings and their tables, after the new ones were read back. The old commits stay: they say that
    their input was done."""
    digest = hashlib.sha256()
    for chunk in store.chunks(new["object"]):
        digest.update(chunk)
    if digest.hexdigest() != new["sha256"] or store.size(new["table"]) is None:
        raise SourceError(f"{new['object']} in the store differs from what was written: {olds[0]['object']} was kept")
    for old in olds:
        store.delete(old["table"])
        store.delete(old["object"])
