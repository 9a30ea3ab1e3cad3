"""SimulatorSource: packets of an HDL-64E S2 on a car that drives through a made-up town. No file, no network, no end.

The scene is made and seen by the native core; the same seed gives the same bytes on every machine.

>>> source = SimulatorSource.from_spec("sim:city?seed=3&frames=1")
>>> sum(1 for packet in source.packets())
348
>>> source.sensor.origin
'simulated'
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from typing import Final
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.units import FRAME_PACKETS

SCENES: Final = ("city", "road", "street")
START_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: host and GPS time of the first packet, unless told otherwise."""
PACKET_NS: Final[int] = _native.SIMULATOR_PACKET_NS
"""Time from packet to packet: 288 us by a quartz that is 21 ppm slow."""
LABELS: Final = ("none", "ground", "building", "vegetation", "vehicle", "person", "pole", "other")
"""What a return belongs to, by the number in `truth`."""

_CHUNK = 29  # packets a native call: a twelfth of a turn
_MAX_SEED = 2**63
_MAX_FRAMES = 10**9


@lru_cache(maxsize=1)
def simulated_sensor() -> SensorModel:
    """The simulated unit; its calibration is what the simulation used, and what the packets' status bytes carry."""
    rot, vert, dist, vertical, horizontal, focal, slope = _native.simulator_calibration().T.astype(np.float64)
    return SensorModel(
        "HDL-64E S2",
        Calibration.from_values(
            {
                "rot_correction_rad": np.radians(rot * 0.01),
                "vert_correction_rad": np.radians(vert * 0.01),
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


class SimulatorSource:
    """A drive through a simulated scene, as a source of packets; every call of `packets` starts it anew.

    scene:    `city`, `road` or `street`
    seed:     names the town, the traffic and the noise
    frames:   how many times 348 packets; None = endless
    speed:    top speed in m/s, 0.5 to 40; None = what the scene has
    traffic:  share of the scene's usual traffic, 0 to 3
    start_ns: host and GPS time of the first packet, ns since the Unix epoch

    A packet's time stamp is the moment of its first firing, by the host's clock and by GPS.
    Raises UnknownNameError for another scene, SourceError for a value out of range.
    """

    live: bool = False

    def __init__(
        self,
        scene: str = "city",
        seed: int = 1,
        frames: int | None = None,
        *,
        speed: float | None = None,
        traffic: float = 1.0,
        start_ns: int = START_NS,
    ) -> None:
        if scene not in SCENES:
            raise UnknownNameError("simulated scene", scene, SCENES)
        if not 0 <= seed < _MAX_SEED:
            raise SourceError(f"sim:{scene}: seed is a whole number from 0 to {_MAX_SEED - 1}, not {seed}")
        if frames is not None and not 1 <= frames <= _MAX_FRAMES:
            raise SourceError(f"sim:{scene}: frames is a whole number from 1 to {_MAX_FRAMES}, not {frames}")
        if speed is not None and not 0.5 <= speed <= 40.0:
            raise SourceError(f"sim:{scene}: speed is 0.5 to 40 m/s, not {speed}")
        if not 0.0 <= traffic <= 3.0:
            raise SourceError(f"sim:{scene}: traffic is a share from 0 to 3, not {traffic}")
        if not 0 <= start_ns < 2**62:
            raise SourceError(f"sim:{scene}: start_ns is a time since 1970 in ns, not {start_ns}")
        self.sensor = simulated_sensor()
        self.counts: Counter[str] = Counter()
        self.scene, self.seed, self.frames = scene, seed, frames
        self.start_ns = start_ns
        self._options = (scene, seed, 0.0 if speed is None else float(speed), float(traffic))
        self._closed = False

    @classmethod
    def from_spec(cls, spec: str) -> SimulatorSource:
        """The source that `sim:SCENE?key=value&...` names; keys: seed, frames, speed, traffic.

        Raises UnknownNameError for another scene, SourceError for an unknown key or a bad value.
        """
        parts = urlsplit(spec)
        if parts.scheme != "sim" or parts.netloc or parts.fragment:
            raise SourceError(
                f"'{spec}' is no simulator: write sim:city, sim:road or sim:street, with ?seed=1&frames=100"
            )
        given: dict[str, int | float] = {}
        for key, value in parse_qsl(parts.query, keep_blank_values=True):
            kind = _SPEC_KEYS.get(key)
            if kind is None:
                raise SourceError(f"{spec}: unknown key '{key}': known are {', '.join(_SPEC_KEYS)}")
            if key in given:
                raise SourceError(f"{spec}: {key} is given twice")
            try:
                given[key] = kind(value)
            except ValueError:
                wanted = "a whole number" if kind is int else "a number"
                raise SourceError(f"{spec}: {key} is {wanted}, not '{value}'") from None
            if not math.isfinite(given[key]):
                raise SourceError(f"{spec}: {key} is a number, not '{value}'")
        return cls(parts.path or "city", **given)  # type: ignore[arg-type]

    def packets(self) -> Iterator[Packet]:
        """The drive's packets, from its start."""
        simulator = _native.Simulator(*self._options, self.start_ns // 10**9)
        left = math.inf if self.frames is None else self.frames * FRAME_PACKETS
        first = 0
        while left > 0 and not self._closed:
            count = int(min(_CHUNK, left))
            data = simulator.packets(count).tobytes()
            size = len(data) // count
            for k in range(count):
                yield Packet(data[k * size : (k + 1) * size], self.start_ns + (first + k) * PACKET_NS)
            first += count
            left -= count

    def truth(self, packets: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        """The first `packets` packets with what is behind each return.

        Gives the payloads (P, 1206) uint8, true distances along the beams (6 P, 64) float32 in metres by firing and
        hardware laser, 0 = nothing there, and labels (6 P, 64) uint8, indices into LABELS.
        Raises SourceError for more than 100000 packets.
        """
        if not 0 <= packets <= 100_000:
            raise SourceError(f"sim:{self.scene}: truth of 0 to 100000 packets, not {packets}")
        simulator = _native.Simulator(*self._options, self.start_ns // 10**9)
        payloads, distance_m, labels = simulator.packets_with_truth(packets)
        return payloads, distance_m, labels

    def poses(self, stamps_ns: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N, 4, 4) float64, T_world_sensor at host times: the exact poses the packets were made with.

        The drive is driven again without looking at anything: about 1 ms for 10 s of the city.
        Raises SourceError for times before the start.
        """
        times = np.asarray(stamps_ns, np.int64).reshape(-1) - self.start_ns
        if times.size and times.min() < 0:
            raise SourceError(f"sim:{self.scene}: the drive has no pose before its start at {self.start_ns} ns")
        order = np.argsort(times, kind="stable")
        found: npt.NDArray[np.float64] = np.empty((len(times), 4, 4))
        found[order] = _native.simulator_poses(*self._options, np.ascontiguousarray(times[order]))
        return found

    def close(self) -> None:
        """Ends a `packets` that goes on; harmless when called twice."""
        self._closed = True

    def __enter__(self) -> SimulatorSource:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


_SPEC_KEYS: dict[str, type[int] | type[float]] = {"seed": int, "frames": int, "speed": float, "traffic": float}
