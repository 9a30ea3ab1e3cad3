"""Accuracy of localisation with decoded frames: one drive, every method, the paper's protocol.

read the drive -> reference poses -> for every method: reduce, encode, decode -> map -> localise every scored scan
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.bench import effective
from lidarcodec.evaluation.localisation.cache import Arrays, Cache, digest
from lidarcodec.evaluation.localisation.coding import Received, received, with_odometry
from lidarcodec.evaluation.localisation.counts import Counted, place_counts
from lidarcodec.evaluation.localisation.drive import Drive, read_drive
from lidarcodec.evaluation.localisation.errors import pose_errors
from lidarcodec.evaluation.localisation.fitting import fitted
from lidarcodec.evaluation.localisation.icp import LOCALISERS, World
from lidarcodec.evaluation.localisation.maps import merged, whole_map
from lidarcodec.evaluation.localisation.methods import Method
from lidarcodec.evaluation.localisation.protocol import (
    PROTOCOLS,
    Protocol,
    Scored,
    judged,
    references,
    run,
    scored_frames,
)
from lidarcodec.evaluation.localisation.reference import Noise, Reference, ReferenceName, find_reference
from lidarcodec.evaluation.localisation.selection import CHOICES, kept
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Trajectory, voxel_means
from lidarcodec.frame import Frame

MapKind = Literal["whole", "own"]
Receiver = Literal["decoded", "voxel"]
MAPS: Final[tuple[MapKind, ...]] = ("whole", "own")
RECEIVERS: Final[tuple[Receiver, ...]] = ("decoded", "voxel")
RECEIVED_CELL_M: Final = 0.5
Tick = Callable[[], None]


@dataclass(frozen=True)
class Options:
    """Options of the localisation; every combination is measured. stride: every `stride`-th scan is tracked"""

    maps: Sequence[MapKind] = ("whole",)
    receivers: Sequence[Receiver] = ("decoded",)
    localisers: Sequence[str] = ("plane",)
    protocols: Sequence[Protocol] = PROTOCOLS
    reference: ReferenceName = "auto"
    stride: int = 3
    seed: int = 1


@dataclass(frozen=True)
class Outcome:
    """result: plain values, as in `--json`; errors: errors of all estimates by protocol, (N,) each; estimates: (N,
    4, 4) by protocol; world: (M, 3) the map made of the decoded frames"""

    result: dict[str, Any]
    errors: dict[str, dict[str, Matrix]] = field(default_factory=dict)
    estimates: dict[str, Matrix] = field(default_factory=dict)
    world: Matrix | None = None


class Evaluation:
    """One drive. Everything is computed when it is first needed.

    Raises SourceError, SettingsError, CalibrationError if the source or its poses cannot be used.
    """

    def __init__(
        self,
        spec: str | Path,
        options: Options,
        cache: Cache,
        *,
        framing: str = "revolution",
        frames: int | None = None,
        skip: int = 0,
        calibration: Path | None = None,
        poses: Path | None = None,
        tick: Tick = lambda: None,
    ) -> None:
        given = {"framing": framing, "frames": frames, "skip": skip, "calibration": calibration, "poses": poses}
        self.drive: Drive = read_drive(spec, **given, tick=tick)  # type: ignore[arg-type]
        self.options, self.cache, self.tick = options, cache, tick
        self.scored: Scored = scored_frames(len(self.drive.frames), options.stride)
        self.mapped: list[int] = self.scored.mapped.tolist()
        drive = digest(
            self.drive.stamps_ns, self.drive.frames[0].sensor.hash, *(frame.range for frame in self.drive.frames)
        )
        self.reference: Reference = self._found(drive)
        self._name = digest(drive, self.reference.poses, self.reference.velocities, self.scored.mapped)
        self._worlds: dict[str, World] = {}
        self._last: tuple[str, str, World] | None = None

    def _found(self, drive: str) -> Reference:
        name = self.options.reference
        if name == "given" or (name == "auto" and self.drive.exact):
            return find_reference(self.drive, name)

        def made() -> Arrays:
            found = find_reference(self.drive, name, self.tick)
            noise = found.noise or Noise(0.0, 0.0, ())
            return {
                "poses": found.poses,
                "velocities": found.velocities,
                "noise": np.array([noise.metres, noise.degrees, *noise.slide_m]),
            }

        before = self.cache.arrays(digest("refined", drive), made)
        metres, degrees, *slide = before["noise"].tolist()
        found = Trajectory(self.drive.stamps_ns, before["poses"], before["velocities"])
        return Reference(found, "refined", Noise(metres, degrees, tuple(slide)))

    def method(self, method: Method) -> list[Outcome]:
        """Measure a method with every map, receiver and localiser.

        Raises SettingsError, UnknownNameError, DecodeError of encoder and decoder.
        """
        chosen = fitted(method, self._sent)
        coded = self._sent(chosen, sorted({*self.scored.all, *self.mapped}))
        own = merged(moved(self.reference.poses[at], self._cloud(at, coded.frames[at])) for at in self.mapped)
        base = self._about(chosen, coded, own)
        frames = coded.frames
        name = digest(self._name, *(frames[at].range for at in self.scored.all))
        found = []
        for kind, localiser, receiver in product(self.options.maps, self.options.localisers, self.options.receivers):
            place = digest(own) if kind == "own" else self._name
            estimates: dict[str, Matrix] = {
                protocol: self.cache.arrays(
                    digest(name, place, localiser, receiver, protocol, [self.options.stride, self.options.seed]),
                    partial(self._estimates, protocol, frames, localiser, receiver, place, own),
                )["poses"]
                for protocol in self.options.protocols
            }
            found.append(
                self._outcome({**base, "map": kind, "receiver": receiver, "localiser": localiser}, estimates, own)
            )
        return found

    def _estimates(
        self,
        protocol: Protocol,
        frames: dict[int, Frame],
        localiser: str,
        receiver: Receiver,
        place: str,
        own: Matrix,
    ) -> Arrays:
        def seen(at: int) -> Matrix:
            cloud = self._cloud(at, frames[at])
            return voxel_means(cloud, RECEIVED_CELL_M) if receiver == "voxel" else cloud

        world = self._whole(localiser) if place == self._name else self._own(localiser, place, own)
        return {"poses": run(protocol, world, seen, self.reference.poses, self.scored, self.options.seed)}

    def _outcome(self, about: dict[str, Any], estimates: dict[str, Matrix], own: Matrix) -> Outcome:
        errors = {
            protocol: pose_errors(found, references(protocol, self.reference.poses, self.scored))
            for protocol, found in estimates.items()
        }
        judgements = {name: judged(name, values, self.options.seed) for name, values in errors.items()}
        return Outcome({**about, **judgements}, errors, dict(estimates), own)

    def _sent(self, method: Method, wanted: Sequence[int], only: Sequence[int] | None = None) -> Received:
        """The decoded frames. only: send only these frames (possible because a choice depends on one frame)."""
        frames = self._frames
        if method.reduction not in CHOICES:
            sent = frames if only is None else [frames[at] for at in only if at < len(frames)]
            return received(sent, method.settings, wanted, tick=self.tick)
        places = [at for at in (wanted if only is None else only) if at < len(frames)]
        numbers = {frames[at].index: at for at in places}

        def choose(frame: Frame) -> Frame:
            return kept(frame, method.reduction, method.points or 0, lambda: self._counts(numbers[frame.index]))

        found = received([frames[at] for at in places], method.settings, range(len(places)), choose, self.tick)
        found.frames = {places[at]: frame for at, frame in found.frames.items()}
        return found

    @cached_property
    def _frames(self) -> list[Frame]:
        return with_odometry(self.drive, self.reference, self.options.seed)

    @cached_property
    def _counted(self) -> Counted:
        def made() -> Arrays:
            places, counts = place_counts(self.drive, self.reference, self.mapped, self.tick)
            return {"places": places, "counts": counts}

        arrays = self.cache.arrays(digest("counts", self._name), made)
        return Counted(arrays["places"], arrays["counts"])

    def _counts(self, at: int) -> npt.NDArray[np.int32]:
        return self._counted.of(moved(self.reference.poses[at], self._cloud(at)))

    def _cloud(self, at: int, frame: Frame | None = None) -> Matrix:
        return self.drive.cloud(at, self.reference.velocities[at], frame)

    def _own(self, localiser: str, place: str, own: Matrix) -> World:
        """The map of a method's decoded frames, by its digest. It is kept until the next one."""
        if self._last is None or self._last[:2] != (localiser, place):
            self._last = localiser, place, LOCALISERS[localiser](own)
        return self._last[2]

    def _whole(self, localiser: str) -> World:
        if localiser not in self._worlds:
            whole = whole_map(self.drive, self.reference, self.mapped)
            self._worlds[localiser] = LOCALISERS[localiser](whole)
        return self._worlds[localiser]

    def _about(self, method: Method, coded: Received, own: Matrix) -> dict[str, Any]:
        returns = sum(self.drive.frames[at].points for at in self.mapped)
        whole_turn_s = float(np.median(np.diff(self.drive.stamps_ns))) * 1e-9
        travelled = np.linalg.norm(np.diff(self.reference.poses[:, :3, 3], axis=0), axis=1).sum()
        return {
            "source": self.drive.name,
            "frames": len(self.drive.frames),
            "metres": round(float(travelled), 1),
            "reference": self.reference.about(),
            "reduction": method.reduction,
            "keep_points": method.points,
            "codec": method.settings.codec,
            "settings": effective(method.settings),
            "points_per_frame": round(coded.frame_points, 1),
            "bytes_per_frame": round(coded.frame_bytes, 1),
            "bits_per_beforepoint": round(coded.frame_bytes * 8 / max(coded.frame_points, 1.0), 3),
            "kbps": round(coded.frame_bytes * 8 / whole_turn_s / 1000, 1),
            "map_points": len(own),
            "r_c": round(len(own) / returns, 6),
        }
