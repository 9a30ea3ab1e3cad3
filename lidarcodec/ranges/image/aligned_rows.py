"""Pictures of any sensor: rows are moved so that a column is one direction, and sides are filled up to a multiple.

Rows move round: what leaves a picture on one side comes in on the other, as directions do in a turn.

>>> layout = AlignedRows.of(np.array([0, 1]), columns=3, multiple=4)
>>> layout.shape, layout.spread(np.array([[1, 2, 3], [4, 5, 6]])).tolist()[:2]
((4, 4), [[1, 2, 3, 0], [6, 4, 5, 0]])
>>> layout.gather(layout.spread(np.array([[1, 2, 3], [4, 5, 6]]))).tolist()
[[1, 2, 3], [4, 5, 6]]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

Pixel = TypeVar("Pixel", bound=np.generic)


@dataclass(frozen=True, eq=False)
class AlignedRows:
    """places: (H, W) intp, column of each cell in the picture; shape: rows and columns of the picture"""

    places: npt.NDArray[np.intp]
    shape: tuple[int, int]

    @classmethod
    def of(cls, shift: npt.NDArray[Any], columns: int, multiple: int = 1) -> AlignedRows:
        """The layout for rows that move by `shift` columns, (H,); sides of the picture are multiples of `multiple`."""
        places = (np.arange(columns) + shift.astype(np.intp)[:, None]) % max(columns, 1)
        sides = (-(-count // multiple) * multiple for count in (len(shift), columns))
        rows, width = sides
        return cls(places, (rows, width))

    def spread(self, image: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
        """The picture of an image, (H, W); zeros beside it."""
        rows, columns = self.places.shape
        out = np.zeros(self.shape, image.dtype)
        np.put_along_axis(out[:rows, :columns], self.places, image, axis=1)
        return out

    def gather(self, picture: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
        """The image, (H, W), out of its picture."""
        rows, columns = self.places.shape
        return np.take_along_axis(picture[:rows, :columns], self.places, axis=1)
