"""Which returns of a frame are points of an output (`--returns`), and where they lie: `--merge` by the poses of their
frames, then `--transform`, then `--region`.

>>> Placing.of(None, "1,0,0,0,0,90", merge=False).T_out_sensor.round(3).tolist()[:2]
[[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]]
"""

from __future__ import annotations

import math
from typing import Final, get_args

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import Returns
from lidarcodec.commands.outputs.base import NARROW_M
from lidarcodec.commands.selection.numbers import numbers_of
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.frame import Frame
from lidarcodec.mounting import transform_of, vehicle_pose

Cloud = npt.NDArray[np.void]
Matrix = npt.NDArray[np.float64]
AXES: Final = "xyz"
WIDE_M: Final = 1024.0
"""Points that are moved farther get coordinates of 64 bits: those of 32 bits are half a metre apart in UTM."""


class Placing:
    """Gives the points of frames, moved and cut.

    region: (2, 3) float64, least and greatest x y z in metres of the output, or None
    T_out_sensor: (4, 4) float64 from the sensor; with `merge` from the sensor as it stood at the first frame, or from
                  the vehicle where frames have a mounting
    merge: whether points are placed by the poses of their frames
    returns: the first return of each beam, or all, with a field `return_number`
    """

    def __init__(
        self,
        region: Matrix | None = None,
        T_out_sensor: Matrix | None = None,
        *,
        merge: bool = False,
        returns: Returns = "first",
    ) -> None:
        self.region, self.merge, self.returns = region, merge, returns
        self.moved = merge or T_out_sensor is not None
        self.T_out_sensor = np.eye(4) if T_out_sensor is None else T_out_sensor
        self._T_first_world: Matrix | None = None
        self._wide = float(np.abs(self.T_out_sensor[:3, 3]).max()) >= WIDE_M

    @classmethod
    def of(cls, region: str | None, transform: str | None, *, merge: bool, returns: str = "first") -> Placing:
        """From the texts of the options. Raises SettingsError, UnknownNameError."""
        if returns not in get_args(Returns):
            raise UnknownNameError("choice of returns", returns, dict.fromkeys(get_args(Returns)))
        return cls(
            None if region is None else _region(region),
            None if transform is None else _transform(transform),
            merge=merge,
            returns="all" if returns == "all" else "first",
        )

    @property
    def given(self) -> str:
        """Names of the options that were given; empty if there are none."""
        return ", ".join(filter(None, (self.placed, "--returns all" * (self.returns == "all"))))

    @property
    def placed(self) -> str:
        """Names of those that move or cut points."""
        names = {
            "--region": self.region is not None,
            "--transform": self.moved and not self.merge,
            "--merge": self.merge,
        }
        return ", ".join(name for name, there in names.items() if there)

    def points(self, frame: Frame) -> Cloud:
        """(N,) structured array: points of a frame, moved and cut. Coordinates have 64 bits where points are far away.

        Raises SettingsError if poses are needed and the frame has none.
        """
        cloud = frame.cloud(self.returns)
        if not self.moved and self.region is None:
            return cloud
        xyz = np.stack([cloud[axis].astype(np.float64) for axis in AXES], axis=-1)
        if self.moved:
            T = self.T_out_sensor @ self._pose(frame) if self.merge else self.T_out_sensor
            xyz = xyz @ T[:3, :3].T + T[:3, 3]
            wide = self._wide or float(np.abs(xyz).max(initial=0.0)) > NARROW_M
            cloud = cloud.astype(_with_wide_axes(cloud.dtype)) if wide else cloud.copy()
            for at, axis in enumerate(AXES):
                cloud[axis] = xyz[:, at]
        if self.region is None:
            return cloud
        least, greatest = self.region
        inside: Cloud = cloud[((xyz >= least) & (xyz <= greatest)).all(axis=1)]
        return inside

    def _pose(self, frame: Frame) -> Matrix:
        """From the sensor at this frame to the sensor at the first one, or to the vehicle there if the frame says how
        the sensor is mounted."""
        if frame.pose is None:
            raise SettingsError(
                f"--merge needs to know where the sensor was, but frame {frame.index} has no pose: give --poses FILE",
                "merge",
            )
        if self._T_first_world is None:
            self._T_first_world = np.asarray(np.linalg.inv(vehicle_pose(frame.pose, frame.mount)), np.float64)
        return np.asarray(self._T_first_world @ frame.pose, np.float64)


def _with_wide_axes(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    return np.dtype([(name, "<f8" if name in AXES else dtype[name].str) for name in dtype.names or ()])


def _region(text: str) -> Matrix:
    form = "XMIN,YMIN,XMAX,YMAX or XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX in metres"
    numbers = numbers_of("--region", text, form, 4, 6)
    if len(numbers) == 4:
        numbers = [numbers[0], numbers[1], -math.inf, numbers[2], numbers[3], math.inf]
    region = np.array(numbers).reshape(2, 3)
    if (region[0] >= region[1]).any():
        raise SettingsError(
            f"--region {text} is an empty box: each lowest number must be less than the highest one", "region"
        )
    return region


def _transform(text: str) -> Matrix:
    form = "X,Y,Z,ROLL,PITCH,YAW in metres and degrees, or the 12 numbers of a 3 x 4 matrix, row by row"
    numbers = numbers_of("--transform", text, form, 6, 12)
    if len(numbers) == 12:
        T = np.eye(4)
        T[:3] = np.array(numbers).reshape(3, 4)
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
            raise SettingsError(f"--transform {text}: its 3 x 3 part is not a rotation", "transform")
        return T
    return transform_of(*numbers)
