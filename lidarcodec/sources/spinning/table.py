"""The simulated sensors: what the detector of each can do. Layouts, beams and firing times are those of its model.

>>> unit_of(Wanted("vlp16"), seed=1, start_ns=0).layout.name
'single'
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple, cast

from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.sensors.models.hesai_packet import HesaiSensor
from lidarcodec.sensors.models.ouster.fields import PIXELS
from lidarcodec.sensors.models.table import OUSTERS, block_models, sensor_named
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from lidarcodec.sources.spinning.base import Unit
from lidarcodec.sources.spinning.blocks import BlockUnit
from lidarcodec.sources.spinning.ouster import MODES, OusterUnit, metadata_of

Traits = Mapping[str, float]
RETURNS: Final = ("single", "dual")
PROFILE: Final = "RNG19_RFL8_SIG16_NIR16"
"""Of an Ouster, if none is named: that of its firmware."""
MODE: Final = "1024x10"

NOMINAL: Final = {"farthest_m": 100, "sees_10_m": 50, "sigma_m": 0.010}
VELODYNE: Final = {
    **NOMINAL,
    **{"nearest_m": 0.5, "spread": 0.0007, "aperture_m": 0.08, "reflectivity_noise": 0.05, "quiet": 2.0},
}
PUCK: Final = {
    **VELODYNE,
    **{"sees_10_m": 45, "sigma_m": 0.0095, "reflectivity": 90, "diffuse_most": 100, "contrast": 0.8, "grazing": 0.1},
    **{"reflectivity_noise": 0.12, "reflectivity_floor": 0},
}
"""Reflectivity by two captures: of a VLP-16 in a room and of one on a road."""
HESAI: Final = {**NOMINAL, "nearest_m": 0.3, "spread": 0.0007, "aperture_m": 0.05, "reflectivity_noise": 0.06}
PANDAR: Final = {
    **HESAI,
    **{"farthest_m": 200, "sees_10_m": 120, "sigma_m": 0.0105, "aperture_m": 0.04},
    **{"reflectivity": 80, "reflectivity_from_m": 1.5},
}
"""By the captures of a Pandar40P and a Pandar64: both send reflectivity 0 for nearly everything nearer than 1.5 m."""
XT: Final = {**HESAI, "nearest_m": 0.05, "sees_10_m": 80, "sigma_m": 0.005, "aperture_m": 0.09}
QT: Final = {**HESAI, "nearest_m": 0.1, "pulse_m": 0.7, "aperture_m": 0.15, "reflectivity_noise": 0.08}
OUSTER: Final = {"nearest_m": 0.5, "pulse_m": 3.0, "spread": 0.0004, "aperture_m": 0.002, "dark_noise": 0.6}
TRAITS: Final[Mapping[str, Traits]] = {
    "vlp16": PUCK,
    "puck_hires": PUCK,
    "hdl32e": {**VELODYNE, "farthest_m": 100, "sees_10_m": 45, "sigma_m": 0.010, "reflectivity": 45},
    "vlp32c": {**VELODYNE, "farthest_m": 200, "sees_10_m": 80, "sigma_m": 0.006, "aperture_m": 0.05},
    "vls128": {**VELODYNE, "farthest_m": 245, "sees_10_m": 110, "sigma_m": 0.010},
    "pandar40p": PANDAR,
    "pandar64": PANDAR,
    "qt64": {**QT, "farthest_m": 60, "sees_10_m": 20, "sigma_m": 0.010},
    "qt128": {**QT, "farthest_m": 50, "sees_10_m": 20, "sigma_m": 0.010},
    "xt16": {**XT, "farthest_m": 120},
    "xt32": {**XT, "farthest_m": 120},
    "xt32m": {**XT, "nearest_m": 0.5, "farthest_m": 300},
    "os0": {
        **OUSTER,
        **{"nearest_m": 0.3, "farthest_m": 120, "sees_10_m": 35, "sigma_m": 0.008, "photons": 9e3, "dark": 4},
    },
    "os1": {**OUSTER, "farthest_m": 240, "sees_10_m": 90, "sigma_m": 0.016, "photons": 6e4, "dark": 4},
    "os2": {
        **OUSTER,
        **{"farthest_m": 300, "sees_10_m": 120, "sigma_m": 0.025, "reflectivity": 150, "photons": 2.4e5, "dark": 5},
    },
}
"""Model -> the traits that differ from those in native/src/simulator/detector.hpp, where each is explained. An Ouster
is named without its rows. A Velodyne or Hesai without a line has the traits of its maker."""
AMBIENT: Final = {
    "os0": {"daylight": 1800, "sky": 700, "light_noise": 1.0},
    "os1": {"daylight": 1400, "sky": 600, "light_noise": 1.5},
    "os2": {"daylight": 1200, "sky": 500, "light_noise": 1.5},
}
"""Near infrared of each family, in counts."""
STRONGEST_AND_SECOND, LAST_AND_STRONGEST = 1, 2
"""Kinds of two returns in native/src/simulator/detector.hpp."""
NEAR_IR_8_STEP: Final = 16
"""Counts of a step of a near infrared of 8 bits."""


class Wanted(NamedTuple):
    """A sensor as an option of a source names it. profile and mode: of an Ouster; returns: of the others."""

    sensor: str
    profile: str | None = None
    mode: str | None = None
    returns: str | None = None


def names() -> tuple[str, ...]:
    """All sensors that can be simulated, beside the HDL-64E."""
    ousters = (name for name in OUSTERS if name.partition("-")[0] in TRAITS and not name.endswith("-16"))
    return (*block_models(), *ousters)


def unit_of(wanted: Wanted, seed: int, start_ns: int) -> Unit:
    """The simulated unit. seed: where its head starts; start_ns: of the drive, ns since the Unix epoch.

    Raises UnknownNameError for an unknown sensor, profile, mode or kind of returns, SourceError for an option that the
    sensor does not have.
    """
    if wanted.sensor not in names():
        raise UnknownNameError("simulated sensor", wanted.sensor, ("hdl64e", *names()))
    if wanted.sensor in OUSTERS:
        if wanted.returns is not None:
            raise SourceError(
                f"the profile of an {wanted.sensor} says which returns it sends: write profile=... instead of returns="
            )
        profile, mode = (wanted.profile or PROFILE).upper(), wanted.mode or MODE
        if profile not in PIXELS:
            raise UnknownNameError("profile", profile, tuple(PIXELS))
        if mode not in MODES:
            raise UnknownNameError("mode", mode, MODES)
        family, _, rows = wanted.sensor.removeprefix("os").partition("-")
        return OusterUnit(metadata_of(family, int(rows), profile, mode), start_ns)
    if wanted.profile is not None or wanted.mode is not None:
        raise SourceError(f"profile and mode are only for Ousters: leave them out for a {wanted.sensor}")
    returns = wanted.returns or RETURNS[0]
    if returns not in RETURNS:
        raise UnknownNameError("kind of returns", returns, RETURNS)
    sensor = cast(VelodyneSensor | HesaiSensor, sensor_named(wanted.sensor))
    layout = sensor.named_layout(returns)
    assert layout is not None
    return BlockUnit(sensor, layout, seed, start_ns)


def detector_of(unit: Unit) -> dict[str, float]:
    """The traits of a unit's detector, in the units of its planes."""
    family = unit.model.model.partition("-")[0]
    planes = {plane.name: plane for plane in unit.layout.planes}
    maker = HESAI if isinstance(unit.sensor, HesaiSensor) else VELODYNE
    traits = {**TRAITS.get(family, maker), "step_m": unit.model.range_step_m}
    farthest_m = ((1 << planes["range"].bits) - 1) * unit.model.range_step_m
    traits["farthest_m"] = min(traits["farthest_m"], farthest_m)
    if "range2" in planes:
        traits["returns"] = STRONGEST_AND_SECOND if family in AMBIENT else LAST_AND_STRONGEST
    if "near_ir" in planes:
        traits |= AMBIENT[family]
        if planes["near_ir"].bits == 8:
            traits |= {"light_step": NEAR_IR_8_STEP, "light_most": 255}
    return traits
