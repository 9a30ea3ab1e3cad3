"""Annotated frames as training images for ScoreNet, and crops of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.reduction.score_image import HEIGHT_SCALE, score_image
from lidarcodec.training.annotation_folder import AnnotationFolder, Labels
from lidarcodec.training.labels import GROUND

SELDOM_COUNT: Final = 3
"""A place with at most this count is rarely seen: moving objects, and places that appeared at the end of the drive."""
SELDOM_M: Final = (3.0, 40.0)
"""Nearer is the vehicle itself, which is in no map; beyond this distance all counts are low."""
IGNORED: Final = -1
LIFTED_M: Final = 0.6
"""Standard deviation of the change of heights."""


class Example(NamedTuple):
    """A training image, (H, C): features (6, H, C) float16; label int8: 0 low, 1 high, 2 ground; rank float16: rank of
    the count among returns that are not ground, 0 to 1; seldom int8. -1: no target."""

    features: npt.NDArray[Any]
    label: npt.NDArray[Any]
    rank: npt.NDArray[Any]
    seldom: npt.NDArray[Any]


def labelled(paths: Sequence[Path], every: int = 1) -> Iterator[tuple[Frame, Labels]]:
    """Every `every`-th labelled frame of annotated drives. Raises SourceError."""
    for path in paths:
        folder = AnnotationFolder(path)
        sensor, numbers = folder.sensor, folder.labelled()
        if not numbers:
            raise SourceError(f"{path} has no labels: run `lidarcodec annotate` first, until it is finished")
        for k in numbers[::every]:
            frame, found = folder.frame(k, sensor), folder.labels(k)
            if found.labels.shape != frame.range.shape:
                raise SourceError(f"{path}/labels/{k:06d}.npz has labels of another frame")
            yield frame, found


def seldom_of(counts: npt.NDArray[Any], labels: npt.NDArray[Any], metres: npt.NDArray[Any]) -> npt.NDArray[np.int8]:
    """(N,) int8, 1 for rarely seen returns, 0 for others, -1 if unknown. counts, labels, metres: (N,)"""
    judged = (labels != GROUND) & (metres >= SELDOM_M[0]) & (metres < SELDOM_M[1])
    return np.where(judged, counts <= SELDOM_COUNT, IGNORED).astype(np.int8)


def example_of(frame: Frame, found: Labels, rng: np.random.Generator) -> Example:
    """A frame as an image; equal counts get random ranks."""
    image = score_image(frame)
    places = np.flatnonzero(frame.valid)
    labels, counts = found.labels.ravel()[places], found.counts.ravel()[places]
    metres = frame.range.ravel()[places] * frame.sensor.range_step_m
    beside = labels != GROUND
    rank = np.full(len(places), IGNORED, np.float32)
    order = np.lexsort((rng.random(int(beside.sum())), counts[beside]))
    ranks = np.empty(len(order), np.float32)
    ranks[order] = (np.arange(len(order)) + 0.5) / max(len(order), 1)
    rank[beside] = ranks

    def seen(values: npt.NDArray[Any], dtype: type) -> npt.NDArray[Any]:
        plane: npt.NDArray[Any] = np.full(image.features.shape[1:], IGNORED, dtype)
        plane.reshape(-1)[image.pixel] = values
        return plane

    return Example(image.features.astype(np.float16), seen(labels.astype(np.int8) - 1, np.int8),
                   seen(rank, np.float16), seen(seldom_of(counts, labels, metres), np.int8))  # fmt: skip


def crop(example: Example, width: int, rng: np.random.Generator) -> Example:
    """A crop of `width` columns, mirrored with probability 1/2, with a random change of the intensity's scale.

    Half of the crops have all heights moved, because not every sensor is mounted as high as the simulated one.
    """
    columns = (int(rng.integers(example.label.shape[1])) + np.arange(width)) % example.label.shape[1]
    mirrored = rng.random() < 0.5
    if mirrored:
        columns = columns[::-1]
    features = example.features[:, :, columns].astype(np.float32)
    if mirrored:  # the step to the next column becomes the negative step to the previous one
        features[4] = -np.roll(features[4], -1, axis=1)
    bright = 0.0 if rng.random() < 0.2 else float(np.exp(rng.normal(0.0, 0.4)))
    features[2] = np.minimum(features[2] * bright, 1.0)
    lifted = float(rng.normal(0.0, LIFTED_M)) if rng.random() < 0.5 else 0.0
    features[1] += lifted * HEIGHT_SCALE * features[3]
    label, rank, seldom = (plane[:, columns] for plane in example[1:])
    return Example(features, label, rank, seldom)
