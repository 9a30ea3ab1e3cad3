"""What messages of other sensors than the HDL-64E hold: sections of planes, and of what else is in packets.

Of a frame thinned to some columns the images hold these alone, and a LATTICE section names them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import CodecSettings, InForce
from lidarcodec.codecs.frame_encoder import Coded
from lidarcodec.codecs.referring import ReferringSettings
from lidarcodec.entropy.rest_coder import encode_rest
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.lattice import Lattice
from lidarcodec.message import Section, SectionType
from lidarcodec.packet_rest import PacketRest
from lidarcodec.planes.attribute_values import AttributeQuality, reduced
from lidarcodec.planes.clouds.section import CloudBefore, encode_cloud
from lidarcodec.planes.frame_before import SentBefore
from lidarcodec.planes.lattice_section import lattice_bytes
from lidarcodec.planes.plane_section import PlaneKind, encode_plane_section
from lidarcodec.planes.sections import pose_sections, position_sections
from lidarcodec.sensors.clouds.points import payload_of
from lidarcodec.sensors.images import PacketLayout, Plane, Unsigned
from lidarcodec.settings import step_of


def frame_sections(frame: Frame, images: Sequence[Section]) -> list[Section]:
    """All sections of a frame except its calibration. images: those of its planes

    Raises SectionError for a frame without its packets' series.
    """
    sections = [Section(SectionType.REST, encode_rest(_rest_of(frame))), *images]
    if frame.lattice is not None:
        sections.append(Section(SectionType.LATTICE, lattice_bytes(Lattice(frame.width, frame.lattice))))
    return sections + position_sections(frame) + pose_sections(frame)


def _rest_of(frame: Frame) -> PacketRest:
    rest = frame.side
    if not isinstance(rest, PacketRest):
        raise SectionError("a frame of this sensor without its packets' series cannot be sent")
    return rest


class PlaneContent:
    """What a codec sends of a frame of another sensor than an HDL-64E."""

    _settings: InForce[CodecSettings]

    def __init__(self, kind: PlaneKind) -> None:
        self._kind = kind
        self._before = SentBefore() if kind == PlaneKind.FOLLOWING else None
        self._cloud_before = CloudBefore()

    def take(self, settings: InForce[CodecSettings]) -> bool:
        """Takes settings; no frame needs a key message for them."""
        self._settings = settings
        return False

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """All sections of a frame. With `FOLLOWING` they refer to the frame before, if that was coded as a whole."""
        before, own = self._before, self._settings.own
        remembers = isinstance(own, ReferringSettings) and own.memory
        needs = None if before is None else before.begin(alone=key or not remembers)
        if frame.sensor.is_cloud:
            return Coded(self._cloud(frame, _rest_of(frame)) + position_sections(frame) + pose_sections(frame), None)
        found = layout_of(frame)
        images = [] if found is None else [Section(SectionType.PLANES, self._planes(frame, found[1]))]
        sections = frame_sections(frame, images)
        if before is not None:
            before.take(frame.index)
        return Coded(sections, needs)

    def _cloud(self, frame: Frame, rest: PacketRest) -> list[Section]:
        """The message of a frame of a point cloud. Its REST section has nothing but the host time."""
        cloud = encode_cloud(payload_of(frame), self._kind, self._settings.stream.max_error_m, self._cloud_before)
        without = PacketRest("", rest.packet_ns, np.zeros(0, np.uint16), ())
        return [Section(SectionType.REST, encode_rest(without)), Section(SectionType.CLOUD, cloud)]

    def _planes(self, frame: Frame, layout: PacketLayout) -> bytes:
        stream = self._settings.stream
        step = 1 if stream.max_error_m is None else step_of(stream.max_error_m, frame.sensor.range_step_m)
        sent = sent_planes(frame, layout, AttributeQuality.of(stream))
        reduced = frame.keep is not None
        shift, azimuth = shift_of(frame), sent_azimuth(frame)
        following = None if self._before is None else self._before.following(frame, azimuth)
        return encode_plane_section(
            self._kind, sent.forms, sent.planes, shift, step, sent.tables, reduced=reduced, following=following
        )


class Sent(NamedTuple):
    """The planes of a frame that are sent, in the columns that are sent; tables: as of `attribute_values.reduced`."""

    forms: tuple[Plane, ...]
    planes: Mapping[str, Unsigned]
    tables: Mapping[str, Unsigned]


def sent_planes(frame: Frame, layout: PacketLayout, quality: AttributeQuality) -> Sent:
    """What of a frame is sent with attributes of that quality, ranges unquantised."""
    forms = tuple(one for one in layout.planes if one.role != "attribute" or not quality.off)
    planes: Mapping[str, Unsigned] = images_of(frame, layout).planes
    if frame.lattice is not None:
        planes = {name: np.ascontiguousarray(image[:, frame.lattice]) for name, image in planes.items()}
    if quality.off or quality.lossless:
        return Sent(forms, planes, {})
    few = reduced(forms, planes, quality)
    return Sent(forms, few.planes, few.tables)


def sent_azimuth(frame: Frame) -> npt.NDArray[np.uint16]:
    """(W,) hundredths of a degree, of the columns that are sent."""
    azimuth: npt.NDArray[np.uint16] = frame.azimuth[0]
    return azimuth if frame.lattice is None else azimuth[frame.lattice]


def shift_of(frame: Frame) -> npt.NDArray[np.int32]:
    """(H,) columns by which the rows of a frame must be moved so that neighbours look in one direction."""
    rotation = frame.sensor.calibration["rot_correction_rad"][frame.sensor.laser_of_ring]
    azimuth = sent_azimuth(frame).astype(np.int64)
    steps = np.diff(azimuth) % 36000
    step = float(np.median(steps)) if len(steps) else 0.0
    if not 0 < step < 3600:
        return np.zeros(len(rotation), np.int32)
    columns = np.rint(-np.degrees(rotation) * 100.0 / step)
    shift: npt.NDArray[np.int32] = np.clip(columns - np.rint(np.median(columns)), -4096, 4096).astype(np.int32)
    return shift
