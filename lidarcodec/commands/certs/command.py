"""`lidarcodec certs`: a certificate authority, and a Zenoh configuration for every machine and person of a deployment.

`deployment.json` lists all parties. Parties on the command line get a new certificate or password. The files of parties
that accept connections contain the access rules, so they are written each time.
"""

from __future__ import annotations

import base64
import ipaddress
import json
import re
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lidarcodec.budgets import FileTooLargeError, largest, read_file
from lidarcodec.commands.certs.certificates import Authority, write_private
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SettingsError, sentence_of
from lidarcodec.files.folder_lock import locked
from lidarcodec.files.whole import written_whole
from lidarcodec.settings import valid_name
from lidarcodec.transport.access import PLAYBACKS, ROUTER, Auth, People
from lidarcodec.transport.secured import Identity, Network, Role, accepting, connecting, nested
from lidarcodec.untrusted.json import JsonRefusedError, read_object

STATE = "deployment.json"
USERS = "users.txt"
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


class Party(BaseModel):
    """A vehicle, viewer or operator.

    hosts:   addresses of a vehicle that listens itself
    until:   end of its newest certificate;  longest: latest end of all its certificates
    """

    model_config = ConfigDict(extra="forbid")

    role: Literal["vehicle", "viewer", "operator"]
    hosts: list[str] = []
    until: str | None = None
    longest: str | None = None


class Deployment(BaseModel):
    """Contents of `deployment.json`."""

    model_config = ConfigDict(extra="forbid")

    auth: Auth
    port: int = Field(ge=1, le=65535)
    installed: str | None = None
    routers: list[str] = []
    parties: dict[str, Party] = {}
    removed: dict[str, str] = {}
    """Removed names with a certificate that was still valid, and its end. Access depends on the name alone, so such
    a name cannot be used again before."""

    def names(self, role: str) -> tuple[str, ...]:
        """Names of the parties with a role."""
        return tuple(sorted(name for name, party in self.parties.items() if party.role == role))

    @property
    def people(self) -> People:
        """Names of all parties by role."""
        return People(self.names("vehicle"), self.names("viewer"), self.names("operator"))


def run(
    folder: Path,
    *,
    routers: Sequence[str] = (),
    vehicles: Sequence[str] = (),
    viewers: Sequence[str] = (),
    operators: Sequence[str] = (),
    remove: Sequence[str] = (),
    auth: str | None = None,
    port: int | None = None,
    days: int,
    installed: Path | None = None,
    as_json: bool = False,
) -> None:
    """Make or extend a deployment, and print the files written. Only one call at a time changes a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        people = {"vehicle": list(vehicles), "viewer": list(viewers), "operator": list(operators)}
        written, notes = _change(folder, list(routers), people, list(remove), auth, port, days, installed)
    paths = [str(folder / name) for name in written]
    tell({"folder": str(folder), "written": paths, "notes": notes}, "\n".join([*paths, *notes]), as_json)


def _change(
    folder: Path,
    routers: list[str],
    people: dict[str, list[str]],
    remove: list[str],
    auth: str | None,
    port: int | None,
    days: int,
    installed: Path | None,
) -> tuple[list[str], list[str]]:
    """Returns the names of the files written, and notes for the user, a sentence each."""
    deployment = _read(folder / STATE, auth, port)
    ours = _files(deployment)
    named = _join(deployment, routers, people)
    gone = _take_out(deployment, named, remove, folder / STATE)
    _check(deployment)
    for name in sorted(_files(deployment) - ours):
        if (folder / name).exists():
            raise SettingsError(f"{folder / name} exists but does not belong to this deployment: move it away first")
    if installed is not None:
        deployment.installed = str(installed)
    maker = _Maker(folder, deployment, days)
    older = _note_ends(deployment, named, days)
    # Saved first, so that every party with a certificate is in the list even if this process is killed.
    _save(folder / STATE, deployment.model_copy(update={"parties": gone | deployment.parties}))
    written = maker.write(named)
    gone_files = {file_of(party.role, name) for name, party in gone.items()}
    for old in gone_files - maker.expected():
        (folder / old).unlink(missing_ok=True)
    _save(folder / STATE, deployment)
    notes: list[str] = []
    for left in sorted({path.name for path in folder.glob("*-*.json5")} - maker.expected() - gone_files):
        notes.append(f"{folder / left} does not belong to this deployment and was left unchanged")
    for name, until in sorted(older.items()):
        notes.append(
            f"an older certificate of {name} stays valid until {until[:10]}: if somebody else has it, "
            f"use --remove {name} and choose another name"
        )
    return list(written), notes + _validity(deployment)


def _take_out(deployment: Deployment, named: set[str], remove: list[str], path: Path) -> dict[str, Party]:
    """Remove names from a deployment. It remembers them while their certificates are valid.

    Raises SettingsError for an unknown name, a name that is also given to be renewed, or a new party with a removed
    name whose certificate is still valid.
    """
    now = datetime.now(UTC)
    deployment.removed = {name: end for name, end in deployment.removed.items() if datetime.fromisoformat(end) > now}
    for name in sorted(named & deployment.removed.keys()):
        role, end = deployment.parties[name].role, deployment.removed[name]
        raise SettingsError(
            f"--{role} {name}: this name was removed, and its old certificate is valid until {end[:10]}: "
            "give another name",
            role,
        )
    gone: dict[str, Party] = {}
    for name in remove:
        if name not in deployment.parties:
            raise SettingsError(f"--remove {name}: {path} has no such name", "remove")
        if name in named:
            raise SettingsError(f"--remove {name}: another option renews this name: use only one of them", "remove")
        party = gone[name] = deployment.parties.pop(name)
        last = party.longest
        if last is not None and datetime.fromisoformat(last) > now:
            deployment.removed[name] = last
    return gone


def _note_ends(deployment: Deployment, named: set[str], days: int) -> dict[str, str]:
    """Note the end of the new certificates before they are made.

    Returns the names in `named` that have an older certificate that is still valid, and its end.
    """
    now = datetime.now(UTC)
    end = (now + timedelta(days=days, seconds=60)).isoformat(timespec="seconds")
    older: dict[str, str] = {}
    for name, party in deployment.parties.items():
        if not party.hosts and (name not in named or deployment.auth != "certificate"):
            continue
        before = party.longest
        if before is not None and datetime.fromisoformat(before) > now and name in named:
            older[name] = before
        party.longest = max(before or end, end, key=datetime.fromisoformat)
    return older


def _read(path: Path, auth: str | None, port: int | None) -> Deployment:
    """The deployment in a file, or a new one."""
    if auth not in (None, "certificate", "password", "none"):
        raise SettingsError(f"--auth must be certificate, password or none, not '{auth}'", "auth")
    try:
        found = Deployment.model_validate(read_object(read_file(path, "certificates"), largest("certificates") or 0))
    except FileNotFoundError:
        return Deployment(auth=cast(Auth, auth or "certificate"), port=port or 7447)
    except (FileTooLargeError, JsonRefusedError) as error:
        raise SettingsError(f"{path} does not describe a deployment: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        raise SettingsError(f"{path}: {sentence_of('.'.join(map(str, first['loc'])), first)}") from None
    if auth not in (None, found.auth) or port not in (None, found.port):
        raise SettingsError(
            f"{path} has auth {found.auth} and port {found.port}, which cannot be changed: use another folder"
        )
    return found


def _join(deployment: Deployment, routers: list[str], people: dict[str, list[str]]) -> set[str]:
    """Add the parties on the command line; returns their names."""
    for host in map(_host, routers):
        if host not in deployment.routers:
            deployment.routers.append(host)
    named: set[str] = set()
    for role, given in people.items():
        for text in given:
            name, at, hosts = text.partition("@")
            valid_name(name, role)
            if name.startswith(PLAYBACKS):
                raise SettingsError(
                    f"--{role} {name}: names that begin with {PLAYBACKS} are reserved for playbacks", role
                )
            before = deployment.parties.get(name)
            if name == ROUTER or name in named or (before is not None and before.role != role):
                raise SettingsError(
                    f"--{role} {name}: this name is already used: each name belongs to one party with one role", role
                )
            named.add(name)
            at_hosts = [_host(host) for host in hosts.split(",")] if at else (before.hosts if before else [])
            if at_hosts and role != "vehicle":
                raise SettingsError(f"--{role} {text}: only a vehicle can have a host, so leave out @HOST", role)
            kept = before or Party(role=cast(Literal["vehicle"], role))
            deployment.parties[name] = kept.model_copy(update={"hosts": at_hosts})
    return named


def _host(text: str) -> str:
    try:
        address = ipaddress.ip_address(text)
        if address.version == 6:
            raise SettingsError(
                f"{text}: Zenoh does not check certificates of IPv6 addresses, so nobody could connect: give a name "
                "that stands for it"
            )
        return str(address)
    except ValueError:
        if not _HOST.fullmatch(text):
            raise SettingsError(f"'{text}' is not a host: write a name or an IP address") from None
        return text


def _check(deployment: Deployment) -> None:
    lonely = [name for name in deployment.names("vehicle") if not deployment.parties[name].hosts]
    if not deployment.routers and (lonely or not deployment.parties):
        raise SettingsError(
            "there is nothing to connect to: give --router HOST, or a host for each vehicle (--vehicle NAME@HOST)",
            "router",
        )
    listening = [name for name, party in deployment.parties.items() if party.hosts]
    if deployment.routers and listening:
        raise SettingsError(
            f"vehicle {listening[0]} connects to the routers: leave out the host after its name", "vehicle"
        )


def _save(path: Path, deployment: Deployment) -> None:
    with written_whole(path) as beside:
        beside.write_text(json.dumps(deployment.model_dump(), indent=2) + "\n")


def _validity(deployment: Deployment) -> list[str]:
    """Certificates that end soon, a sentence each."""
    notes = []
    ends = {name: party.until for name, party in deployment.parties.items() if party.until}
    now, soon = datetime.now(UTC), datetime.now(UTC) + timedelta(days=30)
    for name, until in sorted(ends.items()):
        if datetime.fromisoformat(until) < soon:
            state = "has expired" if datetime.fromisoformat(until) < now else f"is valid until {until[:10]}"
            notes.append(f"the certificate of {name} {state}: give its name again to renew it")
    return notes


def _files(deployment: Deployment) -> set[str]:
    """Names of the files that belong to a deployment."""
    people = {file_of(party.role, name) for name, party in deployment.parties.items()}
    return people | {file_of("router", host) for host in deployment.routers}


class _Maker:
    """Writes the files of a deployment."""

    def __init__(self, folder: Path, deployment: Deployment, days: int) -> None:
        self._folder, self._deployment, self._days = folder, deployment, days
        self._installed = Path(deployment.installed or folder.resolve())
        self._authority = Authority.open(folder)
        self._ca = _base64(self._authority.pem)
        self._passwords = self._read_users()

    def expected(self) -> set[str]:
        """Files that belong to the deployment."""
        return _files(self._deployment)

    def write(self, named: set[str]) -> list[str]:
        """Write the files of all parties that listen, and of those in `named`; returns the names of the files."""
        deployment = self._deployment
        for name in named | ({ROUTER} if deployment.routers else set()):
            if deployment.auth == "password" and (name != ROUTER or ROUTER not in self._passwords):
                self._passwords[name] = secrets.token_urlsafe(24)
        written = []
        for number, host in enumerate(deployment.routers):
            onward = () if number == 0 else (self._endpoint(deployment.routers[0]),)
            written.append(self._accepting("router", ROUTER, host, (host,), onward))
        for name, party in sorted(deployment.parties.items()):
            if party.hosts:
                written.append(self._accepting("vehicle", name, name, tuple(party.hosts), ()))
            elif name in named:
                written.append(self._connecting(party.role, name))
        if deployment.auth == "password":
            lines = [f"{name}:{password}" for name, password in sorted(self._passwords.items())]
            write_private(self._folder / USERS, ("\n".join(lines) + "\n").encode())
            written.append(USERS)
        return written

    def _accepting(self, role: Role, name: str, called: str, hosts: tuple[str, ...], onward: tuple[str, ...]) -> str:
        identity = self._identity(role, name, (*hosts, "localhost", "127.0.0.1"), listens=True)
        options = accepting(identity, self._network(), self._deployment.people, onward)
        return self._put(file_of(role, called), options)

    def _connecting(self, role: Role, name: str) -> str:
        identity = self._identity(role, name, (), listens=False)
        deployment = self._deployment
        options = connecting(identity, self._network(), deployment.people, routed=bool(deployment.routers))
        return self._put(file_of(role, name), options)

    def _identity(self, role: Role, name: str, hosts: tuple[str, ...], *, listens: bool) -> Identity:
        certificate = key = None
        if listens or self._deployment.auth == "certificate":
            issued = self._authority.issue(name, hosts, self._days)
            certificate, key = _base64(issued.certificate), _base64(issued.key)
            if name in self._deployment.parties:
                self._deployment.parties[name].until = issued.until.isoformat(timespec="seconds")
        return Identity(role, name, self._ca, certificate, key, self._passwords.get(name))

    def _network(self) -> Network:
        deployment = self._deployment
        hosts = deployment.routers or [host for party in deployment.parties.values() for host in party.hosts[:1]]
        users = str(self._installed / USERS) if deployment.auth == "password" else None
        listen = f"tls/[::]:{deployment.port}"
        return Network(deployment.auth, listen, tuple(map(self._endpoint, hosts)), users)

    def _endpoint(self, host: str) -> str:
        return f"tls/{f'[{host}]' if ':' in host else host}:{self._deployment.port}"

    def _put(self, name: str, options: dict[str, object]) -> str:
        about = "// Contains a private key or a password: copy it only to its own machine.\n"
        text = about + json.dumps(nested(options), indent=2) + "\n"
        write_private(self._folder / name, text.encode())
        return name

    def _read_users(self) -> dict[str, str]:
        """Passwords of the parties in the deployment."""
        try:
            lines = read_file(self._folder / USERS, "certificates").decode().splitlines()
        except FileNotFoundError:
            return {}
        except (OSError, UnicodeDecodeError, FileTooLargeError) as error:
            raise SettingsError(f"cannot read the passwords in {self._folder / USERS}: {error}") from None
        pairs = (line.partition(":")[::2] for line in lines if ":" in line)
        return {name: password for name, password in pairs if name == ROUTER or name in self._deployment.parties}


def file_of(role: str, name: str) -> str:
    """Name of a party's file."""
    return f"{role}-{name.replace(':', '_')}.json5"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
