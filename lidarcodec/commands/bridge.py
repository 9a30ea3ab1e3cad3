"""`lidarcodec bridge`: passes live streams to programs without support for lidarcodec."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Protocol

import typer
from typer import Option

from lidarcodec.commands.endpoints import endpoints_of
from lidarcodec.commands.results.live import Bridged
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import prints, tell
from lidarcodec.commands.signatures.common import AsJson, Connect, Listen, ZenohConfig
from lidarcodec.errors import SettingsError
from lidarcodec.units import is_number

app = typer.Typer(help="Pass live streams on to ROS 2 or Foxglove.", no_args_is_help=True, rich_markup_mode=None)

EVERY_S = 1.0
DOMAIN_VARIABLE = "ROS_DOMAIN_ID"

StreamNames = Annotated[list[str], typer.Argument(metavar="VEHICLE/SENSOR...", show_default=False)]
UntilEnd = Annotated[bool, Option("--until-end", help="Stop when all publishers have stopped.")]


class Bridge(Protocol):
    """The interface of both bridges."""

    def __enter__(self) -> Bridge: ...

    def __exit__(self, *exc: object) -> None: ...

    def wait(self, timeout_s: float) -> bool: ...

    def interrupt(self) -> None: ...

    def summary(self) -> dict[str, Any]: ...


@app.command()
@prints(Bridged)
def ros2(
    streams: StreamNames,
    ros_connect: Annotated[
        list[str] | None,
        Option("--ros-connect", metavar="ENDPOINT", help="Address of the ROS 2 router. Default: tcp/127.0.0.1:7447."),
    ] = None,
    ros_config: Annotated[
        Path | None,
        Option("--ros-config", metavar="FILE", help="Zenoh configuration for the ROS 2 side. It is used unchanged."),
    ] = None,
    domain: Annotated[
        int | None,
        Option("--domain", min=0, max=232, metavar="N", help="ROS domain. Default: $ROS_DOMAIN_ID, otherwise 0."),
    ] = None,
    topic: Annotated[
        str | None,
        Option("--topic", metavar="NAME", help="Topic; only for a single stream. Default: /VEHICLE/SENSOR/points."),
    ] = None,
    frame_id: Annotated[
        str | None,
        Option("--frame-id", metavar="NAME", help="frame_id; only for a single stream. Default: VEHICLE/SENSOR."),
    ] = None,
    world: Annotated[
        str, Option("--world", metavar="NAME", help="Name of the frame in which poses are given.")
    ] = "map",
    tf: Annotated[bool, Option("--tf/--no-tf", help="Publish poses on /tf if a stream has them.")] = True,
    fill: Annotated[
        bool,
        Option(
            "--fill/--no-fill",
            help="Interpolate points between the columns that were sent. The field `filled` marks them.",
        ),
    ] = False,
    type_hash: Annotated[bool, Option("--type-hash/--no-type-hash", help="--no-type-hash is for ROS 2 Humble.")] = True,
    until_end: UntilEnd = False,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Publish point clouds to ROS 2 as sensor_msgs/PointCloud2, for RViz and other nodes. ROS 2 must use rmw_zenoh."""
    from lidarcodec.bridges.ros2 import ROUTER, RosBridge, RosNames

    names = RosNames(topic, frame_id, world, tf, _domain(domain), type_hash)
    ros = endpoints_of((ros_connect or ([] if ros_config else [ROUTER]), [], ros_config))
    given = endpoints_of((connect or [], listen or [], zenoh_config))
    bridge = RosBridge(streams, names, endpoints=given, ros=ros, until_end=until_end, fill=fill)
    usual = f"{ROUTER} (`ros2 run rmw_zenoh_cpp rmw_zenohd` starts it)"
    where = ", ".join(ros_connect or ([f"that of {ros_config}"] if ros_config else [usual]))
    sys.stderr.write(f"to ROS 2, domain {names.domain}, router {where}: {', '.join(bridge.topics.values())}\n")
    _run(bridge, as_json)


@app.command()
@prints(Bridged)
def foxglove(
    streams: StreamNames,
    host: Annotated[str, Option("--host", metavar="H", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, Option("--port", min=0, max=65535, metavar="P", help="Port; 0 takes a free port.")] = 8765,
    fill: Annotated[
        bool | None,
        Option(
            "--fill/--no-fill",
            help="Interpolate points between the columns that were sent. The field `filled` marks them. Default: "
            "on, except for streams with the purpose localise or detect.",
        ),
    ] = None,
    max_viewers: Annotated[
        int,
        Option(
            "--max-viewers",
            min=1,
            max=1000,
            metavar="N",
            help="Largest number of viewers. One address can have half of them.",
        ),
    ] = 16,
    allow_origin: Annotated[
        list[str] | None,
        Option(
            "--allow-origin",
            metavar="ORIGIN",
            help="A web page that may connect, as https://HOST. Repeatable. Foxglove's own pages and those of this "
            "machine always may.",
        ),
    ] = None,
    until_end: UntilEnd = False,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Serve point clouds, poses and statistics to Foxglove over a WebSocket, until Ctrl-C is pressed."""
    from lidarcodec.bridges.foxglove import FoxgloveBridge

    given = endpoints_of((connect or [], listen or [], zenoh_config))
    bridge = FoxgloveBridge(
        streams, host=host, port=port, endpoints=given, until_end=until_end, fill=fill, max_viewers=max_viewers,
        origins=allow_origin or (),
    )  # fmt: skip
    _run(bridge, as_json)


def _domain(given: int | None) -> int:
    text = os.environ.get(DOMAIN_VARIABLE, "")
    if given is not None or not text:
        return given or 0
    if not is_number(text, 232):
        raise SettingsError(f"{DOMAIN_VARIABLE} must be a number from 0 to 232, not '{text}'", "domain")
    return int(text)


def _run(bridge: Bridge, as_json: bool) -> None:
    """Run a bridge until a signal arrives or all streams have ended, and print a summary."""
    keep_standard_output()
    show = sys.stderr.isatty()
    with stoppable(bridge.interrupt) as stopped, bridge:
        where = bridge.summary().get("url")
        if where is not None:  # printed at once, because port 0 has become a real port
            sys.stderr.write(f"open in Foxglove: {where}\n")
        shown_s = time.monotonic()
        while not bridge.wait(0.2) and not stopped():
            if show and time.monotonic() - shown_s >= EVERY_S:
                shown_s = time.monotonic()
                sys.stderr.write(f"\r{_line(bridge.summary())}\x1b[K")
        summary = bridge.summary()
    if show:
        sys.stderr.write("\r\x1b[K")
    tell(summary, _line(summary), as_json)


def _line(summary: dict[str, Any]) -> str:
    """The counts of a bridge, in one line."""
    streams = ", ".join(f"{name} {one.get('frames', 0)} frames" for name, one in summary["streams"].items())
    refused = f", {summary['refused']} viewers refused" if summary.get("refused") else ""
    return f"{summary.get('clouds', 0)} clouds, {summary.get('unwatched', 0)} unwatched{refused}; {streams}"
