"""What the monitor is told on the command line."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from zones import Rules, Zone

from lidarcodec.errors import SettingsError
from lidarcodec.settings import valid_name
from lidarcodec.transport.keys import StreamKeys


def seconds(text: str) -> float:
    """A time, or metres: a number from 0 to a million."""
    value = float(text)
    if not 0.0 <= value <= 1e6:
        raise ValueError
    return value


def stream(text: str) -> str:
    """VEHICLE/SENSOR."""
    try:
        keys = StreamKeys.parse(text)
    except SettingsError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return f"{keys.vehicle}/{keys.sensor}"


def name(text: str) -> str:
    """What may stand in a key."""
    try:
        return valid_name(text, "name")
    except SettingsError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def zone_of(text: str, rules: Rules) -> Zone:
    """A zone written as NAME=x,y x,y x,y. Raises ArgumentTypeError."""
    title, _, corners = text.partition("=")
    try:
        polygon = [[float(part) for part in corner.split(",")] for corner in corners.split()]
        return Zone(title.strip(), polygon, rules)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"zone '{text}': write NAME=x,y x,y x,y ({error})") from None


def options(about: str | None) -> tuple[argparse.Namespace, list[Zone]]:
    """What was given, and the zones that it names; what cannot be ends the program with a sentence."""
    parser = argparse.ArgumentParser("v2x_monitor", None, about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", nargs="+", type=stream, metavar="VEHICLE/SENSOR")
    parser.add_argument(
        "--zone", action="append", required=True, metavar="NAME=x,y x,y x,y", help="in metres; repeatable"
    )
    parser.add_argument("--stand", type=seconds, default=2.0, help="seconds after which something stands")
    parser.add_argument("--clear", type=seconds, default=0.8, help="seconds seen free after which it no longer does")
    parser.add_argument(
        "--lowest", type=seconds, default=0.3, help="metres over the ground from which on something counts"
    )
    parser.add_argument("--connect", action="append", help="Zenoh endpoint; without one, this machine only")
    parser.add_argument("--name", type=name, default="monitor", help="of lidarcodec/v2x/NAME/alert and .../state")
    parser.add_argument("--out", type=Path, help="MCAP file for alerts, state, and the points in zones")
    parser.add_argument("--seconds", type=seconds, default=math.inf, help="default: until a signal comes")
    given = parser.parse_args()
    for one in given.streams:
        if given.streams.count(one) > 1:
            parser.error(f"{one} is named twice")
    rules = Rules(stand=max(2, round(10 * given.stand)), clear=max(1, round(10 * given.clear)), lowest_m=given.lowest)
    try:
        zones = [zone_of(one, rules) for one in given.zone]
    except argparse.ArgumentTypeError as error:
        parser.error(str(error))
    titles = [zone.name for zone in zones]
    for title in titles:
        if titles.count(title) > 1:
            parser.error(f"two zones have the name {title}")
    return given, zones
