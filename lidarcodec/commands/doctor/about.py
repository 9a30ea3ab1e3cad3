"""Facts about this machine: versions, extras, ports, clock, and the settings in effect."""

from __future__ import annotations

import ctypes
import os
import platform
import re
import socket
import time
from importlib import metadata
from pathlib import Path

import lidarcodec
from lidarcodec.commands.running.options import variable
from lidarcodec.commands.settings import one_setting
from lidarcodec.errors import LidarCodecError
from lidarcodec.evaluation.bench import effective
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.udp.socket import KERNEL_BYTES, PACKETS_PER_SECOND
from lidarcodec.units import DATA_PORT

ZENOH_PORT = 7447
SERVER_PORT = 8080
DEVELOPERS = "dev"
"""The extra of those who change this package."""
REQUIREMENT = re.compile(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?\s*((?:[<>=]=?[^;\s]*)?)")
LIMIT = re.compile(r"(>=|<|==)([\w.]+)")
CLOCK_UNSYNCHRONISED = 5
"""Result of adjtimex(2) if no time service synchronises the clock."""


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _requirements() -> dict[str, list[str]]:
    """Names of required packages, by extra; "" for the base install. An extra that includes others has their
    packages.
    """
    found: dict[str, list[str]] = {"": []}
    try:
        requires = metadata.requires("lidarcodec") or []
    except metadata.PackageNotFoundError:
        return {}
    others: dict[str, list[str]] = {}
    for line in requires:
        name = re.split(r"[^A-Za-z0-9_.-]", line, maxsplit=1)[0]
        match = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
        extra = match[1] if match else ""
        own = re.match(r"lidarcodec\s*\[(.*?)\]", line)
        if own:
            others.setdefault(extra, []).extend(re.split(r"\s*,\s*", own[1]))
        found.setdefault(extra, []).extend([] if own else [name])

    def of(extra: str) -> set[str]:
        return set(found.get(extra, [])).union(*map(of, others.get(extra, [])))

    return {extra: sorted(of(extra), key=str.lower) if extra in others else names for extra, names in found.items()}


def unfit(of_extras: bool) -> list[str]:
    """Packages in a version that this one does not work with. Another program in the environment may have brought them.

    of_extras: those that only extras need, instead of those that are always needed
    """
    found = set()
    for line in metadata.requires("lidarcodec") or [] if _installed("lidarcodec") else []:
        match = REQUIREMENT.match(line)
        version = _installed(match[1]) if match else None
        if match and version and ("extra ==" in line) is of_extras and not _within(version, match[2]):
            found.add(f"{match[1]} {version} (needs {match[2]})")
    return sorted(found)


def _within(version: str, limits: str) -> bool:
    """Whether a version keeps limits such as `>=2.10,<3`. Only leading numbers count.

    >>> [_within(version, ">=2.10,<3") for version in ("2.9", "2.10.1", "3.0rc1")], _within("1.4", "==1.4")
    ([False, True, False], True)
    """
    have = _numbers(version)
    for sign, limit in LIMIT.findall(limits):
        wanted = _numbers(limit)
        if not {">=": have >= wanted, "<": have < wanted, "==": have[: len(wanted)] == wanted}[sign]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    found = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(map(int, found[0].split("."))) if found else ()


def _port_state(kind: socket.SocketKind, port: int) -> str:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind == socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            return f"in use ({error.strerror})"
        return "free"


def _time() -> str:
    return f"{time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime())} UTC"


def clock_is_held() -> bool | None:
    """Whether a time service synchronises the clock; None if the system does not say."""
    try:
        return bool(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512)) != CLOCK_UNSYNCHRONISED)
    except (OSError, AttributeError):
        return None


def _clock() -> str:
    held = clock_is_held()
    return _time() + {None: "", True: ", synchronised", False: ", NOT synchronised"}[held]


def receive_buffer() -> int | None:
    """Largest receive buffer of a socket in bytes (net.core.rmem_max); None if the system does not say."""
    try:
        return int(Path("/proc/sys/net/core/rmem_max").read_text())
    except (OSError, ValueError):
        return None


def _receive_buffer() -> str:
    limit = receive_buffer()
    if limit is None:
        return "unknown"
    # The kernel doubles what a socket asks for, and counts 2304 bytes for each packet of 1206.
    ms = 2 * limit / KERNEL_BYTES / PACKETS_PER_SECOND * 1000
    return f"{limit} bytes (net.core.rmem_max), {ms:.0f} ms of an HDL-64E"


def _settings() -> dict[str, str]:
    set_, codec_ = (variable(["publish"], name) for name in ("--set", "--codec"))
    pairs = os.environ.get(set_, "").split()
    named = {pair.partition("=")[0] for pair in pairs}
    codec = os.environ.get(codec_)
    try:
        values = effective(one_setting(codec, pairs))
    except LidarCodecError as error:
        return {"wrong": f"{set_} or {codec_}: {error}"}
    lines = {}
    for key, value in (values | values.pop("codec_settings")).items():
        if key in named:
            origin = set_
        elif key == "codec" and codec:
            origin = codec_
        else:
            origin = "default" if key in StreamSettings.model_fields else f"default of {values['codec']}"
        lines[key] = f"{'null' if value is None else value} ({origin})"
    return lines


def about() -> dict[str, dict[str, str]]:
    """All information, by heading. `settings` has only `wrong` if the environment names settings that do not exist."""
    requirements = _requirements()
    extras = {}
    for extra, names in requirements.items():
        missing = [name for name in names if _installed(name) is None]
        if extra and extra != DEVELOPERS:
            extras[extra] = "missing: " + ", ".join(missing) if missing else "installed"
    return {
        "versions": {
            "lidarcodec": lidarcodec.__version__,
            "Python": platform.python_version(),
            "system": f"{platform.system()} {platform.release()} {platform.machine()}, {os.cpu_count()} cores",
            **{name: _installed(name) or "missing" for name in requirements.get("", [])},
        },
        "extras": extras,
        "ports": {
            f"UDP {DATA_PORT} (sensor)": _port_state(socket.SOCK_DGRAM, DATA_PORT),
            f"TCP {ZENOH_PORT} (Zenoh)": _port_state(socket.SOCK_STREAM, ZENOH_PORT),
            f"TCP {SERVER_PORT} (server)": _port_state(socket.SOCK_STREAM, SERVER_PORT),
            "UDP receive buffer": _receive_buffer(),
        },
        "clock": {"system": _clock()},
        "settings": _settings(),
        "environment": {key: value for key, value in sorted(os.environ.items()) if key.startswith("LIDARCODEC_")},
    }
