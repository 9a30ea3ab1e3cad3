"""The stages of a Dockerfile, built in a chroot: each is what it adds to the one below, in an overlay.

In place of the base image stands a Debian of the same release that debootstrap makes, with Debian's Python of the same
minor version under the names that the image has. Needs root, and util-linux.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.images.dockerfile import ROOT, Instruction, Stage, context, copied, expand

PACKAGES = "ca-certificates,python3,python3-dev,python3-pip,python3-venv"
RELEASE = "bookworm"
PASSED = ("PIP_", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY", "http_proxy", "https_proxy", "no_proxy")
"""How this machine reaches its registries: told to RUN steps, and in no image."""
DEVICES = ("null", "zero", "full", "random", "urandom")


@dataclass
class Built:
    """A stage that was built. folders: what it adds, uppermost first;  environment: its ENV"""

    name: str
    folders: list[Path]
    environment: dict[str, str] = field(default_factory=dict)
    user: str = "0:0"
    workdir: str = "/"
    steps: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def of(cls, values: dict[str, Any]) -> Built:
        """From `as_json`."""
        return cls(**values | {"folders": [Path(one) for one in values["folders"]]})

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return vars(self) | {"folders": [str(one) for one in self.folders]}

    def find(self, path: str) -> Path:
        """A path of the image on this machine.

        Raises FileNotFoundError.
        """
        for folder in self.folders:
            if (found := folder / path.lstrip("/")).exists() or found.is_symlink():
                return found
        raise FileNotFoundError(f"{self.name} has no {path}")

    @property
    def added_bytes(self) -> int:
        """What is in its layers, without the base; files that lie in two layers count twice, as in an image."""
        return sum(_size(folder) for folder in self.folders[:-1])


def _size(folder: Path) -> int:
    paths = [path for path in folder.rglob("*") if not path.is_symlink() and path.is_file()]
    return sum(path.stat().st_size for path in paths)


def make_base(folder: Path) -> Path:
    """What stands for the base image; made once."""
    base = folder / "debian"
    if (folder / "debian.made").exists():
        return base
    subprocess.run(["debootstrap", "--variant=minbase", f"--include={PACKAGES}", RELEASE, base], check=True)
    shutil.copy("/etc/resolv.conf", base / "etc/resolv.conf")
    shutil.copy("/etc/ssl/certs/ca-certificates.crt", base / "etc/ssl/certs/ca-certificates.crt")
    for path in [*Path("/etc/apt/apt.conf.d").glob("99*"), *Path("/etc/apt/sources.list.d").glob("debian.sources")]:
        shutil.copy(path, base / path.relative_to("/"))
    if Path("/etc/pip.conf").exists():
        shutil.copy("/etc/pip.conf", base / "etc/pip.conf")
    for name, real in (("python", "python3"), ("python3", "python3"), ("pip", "pip3")):
        (base / "usr/local/bin" / name).symlink_to(f"/usr/bin/{real}")
    (folder / "debian.made").touch()
    return base


class Builder:
    """Builds stages, one after the other, below a folder. One that the folder has already is not built again."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.base = make_base(folder)
        self.built: dict[str, Built] = {}

    def build(self, stage: Stage) -> Built:
        """Run its steps.

        Raises subprocess.CalledProcessError when a RUN fails, FileNotFoundError when a COPY finds nothing.
        """
        below = self.built.get(stage.base)
        upper, note = self._folder / f"stage-{stage.name}", self._folder / f"stage-{stage.name}.json"
        said = [stage.base, *(f"{one.name} {one.value}" for one in stage.instructions)]
        if note.exists() and (kept := json.loads(note.read_text()))["said"] == said:
            self.built[stage.name] = Built.of(kept["built"])
            return self.built[stage.name]
        for one in (upper, self._folder / "work", self._folder / "root"):
            shutil.rmtree(one, ignore_errors=True)
            one.mkdir()
        if below is None:
            made = Built(stage.name, [upper, self.base])
        else:
            made = Built(stage.name, [upper, *below.folders], dict(below.environment), below.user, below.workdir)
        arguments: dict[str, str] = {}
        for one in stage.instructions:
            begun = time.monotonic()
            known = arguments | made.environment
            if one.name == "ARG":
                arguments |= one.pairs
            elif one.name == "ENV":
                known = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"} | known
                made.environment |= {name: expand(value, known) for name, value in one.pairs.items()}
            elif one.name == "USER":
                made.user = one.value
            elif one.name == "WORKDIR":
                made.workdir = one.value
                if not any((folder / one.value.lstrip("/")).is_dir() for folder in made.folders):
                    (upper / one.value.lstrip("/")).mkdir(parents=True)
            elif one.name == "COPY":
                self._copy(made, upper, one)
            elif one.name == "RUN":
                self._run(made, one.value, arguments)
            if one.name in ("RUN", "COPY"):
                seconds = round(time.monotonic() - begun, 1)
                made.steps.append({"stage": stage.name, "line": one.line, "step": one.name, "seconds": seconds})
        self.built[stage.name] = made
        note.write_text(json.dumps({"said": said, "built": made.as_json()}))
        return made

    def _copy(self, made: Built, upper: Path, instruction: Instruction) -> None:
        what = copied(instruction)
        target = Path(made.workdir, what.destination)
        into = upper / target.as_posix().lstrip("/")
        for source in what.sources:
            if what.stage is not None:
                found = self.built[what.stage].find(source)
                self._put(found, into, keep_name=what.destination.endswith("/"))
                continue
            names = [name for name in context() if name == source or name.startswith(f"{source.rstrip('/')}/")]
            if not names:
                raise FileNotFoundError(f"COPY {source}: the build's context has none")
            for name in names:
                inner = "" if name == source else name[len(source.rstrip("/")) + 1 :]
                single = name == source
                to = into / Path(name).name if single and what.destination.endswith("/") else into / inner
                to.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, to)

    @staticmethod
    def _put(found: Path, into: Path, *, keep_name: bool) -> None:
        if found.is_dir():
            shutil.copytree(found, into, symlinks=True, dirs_exist_ok=True)
        else:
            to = into / found.name if keep_name else into
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(found, to)

    def _run(self, made: Built, command: str, arguments: dict[str, str]) -> None:
        root, work = self._folder / "root", self._folder / "work"
        upper, *lower = made.folders
        passed = {name: value for name, value in os.environ.items() if name.startswith(PASSED)}
        passed.pop("PIP_FIND_LINKS", None)  # a folder of this machine
        path = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root"}
        told = [f"{name}={value}" for name, value in (path | passed | arguments | made.environment).items()]
        script = f"""set -e
            mount --make-rprivate /
            mount -t overlay overlay -o lowerdir={":".join(map(str, lower))},upperdir={upper},workdir={work} {root}
            mount -t proc proc {root}/proc
            {devices(root)}
            cd /
            exec chroot {root} env -i "$@"
            """
        inner = ["/bin/sh", "-c", f"cd {made.workdir} && {command}"]
        words = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", script, "sh", *told, *inner]
        subprocess.run(words, check=True, stdin=subprocess.DEVNULL)


def devices(root: Path) -> str:
    """Lines of a shell that make the few devices of a container."""
    binds = "\n".join(f"touch {root}/dev/{name} && mount --bind /dev/{name} {root}/dev/{name}" for name in DEVICES)
    return f"mount -t tmpfs -o mode=0755 tmpfs {root}/dev\n{binds}\nmkdir -m 1777 {root}/dev/shm"
