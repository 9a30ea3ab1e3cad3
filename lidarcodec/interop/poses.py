"""A pose as others write it: a translation and a quaternion.

>>> import numpy as np
>>> quaternion_of(np.eye(4))
[0.0, 0.0, 0.0, 1.0]
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def quaternion_of(T_parent_child: npt.NDArray[np.float64]) -> list[float]:
    """x, y, z, w of a pose's rotation, of length 1, w not negative.

    The eigenvector of Bar-Itzhack's matrix: right for every turn, and the nearest where a rotation is not quite one.
    """
    r = T_parent_child[:3, :3]
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    values, vectors = np.linalg.eigh(k / 3.0)
    x, y, z, w = vectors[:, np.argmax(values)].tolist()
    sign = -1.0 if w < 0 else 1.0
    return [sign * part + 0.0 for part in (x, y, z, w)]
