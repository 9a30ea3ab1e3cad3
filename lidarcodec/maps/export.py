"""Maps for other programs: PCD, PLY and LAS, with normals where the map has them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import MissingExtraError, SettingsError
from lidarcodec.maps.geodesy import wkt_of
from lidarcodec.maps.points import MapPoints

ENDINGS: Final = (".pcd", ".ply", ".las")
FAR_M: Final = 16_384.0
"""Farther coordinates of 32 bits are more than a millimetre apart."""


def check_ending(path: Path) -> None:
    """Raise SettingsError for an unknown ending, MissingExtraError for .las without laspy."""
    if path.suffix.lower() not in ENDINGS:
        raise SettingsError(f"cannot write {path}: its name must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
    if path.suffix.lower() == ".las" and find_spec("laspy") is None:
        raise MissingExtraError(f"writing {path}", "las")


def export(points: MapPoints, path: Path, ending: str) -> None:
    """Write a map to `path` in the format of an ending. In UTM, and wherever points are far away, PCD has doubles, too:
    float32 is right to 0.25 m only, because northings are so large.

    Raises SettingsError for points that are too far apart for .las.
    """
    if ending == ".las":
        _las(points, path)
        return
    far = points.frame.zone or np.abs(points.xyz).max(initial=0.0) > FAR_M
    rows = _rows(points, "<f8" if ending == ".ply" or far else "<f4", "n" if ending == ".ply" else "normal_")
    names = rows.dtype.names or ()
    if ending == ".ply":
        kinds = {"<f8": "double", "<f4": "float"}
        fields = "".join(f"property {kinds[rows.dtype[name].str]} {name}\n" for name in names)
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{fields}end_header\n"
    else:
        many = len(names)
        sizes = "".join(f" {rows.dtype[name].itemsize}" for name in names)
        head = (
            f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE{sizes}\nTYPE{' F' * many}\n"
            f"COUNT{' 1' * many}\nWIDTH {len(rows)}\nHEIGHT 1\n"
            f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
        )
    with path.open("wb") as file:
        file.write(head.encode())
        file.write(rows.tobytes())


def _rows(points: MapPoints, wide: str, normal: str) -> npt.NDArray[np.void]:
    normals = points.normals
    slim = "<f4"
    names = [("x", wide), ("y", wide), ("z", wide)]
    if normals is not None:
        names += [(f"{normal}{axis}", slim) for axis in "xyz"]
    rows = np.empty(len(points), np.dtype(names))
    columns = points.xyz.T if normals is None else np.concatenate([points.xyz.T, normals.T])
    for (name, _), values in zip(names, columns, strict=True):
        rows[name] = values
    return rows


def _las(points: MapPoints, path: Path) -> None:
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.generating_software = np.full(3, points.step_m), "lidarcodec"
    least = points.steps.min(axis=0)
    if (points.steps - least).max() >= 1 << 31:
        raise SettingsError("the points of this map are too far apart for .las: write .ply")
    header.offsets = least * points.step_m
    header.global_encoding.wkt = True  # LAS 1.4 asks for it with this point format, even in a local frame
    if points.frame.zone:
        wkt = wkt_of(points.frame.zone, south=points.frame.south)
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = (points.steps - least).T.astype(np.int32)
    las.write(path)
