"""Opening a session of Zenoh: its configuration, what its errors mean, and trying until there is a network."""

from __future__ import annotations

import errno
import json
import logging
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh

from lidarcodec.errors import TransportError, is_panic
from lidarcodec.transport.config_file import check_config_file

logger = logging.getLogger(__name__)

RETRY_S = 0.5
UNREACHABLE = "Unable to connect"
"""First words of Zenoh if nobody listens, or if the listener refuses us. It does not say which."""


def reason_of(error: BaseException) -> str:
    """What Zenoh says, without where in its source, and without the whole configuration: that may hold a password."""
    said = re.sub(r" at /\S+", "", str(error)).strip()
    return said.partition('{"')[0].rstrip(": ")


@contextmanager
def telling(what: str) -> Iterator[None]:
    """Errors of Zenoh as TransportError, and its panics, and threads that the machine does not give.

    A panic arrives as a PanicException, which is no Exception: what catches these would take it for a good end.
    """
    try:
        yield
    except (zenoh.ZError, RuntimeError) as error:
        raise TransportError(f"{what}: {reason_of(error)}") from None
    except BaseException as error:
        if not is_panic(error):
            raise
        raise TransportError(f"{what}: the network library failed: {reason_of(error)}") from None


def config_of(options: dict[str, Any], base: zenoh.Config | None = None) -> zenoh.Config:
    """Raises TransportError when Zenoh refuses a value."""
    config = zenoh.Config() if base is None else base
    try:
        for path, value in options.items():
            config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh does not accept {path} = {value!r}: {reason_of(error)}") from None
    return config


def read_config(path: Path) -> zenoh.Config:
    """Raises TransportError when the file is no Zenoh configuration."""
    check_config_file(path)
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise TransportError(f"{path} is not a Zenoh configuration: {reason_of(error)}") from None


def options_in(path: Path) -> Callable[[str], Any]:
    """Function that gives the value at a path of a configuration, such as `metadata`; None where there is none.

    Raises TransportError when the file is no Zenoh configuration.
    """
    return option_of(read_config(path))


def option_of(config: zenoh.Config) -> Callable[[str], Any]:
    return lambda path: json.loads(config.get_json(path) or "null")


def open_at_last(config: zenoh.Config, stop: threading.Event | None, waits_for: str | None) -> zenoh.Session:
    """Open a session; try again until it can be, or `stop` is set, after errors that say `waits_for`.

    Raises TransportError.
    """
    told = False
    while True:
        try:
            return open_session(config)
        except TransportError as error:
            if waits_for is None or waits_for not in str(error):
                raise
            if not told:
                logger.warning("%s; trying again until it works", _plainly(str(error)))
                told = True
            if (stop or threading.Event()).wait(RETRY_S):
                raise TransportError("stopped before the network could be reached") from None


def _plainly(error: str) -> str:
    """What an error of Zenoh about addresses that do not answer means; other errors as they are.

    >>> _plainly("cannot open a Zenoh session: Unable to connect to any of [Single(tcp/10.0.0.7:7447)]. Timeout!")
    'cannot connect to tcp/10.0.0.7:7447: nothing answers there, or it refuses this machine'
    """
    places = re.findall(r"Single\(([^()\s]{1,200})\)", error) if UNREACHABLE in error else []
    told = f"cannot connect to {' or '.join(places)}: nothing answers there, or it refuses this machine"
    return told if places else error


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Raises TransportError when the session cannot be opened."""
    try:
        with telling("cannot open a Zenoh session"):
            return zenoh.open(config)
    except TransportError as error:
        raise TransportError(_not_listening(str(error))) from None


def _not_listening(error: str) -> str:
    """What an error of Zenoh about an address at which it cannot listen means; other errors as they are.

    >>> where = "Can not create a new TCP listener bound to tcp/0.0.0.0:8080: [0.0.0.0:8080: "
    >>> _not_listening(where + "Address already in use (os error 98)")
    'cannot listen on tcp/0.0.0.0:8080: another program uses it: end that one, or choose another port'
    >>> _not_listening(where + "Cannot assign requested address (os error 99)")
    'cannot listen on tcp/0.0.0.0:8080: Cannot assign requested address'
    """
    found = re.search(r"Can not create a new \S{1,20} listener bound to (\S{1,200}): ", error)
    why = re.search(r"([A-Z][a-z' ]{1,100}) \(os error (\d{1,9})\)", error)
    if found is None or why is None:
        return error
    taken = int(why[2]) == errno.EADDRINUSE
    reason = "another program uses it: end that one, or choose another port" if taken else why[1]
    return f"cannot listen on {found[1]}: {reason}"
