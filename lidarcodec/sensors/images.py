"""Images: the packets of any spinning sensor as integer planes and series of numbers.

`PacketLayout.split` turns packets into Images, `PacketLayout.join` turns them back. `join(split(p)) == p` holds for
each packet p, or p is carried as it is (`split_all` checks this), so packets of any bytes come back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError

if TYPE_CHECKING:
    from lidarcodec.sensor_model import Origin, SensorModel

Unsigned = npt.NDArray[np.unsignedinteger]
Bytes = npt.NDArray[np.uint8]
Metres = npt.NDArray[np.float64]

MAX_PLANES = 12
"""Most planes of a frame."""
MAX_CELLS = 5 << 20
"""Most numbers of all planes of a frame: as many as ten planes of 128 rows and 4,096 columns."""

QUANTITIES = frozenset({"intensity", "signal", "near_ir"})
"""Attributes of first returns that measure something, so that a value between two others means something."""

PlaneRole = Literal["range", "second range", "attribute"]


class Plane(NamedTuple):
    """A plane of a packet layout.

    name: `range`, `range2`, `intensity`, `intensity2`, `signal`, `signal2`, `near_ir`, ...; `bits`: largest width of
    its values, 1 to 20; role: what it is; `of`: for an attribute, the range plane whose returns it describes
    """

    name: str
    bits: int
    role: PlaneRole
    of: str = "range"

    @property
    def dtype(self) -> np.dtype[np.unsignedinteger]:
        """u8, u16 or u32: the smallest that holds the plane's values."""
        return np.dtype(np.uint8 if self.bits <= 8 else np.uint16 if self.bits <= 16 else np.uint32)


@dataclass(frozen=True, eq=False)
class Images:
    """Packets as images: H rows from the top beam down, W columns in the order in which they were sent.

    planes: name -> (H, W), u8, u16 or u32 as `Plane.dtype` says; a range of 0 is no return
    series: name -> (N,) unsigned integers in packet order: one a packet, a column or a block, as the layout says
    """

    planes: dict[str, Unsigned]
    series: dict[str, Unsigned] = field(default_factory=dict)


class Turn(NamedTuple):
    """Where a packet says how far the sensor has turned: a u16, little endian, at `offset`; it wraps at `span`.

    counts: the u16 is no position but the number of the turn
    """

    offset: int
    span: int
    counts: bool = False


class PacketLayout(Protocol):
    """How packets of one size hold their values. Stateless."""

    @property
    def turn(self) -> Turn:
        """Where a packet says how far the sensor has turned."""

    @property
    def name(self) -> str:
        """Name of the layout within its sensor, such as `dual`; letters, digits and `_`."""

    @property
    def marks(self) -> tuple[tuple[int, int], ...]:
        """Bytes that every packet has, as (offset, value): the most telling first."""

    @property
    def packet_bytes(self) -> int:
        """Size of each packet's UDP payload."""

    @property
    def rows(self) -> int:
        """H."""

    @property
    def columns(self) -> int:
        """Columns of one packet."""

    @property
    def planes(self) -> tuple[Plane, ...]:
        """The planes; the first is `range`."""

    @property
    def series(self) -> Mapping[str, tuple[np.dtype[np.unsignedinteger], int]]:
        """Name of each series -> type of its numbers, and how many of them a packet has."""

    def fits(self, packets: Bytes) -> npt.NDArray[np.bool_]:
        """(P,) bool, which packets `split` can take. packets: (P, packet_bytes)."""

    def split(self, packets: Bytes) -> Images:
        """Images of packets that fit; W is P times `columns`. packets: (P, packet_bytes)."""

    def join(self, images: Images) -> Bytes:
        """(P, packet_bytes): packets of images, the inverse of `split`.

        Raises SectionError if the shapes or the lengths of series do not fit together, or a value does not fit its
        field.
        """


def packets_of_images(layout: PacketLayout, images: Images) -> int:
    """P, from the shapes of the planes. Raises SectionError if they are not the planes and series of the layout."""
    names = {plane.name for plane in layout.planes}
    if set(images.planes) != names or set(images.series) != set(layout.series):
        given = ", ".join(sorted({*images.planes, *images.series}))
        raise SectionError(f"images with {given} are not of the layout {layout.name}")
    shape = images.planes["range"].shape
    if len(shape) != 2 or shape[0] != layout.rows or shape[1] % layout.columns:
        raise SectionError(f"planes of the layout {layout.name} are {layout.rows} x {layout.columns} n, not {shape}")
    for name, plane in images.planes.items():
        if plane.shape != shape:
            raise SectionError(f"plane {name} is {plane.shape}, but range is {shape}")
    return int(shape[1]) // layout.columns


def check_series(layout: PacketLayout, series: Mapping[str, Unsigned], packets: int) -> None:
    """Raises SectionError if these are not the series of so many packets of a layout."""
    if set(series) != set(layout.series):
        raise SectionError(f"series {', '.join(sorted(series))} are not those of the layout {layout.name}")
    for name, (dtype, each) in layout.series.items():
        numbers = series[name]
        if numbers.shape != (packets * each,):
            raise SectionError(f"series {name} is {numbers.shape}, but {packets} packets have {packets * each} values")
        if numbers.dtype.kind != "u" or (numbers.size and int(numbers.max()) > int(np.iinfo(dtype).max)):
            raise SectionError(f"series {name} holds numbers that are not {dtype}")


class Sensor(Protocol):
    """A model of sensor. One file in `lidarcodec/sensors/models` and one line in its table."""

    @property
    def name(self) -> str:
        """As in `--model`: `vlp16`."""

    @property
    def title(self) -> str:
        """For people: `Velodyne VLP-16 (Puck)`."""

    @property
    def range_step_m(self) -> float:
        """Metres of one range unit."""

    @property
    def per_unit(self) -> bool:
        """Whether each unit comes with a calibration file of its own, without which points are a little off."""

    @property
    def packet_sizes(self) -> frozenset[int]:
        """Sizes of its packets' UDP payloads."""

    @property
    def generic_sensor(self) -> SensorModel:
        """The SensorModel with the nominal calibration of this model, for streams that come without their own."""

    def calibrated(self, data: bytes, origin: Origin, name: str) -> SensorModel:
        """The SensorModel of the unit that a calibration file describes. name: of the file, for errors.

        Raises CalibrationError if the file is of another kind or of another sensor.
        """

    def evidence(self, payload: bytes) -> str | None:
        """Why this packet is one of this model, as a sentence for people; None if it is not."""

    def layout_of(self, payload: bytes) -> PacketLayout | None:
        """The layout of a packet, by its size and its mode bytes; None if it is no packet of this model."""

    def named_layout(self, name: str) -> PacketLayout | None:
        """The layout of that name."""

    def azimuth(self, layout: PacketLayout, images: Images) -> npt.NDArray[np.uint16]:
        """(W,) rotation position of each column, 0.01 degree, 0 to 35999, growing clockwise seen from above."""

    def times_ns(self, layout: PacketLayout, images: Images) -> npt.NDArray[np.int64]:
        """(H, W) int64, or (1, W) where all rows of a column share it: time of each return after its packet's own time
        stamp (negative: before it), ns."""

    def points(
        self, sensor: SensorModel, layout: PacketLayout, images: Images, plane: str = "range"
    ) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres of every cell, (H, W) float64 each; x forward, y left, z up. plane: a range plane.

        Values of cells without a return mean nothing.
        """
