"""ServerConfig: the options of a server, from the command line or from `LIDARCODEC_` variables.

>>> ServerConfig().host, ServerConfig(host="0.0.0.0").loopback
('127.0.0.1', False)
"""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from lidarcodec.transport import Endpoints


def state_folder() -> Path:
    """Default folder of the server's database: `lidarcodec` in the user's state folder."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "state") / "lidarcodec"


def default_database_url() -> str:
    """An SQLite file in the state folder."""
    return f"sqlite:///{state_folder() / 'server.db'}"


class ServerConfig(BaseModel):
    """Options of a server. Frozen; unknown names are refused.

    host, port:          where to listen for HTTP; by default only for this machine
    database_url:        any SQLAlchemy URL
    endpoints:           where the Zenoh session listens and connects
    tls_certificate:     PEM file to serve HTTPS with, and tls_key its key
    insecure:            listen for other machines although no token is needed
    open:                allow access without a token again, when tokens were needed before and none is valid any more
    metrics_open:        answer `/metrics` without a token
    max_streams:         most streams at once; the server counts further ones and refuses them
    max_sensors:         most streams of one vehicle at once
    max_body_bytes:      longest body of a request
    max_message_bytes:   longest WebSocket message of a client
    max_connections:     most connections of all hosts;  max_connections_a_host: most of one host
    reserved_connections: further connections for health checks and operators, when all others are in use
    max_requests_a_host: requests of one host that are processed at once; others wait
    proxies:             addresses of proxies; the connections of a proxy belong to many clients
    request_s:           longest wait for the first complete request of a connection;  keep_alive_s: for further ones
    read_s:              longest time for which a client may leave an answer unread
    changes_per_second:  changing requests of each client in a second;  burst: how many of them at once
    body_s:              longest time for a client to send a body
    answer_s:            longest time for a vehicle to answer
    audit_rows:          entries kept in the audit log; older ones are deleted
    max_viewers:         most live sockets;  max_viewers_a_client, max_viewers_a_host: most of one client or host
    ack_limit_s:         longest time for a viewer to acknowledge a frame
    recordings:          folder of the server's recordings
    past:                folder of clips that were fetched from vehicles;  max_past_bytes: its largest size
    maps:                folder of maps to serve;  None: there are none
    archive:             folder or address (`s3://...`) of an archive to search and play;  None: there is none
    max_recordings_bytes: largest size of that folder;  max_recording_bytes, max_recording_s: limits of one recording
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    host: str = "127.0.0.1"
    port: int = Field(default=8080, ge=0, le=65535)
    database_url: str = Field(default_factory=default_database_url)
    endpoints: Endpoints = Field(default_factory=Endpoints)
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    insecure: bool = False
    open: bool = False
    metrics_open: bool = False
    max_streams: int = Field(default=256, ge=1, le=10_000)
    max_sensors: int = Field(default=16, ge=1, le=10_000)
    max_body_bytes: int = Field(default=64 * 1024, ge=1024)
    max_message_bytes: int = Field(default=64 * 1024, ge=1024)
    max_connections: int = Field(default=1000, ge=1)
    max_connections_a_host: int = Field(default=200, ge=1)
    reserved_connections: int = Field(default=16, ge=1)
    max_requests_a_host: int = Field(default=16, ge=1)
    proxies: tuple[str, ...] = ()
    request_s: float = Field(default=10.0, gt=0.0)
    keep_alive_s: float = Field(default=5.0, gt=0.0)
    read_s: float = Field(default=30.0, gt=0.0)
    changes_per_second: float = Field(default=10.0, gt=0.0)
    burst: int = Field(default=20, ge=1)
    body_s: float = Field(default=10.0, gt=0.0)
    answer_s: float = Field(default=5.0, gt=0.0)
    audit_rows: int = Field(default=1_000_000, ge=1)
    max_viewers: int = Field(default=64, ge=1)
    max_viewers_a_client: int = Field(default=32, ge=1)
    max_viewers_a_host: int = Field(default=48, ge=1)
    ack_limit_s: float = Field(default=15.0, gt=0.0)
    recordings: Path = Field(default_factory=lambda: state_folder() / "recordings")
    past: Path = Field(default_factory=lambda: state_folder() / "past-clips")
    maps: Path | None = None
    archive: str | None = Field(default=None, min_length=1)
    max_past_bytes: int = Field(default=64 * 2**30, ge=2**20)
    max_recordings_bytes: int = Field(default=64 * 2**30, ge=2**20)
    max_recording_bytes: int = Field(default=4 * 2**30, ge=2**20)
    max_recording_s: float = Field(default=3600.0, gt=0.0)

    @field_validator("proxies")
    @classmethod
    def _addresses(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for one in value:
            try:
                ipaddress.ip_address(one)
            except ValueError:
                raise ValueError(f"'{one}' is not the address of a proxy: write for example 10.0.0.2") from None
        return value

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Whether a host name or address can mean only this machine. Of names only `localhost` can."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower().rstrip(".") == "localhost"


Role = Literal["viewer", "operator"]
