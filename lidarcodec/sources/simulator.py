"""SimulatorSource: packets of an HDL-64E S2 on a car that drives through a simulated town, without end. Drives of other
sensors are in `spinning/`.

The native core simulates scene and sensor; the same seed gives the same bytes on every machine. docs/simulator.md
describes the scenes and compares them with real drives.

>>> source = SimulatorSource.from_spec("sim:city?seed=3&frames=1")
>>> stamps = [packet.stamp_ns for packet in source.packets()]
>>> len(stamps), source.sensor.origin, source.poses(stamps).shape
(359, 'simulated', (359, 4, 4))
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.assembly.rotation import RotationWatch
from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import HDL64E, Calibration, SensorModel
from lidarcodec.sensors.find import find_sensor
from lidarcodec.sources.drive import LABELS, MAX_FRAMES, MAX_SEED, MAX_SKIP, SCENES, START_NS, SimulatedDrive
from lidarcodec.sources.spec import Spec, parse
from lidarcodec.units import FRAME_PACKETS, PACKET_BYTES

__all__ = ["LABELS", "MAX_TRUTH", "PACKET_NS", "SCENES", "START_NS", "SimulatorSource", "simulated_sensor"]

PACKET_NS: Final[int] = _native.SIMULATOR_PACKET_NS
"""Time from packet to packet: 288 us by a clock that is 21 ppm slow."""
CHUNK_PACKETS: Final = 29
"""Packets a native call: a twelfth of a turn."""
SENSOR_OPTIONS: Final = ("profile", "mode", "returns")
"""Options of a source that choose what a sensor beside the HDL-64E sends."""
MAX_TRUTH: Final = 100_000


@lru_cache(maxsize=1)
def simulated_sensor() -> SensorModel:
    """The simulated sensor, with the calibration of the simulation, which the packets' status bytes carry too."""
    rot, vert, dist, vertical, horizontal, focal, slope = _native.simulator_calibration().T.astype(np.float64)
    return SensorModel(
        "HDL-64E S2",
        Calibration.from_values(
            {
                "rot_correction_rad": rot * math.radians(0.01),
                "vert_correction_rad": vert * math.radians(0.01),
                "dist_correction_m": dist * 0.001,
                "dist_correction_x_m": dist * 0.001,
                "dist_correction_y_m": dist * 0.001,
                "vert_offset_m": vertical * 0.001,
                "horiz_offset_m": horizontal * 0.001,
                "focal_distance_m": focal * 0.001,
                "focal_slope": slope * 0.1,
            }
        ),
        origin="simulated",
    )


class SimulatorSource(SimulatedDrive):
    """A drive of an HDL-64E through a simulated scene, as a source of packets. Each call of `packets` restarts it.

    scene:    one of SCENES
    seed:     determines town, traffic and noise
    frames:   number of turns; None = endless
    speed:    top speed in m/s, 0.5 to 40; None = that of the scene
    traffic:  factor of the scene's usual traffic, 0 to 3
    skip:     how many times 348 packets (0.1 s) to leave out at the start of the drive
    start_ns: host and GPS time of the first packet without `skip`, ns since the Unix epoch; the attribute is that of
              the first packet
    only:     exactly this number of packets instead of turns, from wherever the sensor looks when the drive starts

    Without `only` the first packet is the first of a turn. A packet's time stamp is the moment of its first firing, by
    the host's clock and by GPS.
    Raises UnknownNameError for another scene, SourceError for a value out of range.
    """

    def __init__(
        self,
        scene: str = "city",
        seed: int = 1,
        frames: int | None = None,
        *,
        speed: float | None = None,
        traffic: float = 1.0,
        skip: int = 0,
        start_ns: int = START_NS,
        only: int | None = None,
    ) -> None:
        super().__init__(
            simulated_sensor(), scene, seed, frames, speed=speed, traffic=traffic, skip=skip, start_ns=start_ns
        )
        if only is not None and frames is not None:
            raise SourceError(f"sim:{scene}: give frames or packets, not both")
        self.only = only
        self._skipped = skip * FRAME_PACKETS
        if only is None:
            self._begin(max(start_ns - _packets_before_a_turn(seed, 0) * PACKET_NS, 0))
            self._skipped += _packets_before_a_turn(seed, self._skipped)
        self.start_ns = self.drive_ns + self._skipped * PACKET_NS

    @classmethod
    def from_spec(cls, spec: Spec | str, calibration: Path | None = None) -> SimulatedDrive:
        """The source for `sim:SCENE?key=value&...`; keys: seed, frames, skip, speed, traffic, sensor, and those of the
        sensor: profile and mode of an Ouster, returns of the others.

        calibration: a file to decode with instead of the simulated unit's own table
        Raises UnknownNameError for another scene, sensor or key, SourceError for a bad value.
        """
        given = parse(spec) if isinstance(spec, str) else spec
        if given.scheme != "sim":
            raise SourceError(f"'{given.text}' is not a simulated drive: use sim:{', sim:'.join(SCENES)}")
        named = given.options.get("sensor", HDL64E) != HDL64E
        given.only("seed", "frames", "skip", "speed", "traffic", "sensor", "packets", *SENSOR_OPTIONS)
        odd = [] if named else [name for name in SENSOR_OPTIONS if name in given.options]
        if odd:
            raise SourceError(
                f"source option {odd[0]} is not for an HDL-64E: leave it out, or choose another sensor with sensor=..."
            )
        seed, traffic = given.whole("seed", 0, MAX_SEED), given.number("traffic", 0.0, 3.0)
        only = given.whole("packets", 1, MAX_FRAMES)
        if named and only is not None:
            raise SourceError("source option packets is only for an HDL-64E: use frames, the number of turns")
        make = partial(_spinning, given) if named else partial(cls, only=only)
        source = make(
            given.place or "city",
            1 if seed is None else seed,
            given.whole("frames", 1, MAX_FRAMES),
            speed=given.number("speed", 0.5, 40.0),
            traffic=1.0 if traffic is None else traffic,
            skip=given.whole("skip", 0, MAX_SKIP) or 0,
        )
        if calibration is not None:
            source.sensor = find_sensor(None, calibration, (), source.sensor.model)
        return source

    def packets(self) -> Iterator[Packet]:
        """The drive's packets, from its start."""
        simulator, rotation = self._simulator(), RotationWatch()
        left = math.inf if self.only is None else self.only
        turns, first = 1, 0
        while left > 0:
            count = int(min(CHUNK_PACKETS, left))
            data = simulator.packets(count).tobytes()
            for k in range(count):
                payload = data[k * PACKET_BYTES : (k + 1) * PACKET_BYTES]
                turns += rotation.begins(payload)
                if self.closed or (self.frames is not None and turns > self.frames):
                    return
                yield Packet(payload, self.start_ns + (first + k) * PACKET_NS)
            first += count
            left -= count

    def truth(self, packets: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        """The first `packets` packets with the true distance and the label of each return.

        Gives the payloads (P, 1206) uint8, true distances along the beams (6 P, 64) float32 in metres by firing and
        hardware laser, 0 = nothing there, and labels (6 P, 64) uint8, indices into LABELS.
        Raises SourceError for more than 100000 packets.
        """
        if not 0 <= packets <= MAX_TRUTH:
            raise SourceError(f"sim:{self.scene}: the truth can be had of 0 to 100000 packets, not {packets}")
        payloads, distance_m, labels = self._simulator().packets_with_truth(packets)
        return payloads, distance_m, labels

    def _simulator(self) -> Any:
        simulator = _native.Simulator(*self._options, self.drive_ns)
        simulator.skip(self._skipped)
        return simulator


@lru_cache(maxsize=64)
def _packets_before_a_turn(seed: int, skipped: int) -> int:
    """Packets from the one after `skipped` to the first one of a turn. The rotor is the same in every scene."""
    simulator, rotation = _native.Simulator("garage", seed, 0.0, 0.0, START_NS), RotationWatch()
    simulator.skip(skipped)
    number = 0
    while not rotation.begins(simulator.packets(1).tobytes()):
        number += 1
    return number


def _spinning(spec: Spec, *drive: Any, **options: Any) -> SimulatedDrive:
    """The drive of another sensor. Its modules are imported only here: an HDL-64E does not need them."""
    from lidarcodec.sources.spinning.source import SpinningSource
    from lidarcodec.sources.spinning.table import Wanted

    wanted = Wanted(spec.options["sensor"], *(spec.options.get(name) for name in SENSOR_OPTIONS))
    return SpinningSource(wanted, *drive, **options)
