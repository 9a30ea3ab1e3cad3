"""KittiSource: a KITTI folder as the packets of its sensor.

Raw scans are inverted exactly to the sensor's native values. Odometry scans are motion compensated, so they are
re-gridded, and the names of source and sensor say so. The fit of the first scan decides which of the two a folder is.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import generic_sensor, read_calibration
from lidarcodec.sources.base import REGRIDDED, PacketSource
from lidarcodec.sources.kitti.grid import fit_rings, regrid, without_two_point_correction
from lidarcodec.sources.kitti.inversion import Fidelity, Firings, Geometry, invert
from lidarcodec.sources.kitti.packets import FiringPacker
from lidarcodec.sources.kitti.points import Points, Scan, find_scans, is_millimetres, read_points
from lidarcodec.sources.spec import Spec
from lidarcodec.units import FIRINGS_PER_PACKET, FRAME_COLUMNS

logger = logging.getLogger(__name__)

Kind = Literal["raw", "odometry"]
KINDS: Final[tuple[Kind, ...]] = ("raw", "odometry")
RECOVERED: Final = "kitti_hdl64e_s2_recovered*"
INNER: Final = frozenset({"data", "velodyne", "velodyne_points"})
"""Folder names that do not identify the drive."""
FITS: Final = 0.5
"""Smallest share of points that must fit in a raw scan. In odometry scans 0.3 % fit, in raw scans 100 %."""
MAX_COLUMNS: Final = 4000
"""Most columns of a grid: the number of steps of the sensor's encoder."""


class KittiSource(PacketSource):
    """Packets of the scans of a folder, one turn after the other.

    kind: "raw" or "odometry";  fidelity: distances between packets and points, for each scan read so far
    Counts: `points in one cell` (of several the nearest stays), `points out of range`, `bad points`, `empty scans`.
    """

    def __init__(
        self, path: Path, calibration: Path | None = None, kind: Kind | None = None, columns: int = FRAME_COLUMNS
    ) -> None:
        """Reads the first scan.

        calibration: that of the KITTI sensor; else it is looked for beside the scans and in LIDARCODEC_DATA
        kind:        "raw" or "odometry", detected by default;  columns: width of the grid for odometry scans
        Raises SourceError if there are no scans, or raw ones without the calibration that they fit; CalibrationError.
        """
        self.path, self._columns = path, columns
        self.scans = find_scans(path)
        self.fidelity: list[Fidelity] = []
        scan, first = _first(self.scans)
        sensor = _calibration(scan.path, calibration)
        self.kind = kind or _kind_of(scan, first, sensor)
        if self.kind == "raw" and sensor is None:
            raise SourceError(_missing(scan.path))
        if self.kind == "odometry":
            sensor = without_two_point_correction(sensor or fit_rings(first) or generic_sensor())
            sensor = replace(sensor, name=f"HDL-64E ({REGRIDDED})")
            logger.warning(
                "%s: scans are %s to 64 x %d, because this data set has no packets: say so with every result",
                path,
                REGRIDDED,
                columns,
            )
        super().__init__(sensor or generic_sensor())
        self._geometry = Geometry(self.sensor)
        self.start_ns = self.scans[0].start_ns
        name = next(part for part in reversed(path.resolve().parts) if part not in INNER)
        what = f"KITTI raw {name}, inverted" if self.kind == "raw" else f"{REGRIDDED}, {name}"
        self.label = f"{what} (time stamps and status bytes made up)"

    @classmethod
    def from_spec(cls, spec: Spec, calibration: Path | None) -> KittiSource:
        """The source for a folder or `.bin` file with options `?kind=` and `?columns=`."""
        spec.only("kind", "columns")
        text = spec.options.get("kind")
        kind = next((k for k in KINDS if k == text), None)
        if text is not None and kind is None:
            raise UnknownNameError("kind of KITTI folder", text, KINDS)
        columns = spec.whole("columns", FIRINGS_PER_PACKET, MAX_COLUMNS) or FRAME_COLUMNS
        return cls(spec.path, calibration, kind, columns)

    def packets(self) -> Iterator[Packet]:
        """Packets of all scans, from the first at each call. Cost: 40 ms a raw scan, 80 ms a re-gridded one.

        Raises SourceError at a scan that cannot be read.
        """
        packer = FiringPacker()
        self.fidelity.clear()
        for scan in self.scans:
            firings = self._firings(scan)
            if firings is not None:
                for packet in packer.push(firings, scan.start_ns, scan.end_ns):
                    if self.closed:
                        return
                    yield packet
        yield from packer.finish()

    def _firings(self, scan: Scan) -> Firings | None:
        points, bad = read_points(scan.path)
        if bad:
            self.counts["bad points"] += bad
        if not len(points):
            self.counts["empty scans"] += 1
            return None
        if self.kind == "raw":
            firings, fidelity = invert(points, self._geometry)
        else:
            firings, fidelity = regrid(points, self._geometry, self._columns)
        self.fidelity.append(fidelity)
        if fidelity.in_one_cell:
            self.counts["points in one cell"] += fidelity.in_one_cell
        if fidelity.out_of_range:
            self.counts["points out of range"] += fidelity.out_of_range
        return firings


def _first(scans: Sequence[Scan]) -> tuple[Scan, Points]:
    """The first scan that has points, and these. Raises SourceError if there is none."""
    for scan in scans:
        points, _ = read_points(scan.path)
        if len(points):
            return scan, points
    raise SourceError(f"{scans[0].path} and all scans after it have no points")


def _calibration(scan: Path, given: Path | None) -> SensorModel | None:
    """The calibration of the KITTI sensor: given, beside the scans or in a folder above, or in LIDARCODEC_DATA."""
    if given is not None:
        return read_calibration(given, "given")
    folders = list(scan.resolve().parents)
    if "LIDARCODEC_DATA" in os.environ:
        folders.append(Path(os.environ["LIDARCODEC_DATA"]))
    for folder in folders:
        for ending in (".yaml", ".xml"):
            for path in sorted(folder.glob(RECOVERED + ending)):
                logger.info("calibration of %s from %s", scan.parent, path)
                return read_calibration(path, "beside")
    return None


def _kind_of(scan: Scan, points: Points, sensor: SensorModel | None) -> Kind:
    """Raw if the points fit the calibration; without one, if their coordinates are whole millimetres.

    Raises SourceError if they are raw and do not fit.
    """
    if not is_millimetres(points):
        return "odometry"
    if sensor is None:
        return "raw"
    share = invert(points, Geometry(sensor))[1].within_1mm
    if share < FITS:
        raise SourceError(
            f"{scan.path} is a raw scan, but only {share:.1%} of its points fit calibration {sensor.hash} "
            f"({sensor.origin}): give the recovered calibration of KITTI's sensor, or add ?kind=odometry to "
            "re-grid the scan"
        )
    return "raw"


def _missing(scan: Path) -> str:
    return (
        f"{scan} is a raw KITTI scan, and goes back to packets only with the recovered calibration of its sensor, "
        f"which is not shipped (CC BY-NC-SA 3.0): give it with --calibration, or put {RECOVERED}.yaml or .xml into "
        f"{scan.parent}, a folder above, or the folder that LIDARCODEC_DATA names; ?kind=odometry re-grids without it"
    )
