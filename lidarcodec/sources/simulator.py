"""SimulatorSource: packets of an HDL-64E S2 on a car that drives through a simulated town, without end.

The native core simulates scene and sensor; the same seed gives the same bytes on every machine. docs/simulator.md
describes the scenes and compares them with real drives.

>>> source = SimulatorSource.from_spec("sim:city?seed=3&frames=1")
>>> stamps = [packet.stamp_ns for packet in source.packets()]
>>> len(stamps), source.sensor.origin, source.poses(stamps).shape
(348, 'simulated', (348, 4, 4))
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.sensors import read_calibration
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.poses import Poses
from lidarcodec.sources.spec import Spec, parse
from lidarcodec.units import FRAME_PACKETS, PACKET_BYTES

SCENES: Final = ("city", "road", "street", "bend", "motorway")
START_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: default host and GPS time of the first packet."""
PACKET_NS: Final[int] = _native.SIMULATOR_PACKET_NS
"""Time from packet to packet: 288 us by a clock that is 21 ppm slow."""
LABELS: Final = ("none", "ground", "building", "vegetation", "vehicle", "person", "pole", "other")
"""Name of each label in `truth`."""
CHUNK_PACKETS: Final = 29
"""Packets a native call: a twelfth of a turn."""
MAX_SEED: Final = 2**53 - 1
MAX_FRAMES: Final = 10**9
MAX_SKIP: Final = 10**6
MAX_TRUTH: Final = 100_000
FARTHEST_M: Final = 1e8
LONGEST_NS: Final = 30 * 86_400 * 10**9
"""Poses are found up to 30 days into a drive."""


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


class SimulatedPoses(Poses):
    """T_world_sensor of a simulated drive at any time, computed by simulating the drive again. World coordinates are
    those of the scene, in metres, z up; the first pose is not the identity.
    """

    def __init__(self, options: tuple[str, int, float, float], start_ns: int) -> None:
        self._finder = _native.SimulatorPoses(*options)
        self._options, self._start_ns = options, start_ns
        self.stamps_ns = np.array([start_ns], np.int64)
        self.relative = False

    def __call__(self, stamps_ns: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N, 4, 4) float64 at N host times, in any order: the poses used to simulate the packets.

        Times after the last call are fast (0.1 ms for each simulated second); earlier ones restart the drive.
        Raises SourceError for times before the start or 30 days after it.
        """
        times = np.asarray(stamps_ns, np.int64).reshape(-1) - self._start_ns
        if times.size and not 0 <= times.min() <= times.max() <= LONGEST_NS:
            raise SourceError(f"sim:{self._options[0]}: poses are known only for the first 30 days of the drive")
        order = np.argsort(times, kind="stable")
        found: npt.NDArray[np.float64] = np.empty((len(times), 4, 4))
        found[order] = self._finder.at(np.ascontiguousarray(times[order]))
        return found

    def at(self, stamp_ns: int) -> npt.NDArray[np.float64] | None:
        """(4, 4) T_world_sensor at a host time; None before the start."""
        if not 0 <= stamp_ns - self._start_ns <= LONGEST_NS:
            return None
        found: npt.NDArray[np.float64] = self([stamp_ns])[0]
        return found

    def starting(self, start_ns: int) -> Poses:
        """These poses: their times are absolute."""
        return self


class SimulatorSource(PacketSource):
    """A drive through a simulated scene, as a source of packets. Each call of `packets` restarts the drive.

    scene:    `city`, `road`, `street`, `bend` or `motorway`
    seed:     determines town, traffic and noise
    frames:   number of frames of 348 packets; None = endless
    speed:    top speed in m/s, 0.5 to 40; None = that of the scene
    traffic:  factor of the scene's usual traffic, 0 to 3
    skip:     number of frames of 348 packets to leave out at the start of the drive (cost: 1 s for 6000)
    start_ns: host and GPS time of the drive's start, ns since the Unix epoch; the attribute is the first packet's time

    A packet's time stamp is the moment of its first firing, by the host's clock and by GPS.
    Raises UnknownNameError for another scene, SourceError for a value out of range.
    """

    poses: SimulatedPoses
    start_ns: int

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
    ) -> None:
        if scene not in SCENES:
            raise UnknownNameError("simulated scene", scene, SCENES)
        if not 0 <= seed <= MAX_SEED:
            raise SourceError(f"sim:{scene}: seed must be a whole number from 0 to {MAX_SEED}, not {seed}")
        if frames is not None and not 1 <= frames <= MAX_FRAMES:
            raise SourceError(f"sim:{scene}: frames must be a whole number from 1 to {MAX_FRAMES}, not {frames}")
        if speed is not None and not 0.5 <= speed <= 40.0:
            raise SourceError(f"sim:{scene}: speed must be 0.5 to 40 m/s, not {speed}")
        if not 0.0 <= traffic <= 3.0:
            raise SourceError(f"sim:{scene}: traffic must be a number from 0 to 3, not {traffic}")
        if not 0 <= skip <= MAX_SKIP:
            raise SourceError(f"sim:{scene}: skip must be a whole number from 0 to {MAX_SKIP}, not {skip}")
        if not 0 <= start_ns < 2**61:
            raise SourceError(f"sim:{scene}: start_ns must be a time since 1970 in ns, not {start_ns}")
        super().__init__(simulated_sensor())
        self.label = f"simulated {scene}, seed {seed}"
        self.scene, self.seed, self.frames = scene, seed, frames
        self._skipped, self._drive_ns = skip * FRAME_PACKETS, start_ns
        self.start_ns = start_ns + self._skipped * PACKET_NS
        self._options = (scene, seed, 0.0 if speed is None else float(speed), float(traffic))
        self.poses = SimulatedPoses(self._options, start_ns)

    @classmethod
    def from_spec(cls, spec: Spec | str, calibration: Path | None = None) -> SimulatorSource:
        """The source for `sim:SCENE?key=value&...`; keys: seed, frames, skip, speed, traffic.

        calibration: a file to decode with instead of the simulated unit's own table
        Raises UnknownNameError for another scene or key, SourceError for a bad value.
        """
        given = parse(spec) if isinstance(spec, str) else spec
        if given.scheme != "sim":
            raise SourceError(
                f"'{given.text}' is not a simulated drive: use sim:city, sim:road, sim:street, sim:bend or sim:motorway"
            )
        given.only("seed", "frames", "skip", "speed", "traffic")
        seed, traffic = given.whole("seed", 0, MAX_SEED), given.number("traffic", 0.0, 3.0)
        source = cls(
            given.place or "city",
            1 if seed is None else seed,
            given.whole("frames", 1, MAX_FRAMES),
            speed=given.number("speed", 0.5, 40.0),
            traffic=1.0 if traffic is None else traffic,
            skip=given.whole("skip", 0, MAX_SKIP) or 0,
        )
        if calibration is not None:
            source.sensor = read_calibration(calibration)
        return source

    def packets(self) -> Iterator[Packet]:
        """The drive's packets, from its start."""
        simulator = self._simulator()
        left = math.inf if self.frames is None else self.frames * FRAME_PACKETS
        first = 0
        while left > 0:
            count = int(min(CHUNK_PACKETS, left))
            data = simulator.packets(count).tobytes()
            for k in range(count):
                if self.closed:
                    return
                payload = data[k * PACKET_BYTES : (k + 1) * PACKET_BYTES]
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
            raise SourceError(f"sim:{self.scene}: truth of 0 to 100000 packets, not {packets}")
        payloads, distance_m, labels = self._simulator().packets_with_truth(packets)
        return payloads, distance_m, labels

    def _simulator(self) -> Any:
        simulator = _native.Simulator(*self._options, self._drive_ns)
        simulator.skip(self._skipped)
        return simulator

    def ground_height(self, places: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N,) float64, height of the ground in the world at N places (N, 2): road, pavement or yard, without grass."""
        at = np.ascontiguousarray(np.asarray(places, np.float64).reshape(-1, 2))
        if not np.all(np.abs(at) < FARTHEST_M):
            raise SourceError(f"sim:{self.scene}: the world ends {FARTHEST_M:g} m from its middle")
        height: npt.NDArray[np.float64] = self._simulator().ground_height(at)
        return height
