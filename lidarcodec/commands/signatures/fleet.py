"""Commands for a fleet: test load (swarm), certificates, the server, and health checks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.about import Health
from lidarcodec.commands.results.fleet import Certified
from lidarcodec.commands.results.live import Serving, Swarmed
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AsJson,
    CodecName,
    Connect,
    DatabasePassword,
    Listen,
    Pairs,
    ZenohConfig,
)


@prints(Swarmed)
def swarm(
    count: Annotated[int, typer.Argument(metavar="N", min=1, max=1000, show_default=False)],
    source: Annotated[str, typer.Argument(metavar="SOURCE")] = "sim:city",
    vehicle_prefix: Annotated[
        str, Option("--vehicle-prefix", metavar="NAME", help="Vehicles are named NAME-001, NAME-002 and so on.")
    ] = "car",
    codec: CodecName = None,
    pairs: Pairs = None,
    rate: Annotated[float, Option("--rate", min=0.01, max=1000.0, metavar="HZ", help="Frames a second.")] = 10.0,
    frames: Annotated[
        int, Option("--frames", min=1, max=1000, metavar="N", help="Use N frames of SOURCE and repeat them.")
    ] = 50,
    shared: Annotated[
        bool,
        Option(
            "--shared",
            help="Encode each frame once and send it for all vehicles. This loads receivers more than this machine.",
        ),
    ] = False,
    processes: Annotated[
        int | None,
        Option("--processes", min=1, max=64, metavar="N", help="Number of processes. Default: one for each processor."),
    ] = None,
    seconds: Annotated[
        float | None, Option("--seconds", min=0.1, metavar="N", help="Duration. Default: until Ctrl-C.")
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    first: Annotated[int, Option("--first", min=0, max=10**6, metavar="N", help="Number of the first vehicle.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Publish N vehicles at once, to test a network, a router or a server under load."""
    from lidarcodec.commands import swarm as command

    keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    load = command.Load(count, source, vehicle_prefix, codec, pairs or [], rate, frames, shared, seconds, given, first)
    command.run(load, processes, as_json)


@prints(Certified)
def certs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", show_default=False)],
    router: Annotated[
        list[str] | None, Option("--router", metavar="HOST", help="Host of a Zenoh router. Repeatable.")
    ] = None,
    vehicle: Annotated[
        list[str] | None,
        Option("--vehicle", metavar="NAME[@HOST]", help="A vehicle. It may only publish its own streams. Repeatable."),
    ] = None,
    viewer: Annotated[
        list[str] | None, Option("--viewer", metavar="NAME", help="A viewer. It may receive. Repeatable.")
    ] = None,
    operator: Annotated[
        list[str] | None,
        Option("--operator", metavar="NAME", help="An operator. It may receive and change settings. Repeatable."),
    ] = None,
    remove: Annotated[
        list[str] | None, Option("--remove", metavar="NAME", help="Remove all access of this name. Repeatable.")
    ] = None,
    auth: Annotated[
        str | None,
        Option("--auth", metavar="certificate|password|none", help="How clients prove their identity."),
    ] = None,
    port: Annotated[
        int | None, Option("--port", min=1, max=65535, help="Port of the routers and vehicles. Default: 7447.")
    ] = None,
    days: Annotated[int, Option("--days", min=1, max=3650, help="Days for which certificates are valid.")] = 365,
    installed: Annotated[
        Path | None, Option("--installed", metavar="DIR", help="Folder on the router that will hold users.txt.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Create or extend a secured deployment: an authority, and a Zenoh configuration for each machine and person."""
    from lidarcodec.commands.certs import command

    command.run(
        folder, routers=router or [], vehicles=vehicle or [], viewers=viewer or [], operators=operator or [],
        remove=remove or [], auth=auth, port=port, days=days, installed=installed, as_json=as_json,
    )  # fmt: skip


@prints(Serving)
def serve(
    host: Annotated[str | None, Option("--host", metavar="H", help="Address to listen on. Default: 127.0.0.1.")] = None,
    port: Annotated[
        int | None, Option("--port", min=0, max=65535, metavar="P", help="Port to listen on. Default: 8080.")
    ] = None,
    database_url: Annotated[
        str | None,
        Option(
            "--database-url",
            metavar="URL",
            help="Database of the server. Default: an SQLite file in the user's state folder.",
        ),
    ] = None,
    database_password_file: DatabasePassword = None,
    tls_certificate: Annotated[
        Path | None, Option("--tls-certificate", metavar="FILE", help="Serve HTTPS with this certificate.")
    ] = None,
    tls_key: Annotated[
        Path | None, Option("--tls-key", metavar="FILE", help="Private key of --tls-certificate.")
    ] = None,
    insecure: Annotated[
        bool, Option("--insecure", help="Listen for other machines although there is no token.")
    ] = False,
    open_again: Annotated[
        bool,
        Option("--open", help="Allow access without a token again, after all tokens were revoked."),
    ] = False,
    metrics_open: Annotated[bool, Option("--metrics-open", help="Answer /metrics without a token.")] = False,
    max_streams: Annotated[
        int | None, Option("--max-streams", min=1, metavar="N", help="Largest number of streams. Default: 256.")
    ] = None,
    max_sensors: Annotated[
        int | None,
        Option("--max-sensors", min=1, metavar="N", help="Largest number of streams of one vehicle. Default: 16."),
    ] = None,
    max_viewers: Annotated[
        int | None, Option("--max-viewers", min=1, metavar="N", help="Largest number of live sockets. Default: 64.")
    ] = None,
    max_viewers_a_client: Annotated[
        int | None,
        Option(
            "--max-viewers-a-client",
            min=1,
            metavar="N",
            help="Largest number of live sockets of one client (token or address). Default: 32.",
        ),
    ] = None,
    max_viewers_a_host: Annotated[
        int | None,
        Option(
            "--max-viewers-a-host",
            min=1,
            metavar="N",
            help="Largest number of live sockets of one address. Default: 48.",
        ),
    ] = None,
    max_connections: Annotated[
        int | None,
        Option("--max-connections", min=1, metavar="N", help="Largest number of connections. Default: 1000."),
    ] = None,
    max_connections_a_host: Annotated[
        int | None,
        Option(
            "--max-connections-a-host",
            min=1,
            metavar="N",
            help="Largest number of connections of one host. Default: 200.",
        ),
    ] = None,
    reserved_connections: Annotated[
        int | None,
        Option(
            "--reserved-connections",
            min=1,
            metavar="N",
            help="Additional connections for health checks and operators. Default: 16.",
        ),
    ] = None,
    max_requests_a_host: Annotated[
        int | None,
        Option(
            "--max-requests-a-host",
            min=1,
            metavar="N",
            help="Largest number of simultaneous requests of one host. Default: 16.",
        ),
    ] = None,
    proxy: Annotated[
        list[str] | None,
        Option(
            "--proxy",
            metavar="ADDRESS",
            help="Address of a reverse proxy. Limits of one host do not apply to it. Repeatable.",
        ),
    ] = None,
    request_seconds: Annotated[
        float | None,
        Option(
            "--request-seconds",
            min=0.1,
            metavar="N",
            help="Time limit for the headers of a request, and for its body. Default: 10.",
        ),
    ] = None,
    keep_alive_seconds: Annotated[
        float | None,
        Option(
            "--keep-alive-seconds",
            min=0.1,
            metavar="N",
            help="Time limit between two requests of a connection. Default: 5.",
        ),
    ] = None,
    read_seconds: Annotated[
        float | None,
        Option("--read-seconds", min=0.1, metavar="N", help="Time limit for a client to read an answer. Default: 30."),
    ] = None,
    recordings: Annotated[
        Path | None,
        Option("--recordings", metavar="DIR", help="Folder for recordings. Default: in the user's state folder."),
    ] = None,
    recordings_gb: Annotated[
        float | None,
        Option(
            "--recordings-gb",
            min=0.001,
            max=1e6,
            metavar="N",
            help="Size limit of the recordings folder in GB. Default: 64.",
        ),
    ] = None,
    past: Annotated[
        Path | None,
        Option(
            "--past", metavar="DIR", help="Folder for clips fetched from vehicles. Default: in the user's state folder."
        ),
    ] = None,
    past_gb: Annotated[
        float | None,
        Option("--past-gb", min=0.001, max=1e6, metavar="N", help="Size limit of that folder in GB. Default: 64."),
    ] = None,
    maps: Annotated[
        Path | None,
        Option("--maps", metavar="DIR", help="Folder of maps (.lcmap) to serve to vehicles and to the page."),
    ] = None,
    archive: Annotated[
        str | None,
        Option(
            "--archive",
            metavar="URL",
            help="Archive to search, download and play: a folder, s3://, gs:// or az:// (extra archive).",
        ),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Run a web server to watch and change the streams of a fleet (extra `server`). Ctrl-C stops it."""
    from lidarcodec.commands import serve as command

    keep_standard_output()
    command.run(
        (connect or [], listen or [], zenoh_config),
        as_json,
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
        past=past, max_past_bytes=None if past_gb is None else int(past_gb * 2**30),
        maps=maps, archive=archive,
    )  # fmt: skip


@prints(Health)
def health(
    health_file: Annotated[
        Path | None, Option("--health-file", metavar="FILE", help="The file of `publish --health-file`.")
    ] = None,
    url: Annotated[
        str | None, Option("--url", metavar="URL", help="Address of a server, for example http://127.0.0.1:8080.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check whether a publisher or a server on this machine works. If not, print what is wrong and exit with 1."""
    from lidarcodec.commands import health as command

    command.run(health_file, url, as_json)


__all__ = ["certs", "health", "serve", "swarm"]
