"""The checks of `lidarcodec doctor`, and how they are printed."""

from __future__ import annotations

import difflib
import os
import resource
from collections.abc import Collection, Iterator
from typing import cast

from lidarcodec.commands.doctor.about import about, clock_is_held, receive_buffer, unfit
from lidarcodec.commands.results.about import Check, Doctor
from lidarcodec.commands.running.telling import tell
from lidarcodec.sources.udp.socket import BUFFER_BYTES, LEAST_BYTES

FEW_FILES = 4096
APART = "another program brought them: install lidarcodec into an environment of its own (docs/installing.md)"
TOLD = ("checks", "extras")
"""What the lines of the checks say already."""
MARKS = {"good": "good", "warning": "WARNING", "bad": "BAD"}


def run(known: Collection[str], as_json: bool) -> bool:
    """Check this machine, and print what was found. Returns whether nothing is bad. known: names of our variables"""
    found = examined(known)
    tell(found, text_of(found), as_json)
    return all(check["state"] != "bad" for check in found["checks"])


def examined(known: Collection[str]) -> Doctor:
    """What was checked and found."""
    facts = about()
    return cast(Doctor, {"checks": list(_checks(facts, known)), **facts})


def text_of(found: Doctor) -> str:
    """The checks, a line each with a line for its remedy, and then the facts."""
    from lidarcodec.commands.info.command import lines_of

    lines = []
    for check in found["checks"]:
        lines.append(f"{MARKS[check['state']]:8} {check['name']:16} {check['found']}")
        if check["remedy"]:
            lines.append(f"{'':8} {'':16} -> {check['remedy']}")
    return "\n".join([*lines, "", *lines_of({name: part for name, part in found.items() if name not in TOLD})])


def _checks(facts: dict[str, dict[str, str]], known: Collection[str]) -> Iterator[Check]:
    versions = facts["versions"]
    yield _packages(versions)
    yield _extras(facts["extras"])
    yield _buffer(facts["ports"]["UDP receive buffer"])
    yield _open_files()
    yield _clock(facts["clock"]["system"])
    for name, state in facts["ports"].items():
        if name != "UDP receive buffer":
            yield _port(name, state)
    yield _settings(facts["settings"])
    yield from _variables(known)


def _packages(versions: dict[str, str]) -> Check:
    missing = [name for name, version in versions.items() if version == "missing"]
    if missing:
        remedy = "install them again: pip install --force-reinstall lidarcodec"
        return Check(name="packages", state="bad", found=f"missing: {', '.join(missing)}", remedy=remedy)
    others = unfit(of_extras=False)
    if others:
        return Check(name="packages", state="bad", found=f"of other versions: {', '.join(others)}", remedy=APART)
    found = f"lidarcodec {versions['lidarcodec']}, Python {versions['Python']}, {versions['system']}"
    return Check(name="packages", state="good", found=found, remedy="")


def _extras(extras: dict[str, str]) -> Check:
    installed = [name for name, state in extras.items() if state == "installed"]
    absent = [name for name in extras if name not in installed]
    found = f"installed: {', '.join(installed) or 'none'}" + (f"; not installed: {', '.join(absent)}" if absent else "")
    others = unfit(of_extras=True)
    if others:
        return Check(
            name="extras", state="warning", found=f"{found}; of other versions: {', '.join(others)}", remedy=APART
        )
    return Check(name="extras", state="good", found=found, remedy="")


def _buffer(found: str) -> Check:
    limit = receive_buffer()
    if limit is None or 2 * limit >= LEAST_BYTES:
        return Check(name="receive buffer", state="good", found=found, remedy="")
    remedy = f"a busy moment loses packets of a sensor: sudo sysctl -w net.core.rmem_max={BUFFER_BYTES}"
    return Check(name="receive buffer", state="warning", found=found, remedy=remedy)


def _open_files() -> Check:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]  # live commands raise theirs up to this
    endless = limit == resource.RLIM_INFINITY
    found = f"at most {'any number' if endless else limit} in a process"
    if endless or limit >= FEW_FILES:
        return Check(name="open files", state="good", found=found, remedy="")
    remedy = "connections of strangers can use them all: raise the limit, with LimitNOFILE= in a unit or `ulimit -n`"
    return Check(name="open files", state="warning", found=found, remedy=remedy)


def _clock(found: str) -> Check:
    if clock_is_held() is not False:
        return Check(name="clock", state="good", found=found, remedy="")
    remedy = "latencies between machines will be wrong: start a time service, such as chrony"
    return Check(name="clock", state="warning", found=found, remedy=remedy)


def _port(name: str, state: str) -> Check:
    port, _, use = name.partition(" (")
    found = f"{state} ({use}"
    if state == "free":
        return Check(name=port, state="good", found=found, remedy="")
    remedy = "another program has it: `ss -tulnp` names the program. It may be another lidarcodec"
    return Check(name=port, state="warning", found=found, remedy=remedy)


def _settings(found: dict[str, str]) -> Check:
    if "wrong" in found:
        remedy = "correct the variable, or unset it"
        return Check(name="settings", state="bad", found=found["wrong"], remedy=remedy)
    return Check(name="settings", state="good", found=f"publish sends with codec {found['codec']}", remedy="")


def _variables(known: Collection[str]) -> Iterator[Check]:
    """A check for each variable that looks like one of ours and is not."""
    for name in sorted({one for one in os.environ if one.startswith("LIDARCODEC_")}.difference(known)):
        near = difflib.get_close_matches(name, known, 1)
        remedy = f"did you mean {near[0]}?" if near else "unset it; docs/environment.md lists all variables"
        yield Check(name="environment", state="warning", found=f"{name} means nothing to lidarcodec", remedy=remedy)
