"""The commands of whoever runs more than one vehicle: a load, certificates, the server, and whether all is well."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.arguments import CodecName, Connect, DatabasePassword, Listen, Pairs, ZenohConfig
from lidarcodec.commands.running import keep_standard_output


def swarm(
    count: Annotated[int, typer.Argument(metavar="N", min=1, max=1000, show_default=False)],
    source: Annotated[str, typer.Argument(metavar="[SOURCE]")] = "sim:city",
    vehicle_prefix: Annotated[
        str, Option("--vehicle-prefix", metavar="NAME", help="Of NAME-001, NAME-002 ...")
    ] = "car",
    codec: CodecName = None,
    pairs: Pairs = None,
    rate: Annotated[float, Option("--rate", min=0.01, max=1000.0, metavar="HZ", help="Frames a second.")] = 10.0,
    frames: Annotated[int, Option("--frames", min=1, max=1000, metavar="N", help="Of SOURCE, over and over.")] = 50,
    shared: Annotated[
        bool, Option("--shared", help="Encode once and send that for all: little load here, all of it there.")
    ] = False,
    processes: Annotated[
        int | None, Option("--processes", min=1, max=64, metavar="N", help="Default: one a processor.")
    ] = None,
    seconds: Annotated[float | None, Option("--seconds", min=0.1, metavar="N", help="Default: until stopped.")] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    first: Annotated[int, Option("--first", min=0, max=10**6, metavar="N", help="Number of the first vehicle.")] = 1,
) -> None:
    """Publish as many vehicles at once, to load a network, a router or a server."""
    from lidarcodec.commands import swarm as command

    keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    load = command.Load(count, source, vehicle_prefix, codec, pairs or [], rate, frames, shared, seconds, given, first)
    command.run(load, processes)


def certs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", show_default=False)],
    router: Annotated[
        list[str] | None, Option("--router", metavar="HOST", help="Where a Zenoh router listens. Repeatable.")
    ] = None,
    vehicle: Annotated[
        list[str] | None,
        Option("--vehicle", metavar="NAME[@HOST]", help="Publishes its own streams only. Repeatable."),
    ] = None,
    viewer: Annotated[list[str] | None, Option("--viewer", metavar="NAME", help="Receives. Repeatable.")] = None,
    operator: Annotated[
        list[str] | None, Option("--operator", metavar="NAME", help="Also changes settings. Repeatable.")
    ] = None,
    remove: Annotated[
        list[str] | None, Option("--remove", metavar="NAME", help="May do nothing any more. Repeatable.")
    ] = None,
    auth: Annotated[
        str | None,
        Option("--auth", metavar="certificate|password|none", help="How those who connect are known."),
    ] = None,
    port: Annotated[int | None, Option("--port", min=1, max=65535, help="Default: 7447.")] = None,
    days: Annotated[int, Option("--days", min=1, max=3650, help="How long certificates are valid.")] = 365,
    installed: Annotated[
        Path | None, Option("--installed", metavar="DIR", help="Where users.txt will lie on the router.")
    ] = None,
) -> None:
    """Make or extend a secured deployment: an authority, and one Zenoh configuration for each machine and person."""
    from lidarcodec.commands import certs as command

    command.run(
        folder, router or [], vehicle or [], viewer or [], operator or [], remove or [], auth, port, days, installed
    )


def serve(
    host: Annotated[str | None, Option("--host", metavar="H", help="Where to listen; default: 127.0.0.1.")] = None,
    port: Annotated[int | None, Option("--port", min=0, max=65535, metavar="P", help="Default: 8080.")] = None,
    database_url: Annotated[
        str | None, Option("--database-url", metavar="URL", help="Default: an SQLite file in the user's state folder.")
    ] = None,
    database_password_file: DatabasePassword = None,
    tls_certificate: Annotated[Path | None, Option("--tls-certificate", metavar="FILE", help="Serve HTTPS.")] = None,
    tls_key: Annotated[Path | None, Option("--tls-key", metavar="FILE", help="The key of --tls-certificate.")] = None,
    insecure: Annotated[
        bool, Option("--insecure", help="Listen beyond this machine although there is no token.")
    ] = False,
    open_again: Annotated[
        bool, Option("--open", help="Let everybody in again, where tokens were needed and none works any more.")
    ] = False,
    metrics_open: Annotated[bool, Option("--metrics-open", help="Answer /metrics without a token.")] = False,
    max_streams: Annotated[int | None, Option("--max-streams", min=1, metavar="N", help="Default: 256.")] = None,
    max_sensors: Annotated[
        int | None, Option("--max-sensors", min=1, metavar="N", help="Streams of one vehicle. Default: 16.")
    ] = None,
    max_viewers: Annotated[
        int | None, Option("--max-viewers", min=1, metavar="N", help="Live sockets at once; default: 64.")
    ] = None,
    max_viewers_a_client: Annotated[
        int | None,
        Option(
            "--max-viewers-a-client", min=1, metavar="N", help="Those of one client (token, or address); default: 32."
        ),
    ] = None,
    max_viewers_a_host: Annotated[
        int | None, Option("--max-viewers-a-host", min=1, metavar="N", help="Those of one address; default: 48.")
    ] = None,
    max_connections: Annotated[
        int | None, Option("--max-connections", min=1, metavar="N", help="Of all hosts at once; default: 1000.")
    ] = None,
    max_connections_a_host: Annotated[
        int | None, Option("--max-connections-a-host", min=1, metavar="N", help="Of one host; default: 200.")
    ] = None,
    reserved_connections: Annotated[
        int | None,
        Option(
            "--reserved-connections", min=1, metavar="N", help="More, for health checks and operators; default: 16."
        ),
    ] = None,
    max_requests_a_host: Annotated[
        int | None,
        Option("--max-requests-a-host", min=1, metavar="N", help="Of one host, worked on at once; default: 16."),
    ] = None,
    proxy: Annotated[
        list[str] | None,
        Option("--proxy", metavar="ADDRESS", help="A reverse proxy, which has no limits of one host. Repeatable."),
    ] = None,
    request_seconds: Annotated[
        float | None,
        Option("--request-seconds", min=0.1, metavar="N", help="For a request's headers, and its body; default: 10."),
    ] = None,
    keep_alive_seconds: Annotated[
        float | None, Option("--keep-alive-seconds", min=0.1, metavar="N", help="Between requests; default: 5.")
    ] = None,
    read_seconds: Annotated[
        float | None,
        Option("--read-seconds", min=0.1, metavar="N", help="How long an answer may stay unread; default: 30."),
    ] = None,
    recordings: Annotated[
        Path | None, Option("--recordings", metavar="DIR", help="Default: in the user's state folder.")
    ] = None,
    recordings_gb: Annotated[
        float | None,
        Option("--recordings-gb", min=0.001, max=1e6, metavar="N", help="Size of that folder; default: 64."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Serve the streams of a fleet over HTTP until a signal comes: look at them, change them (extra `server`)."""
    from lidarcodec.commands import serve as command

    keep_standard_output()
    command.run(
        (connect or [], listen or [], zenoh_config),
        host=host, port=port, database_url=database_url, database_password_file=database_password_file,
        tls_certificate=tls_certificate, tls_key=tls_key,
        insecure=insecure, open=open_again, metrics_open=metrics_open, max_streams=max_streams,
        max_sensors=max_sensors,
        max_viewers=max_viewers, max_viewers_a_client=max_viewers_a_client, max_viewers_a_host=max_viewers_a_host,
        max_connections=max_connections,
        max_connections_a_host=max_connections_a_host, reserved_connections=reserved_connections,
        max_requests_a_host=max_requests_a_host, proxies=tuple(proxy) if proxy else None, request_s=request_seconds,
        body_s=request_seconds,
        keep_alive_s=keep_alive_seconds, read_s=read_seconds, recordings=recordings,
        max_recordings_bytes=None if recordings_gb is None else int(recordings_gb * 2**30),
    )  # fmt: skip


def health(
    health_file: Annotated[
        Path | None, Option("--health-file", metavar="FILE", help="That of `publish --health-file`.")
    ] = None,
    url: Annotated[
        str | None, Option("--url", metavar="URL", help="Of a server, such as http://127.0.0.1:8080.")
    ] = None,
) -> None:
    """Say whether a publisher or a server of this machine is well: exit code 0, or 1 and what is not."""
    from lidarcodec.commands import health as command

    command.run(health_file, url)


__all__ = ["certs", "health", "serve", "swarm"]
