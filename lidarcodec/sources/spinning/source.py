"""SpinningSource: packets of any sensor but the HDL-64E on a simulated drive.

>>> from lidarcodec.sources.spinning.table import Wanted
>>> source = SpinningSource(Wanted("vlp16"), "street", frames=1)
>>> packets = list(source.packets())
>>> len(packets), len(packets[0].payload), source.sensor.model
(75, 1206, 'vlp16')
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.assembly.any_sensor import TurnWatch
from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.sensors.images import Bytes, Images, Unsigned
from lidarcodec.sources.drive import START_NS, SimulatedDrive
from lidarcodec.sources.spinning.encoder import TURN, Numbers
from lidarcodec.sources.spinning.table import Wanted, detector_of, unit_of

CHUNKS_PER_TURN: Final = 8
MEASURED: Final = ("range", "intensity", "signal", "near_ir", "range2", "intensity2", "signal2")
"""Planes in the order in which the core gives them."""
FAR_STEPS: Final = 10_000
"""Range at which a second point of each beam is asked for; it fits every plane."""


class Simulated(NamedTuple):
    """P simulated packets: payloads (P, packet_bytes), time stamps (P,) in ns since the Unix epoch, images as they were
    joined, and (H, W) of each firing: its time in ns since the Unix epoch (or (1, W), if rows fire together), the true
    distance along its beam in metres, 0 = nothing there, and what is there, an index into LABELS."""

    payloads: Bytes
    stamps_ns: Numbers
    images: Images
    fired_ns: Numbers
    distance_m: npt.NDArray[np.float32]
    labels: npt.NDArray[np.uint8]


class SpinningSource(SimulatedDrive):
    """A drive through a simulated scene, seen by another sensor than the HDL-64E, as a source of packets.

    wanted: the sensor and its options; the rest as of SimulatorSource. A frame is a turn, and the first packet is
    the first of a turn; `skip` counts turns rounded up to whole packets.

    A packet's time stamp is the sensor's own. Raises UnknownNameError for another scene, sensor or option, SourceError
    for a value out of range.
    """

    def __init__(
        self,
        wanted: Wanted,
        scene: str = "city",
        seed: int = 1,
        frames: int | None = None,
        *,
        speed: float | None = None,
        traffic: float = 1.0,
        skip: int = 0,
        start_ns: int = START_NS,
    ) -> None:
        self.unit = unit_of(wanted, seed, start_ns)
        super().__init__(
            self.unit.model, scene, seed, frames, speed=speed, traffic=traffic, skip=skip, start_ns=start_ns
        )
        self.label = f"simulated {scene}, seed {seed}, {self.sensor.model}"
        self.frame_packets = self.unit.turn_packets
        self._first = self._begins_turn(skip * self.frame_packets)
        self.start_ns = start_ns + int(self.unit.heads(self._first, 1).stamps_ns[0])

    def packets(self) -> Iterator[Packet]:
        """The drive's packets, from its start."""
        simulator = self._spinning()
        turns, watch = 1, TurnWatch(self.sensor)
        first, chunk = self._first, max(1, self.frame_packets // CHUNKS_PER_TURN)
        while True:
            made = self._make(simulator, first, chunk)
            for payload, stamp_ns in zip(made.payloads, made.stamps_ns.tolist(), strict=True):
                data = payload.tobytes()
                turns += watch.begins(data)
                if self.closed or (self.frames is not None and turns > self.frames):
                    return
                yield Packet(data, stamp_ns)
            first += chunk

    def truth(self, packets: int) -> Simulated:
        """The first `packets` packets with what was simulated.

        Raises SourceError for none, or more than those of 100 turns.
        """
        if not 1 <= packets <= 100 * self.frame_packets:
            raise SourceError(
                f"sim:{self.scene}: the truth can be had of 1 to {100 * self.frame_packets} packets, not {packets}"
            )
        return self._make(self._spinning(), self._first, packets)

    def _begins_turn(self, first: int) -> int:
        """The number of the first packet from `first` on that begins a turn."""
        count = self.frame_packets + 2
        azimuths = self.unit.heads(first - 1, count).series.get("azimuth")
        if azimuths is None:  # an Ouster: its turns have the same number of packets, and the drive begins with one
            return first
        of_packets = azimuths.reshape(count, -1)[:, 0].astype(np.int64)
        return first + int(np.argmax(np.diff(of_packets) < -TURN // 2))

    def _spinning(self) -> _native.SpinningSimulator:
        layout = self.unit.layout
        return _native.SpinningSimulator(*self._options, detector_of(self.unit), layout.rows)

    def _make(self, simulator: _native.SpinningSimulator, first: int, count: int) -> Simulated:
        """The packets number `first` to `first + count - 1`. The one before them is there as well, because some models
        compute azimuths from the packet before."""
        unit, layout, sensor = self.unit, self.unit.layout, self.unit.sensor
        series, stamps = unit.heads(first - 1, count + 1)
        shape = (layout.rows, (count + 1) * layout.columns)
        planes = {plane.name: np.zeros(shape, plane.dtype) for plane in layout.planes}
        images = Images(planes, series)
        near = (np.broadcast_to(axis, shape) for axis in unit.origins(images))
        planes["range"] = np.full(shape, FAR_STEPS, planes["range"].dtype)
        far = sensor.points(unit.model, layout, images)
        times = np.repeat(stamps, layout.columns) + sensor.times_ns(layout, images)
        t_ns = np.ascontiguousarray(times[:, layout.columns :])
        beams = np.stack([axis[:, layout.columns :] for axis in (*near, *far)])
        measured = simulator.fire(t_ns, beams, FAR_STEPS * unit.model.range_step_m)
        found: dict[str, Unsigned] = dict(zip(MEASURED, measured[:-2], strict=True))
        for plane in layout.planes:
            made = found.get(plane.name, np.zeros(beams.shape[1:], plane.dtype))
            planes[plane.name] = made.astype(plane.dtype, copy=False)
        ours = {name: numbers[layout.series[name][1] :] for name, numbers in series.items()}
        images = Images(planes, ours)
        unit.silence(images)
        start_ns = self.drive_ns
        return Simulated(layout.join(images), start_ns + stamps[1:], images, start_ns + t_ns, *measured[-2:])
