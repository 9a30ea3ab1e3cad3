"""Writes requirements/*.txt: every package that `make`, images and the Debian package install, with hashes of files.

    python tools/lock.py             write them again, from pyproject.toml and constraints.txt (needs uv and an index)
    python tools/lock.py --check     whether they hold exactly the versions of constraints.txt, without a network

A lock serves x86-64 and aarch64, Python 3.11 and later. No address of an index is written.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TOOLS = {
    "build": ("cmake", "ninja", "nanobind", "scikit-build-core"),
    "wheels": ("build", "cibuildwheel"),
    "site": ("mkdocs", "mkdocs-material", "mkdocstrings", "mkdocstrings-python"),
}
"""Locks of tools, which are no dependency of the package."""
FORMATS = ("images", "video", "las")
"""Extras that `make` and the images always install, because a sender may choose any codec."""
LOCKS: dict[str, tuple[str, ...]] = {
    "build": (),
    "wheels": (),
    "site": (),
    "base": FORMATS,
    "server": (*FORMATS, "server"),
    "image-server": (*FORMATS, "server", "postgres"),
    "image-archive": (*FORMATS, "archive", "cluster"),
    "debian": (*FORMATS, "server", "archive"),
    "dev": ("dev",),
}
"""Name of the lock -> extras of pyproject.toml in it."""
BY_HAND: dict[str, tuple[str, ...]] = {"oracle": ("ouster-sdk",)}
"""Locks of packages that are installed without their dependencies; this program only checks them."""
HEAD = "# Written by `python tools/lock.py`: versions of constraints.txt, with the hashes of all their files.\n"
WINDOWS = re.compile(r"sys_platform == 'win32'|os_name == 'nt'")
PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", re.MULTILINE)


def name_of(text: str) -> str:
    """A package's name in its normal form (PEP 503)."""
    return re.sub(r"[-_.]+", "-", text).lower()


def pins(text: str) -> dict[str, str]:
    """Name -> version of every exact pin in a file of requirements or constraints."""
    return {name_of(name): version for name, version in PIN.findall(text)}


def wanted(lock: str) -> list[str]:
    """The requirements that a lock answers."""
    if lock in TOOLS or lock in BY_HAND:
        return list(TOOLS.get(lock) or BY_HAND[lock])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found, extras = list(project["dependencies"]), list(LOCKS[lock])
    while extras:
        for text in project["optional-dependencies"][extras.pop()]:
            own = re.fullmatch(r"lidarcodec\[(.*)\]", text)
            if own:
                extras += own[1].split(",")
            else:
                found.append(text)
    return sorted(set(found))


def problems() -> list[str]:
    """What of the locks does not agree with pyproject.toml and constraints.txt; empty when all does."""
    constraints = pins((ROOT / "constraints.txt").read_text())
    found = []
    for lock in (*LOCKS, *BY_HAND):
        text = (ROOT / "requirements" / f"{lock}.txt").read_text()
        locked = pins(text)
        for name, version in locked.items():
            if constraints.get(name) != version:
                found.append(f"{lock}: {name}=={version}, constraints.txt has {constraints.get(name)}")
        for requirement in wanted(lock):
            name = name_of(re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0])
            if name not in locked:
                found.append(f"{lock}: {name} is missing")
        for entry in re.split(r"\n(?=[A-Za-z0-9])", text):
            if PIN.match(entry) and "--hash=sha256:" not in entry:
                found.append(f"{lock}: {entry.splitlines()[0]} has no hash")
        if "://" in text or "index-url" in text:
            found.append(f"{lock}: an address")
    return found


def write() -> None:
    """Write every lock. Raises CalledProcessError when uv fails."""
    for lock in LOCKS:
        with tempfile.NamedTemporaryFile("w", suffix=".in") as file:
            file.write("\n".join(wanted(lock)) + "\n")
            file.flush()
            command = [
                "uv",
                "pip",
                "compile",
                file.name,
                "--universal",
                "--generate-hashes",
                "--python-version",
                "3.11",
            ]
            command += [
                "--constraint",
                str(ROOT / "constraints.txt"),
                "--no-emit-index-url",
                "--no-annotate",
            ]
            command += ["--no-header", "--quiet", "--no-config"]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        entries = re.split(r"\n(?=[A-Za-z0-9])", done.stdout)
        kept = [entry.rstrip("\n") for entry in entries if not WINDOWS.search(entry.splitlines()[0])]
        (ROOT / "requirements" / f"{lock}.txt").write_text(HEAD + "\n".join(kept) + "\n")


if __name__ == "__main__":
    if "--check" not in sys.argv[1:]:
        write()
    for problem in problems():
        print(problem, file=sys.stderr)
    sys.exit(bool(problems()))
