"""A container of a stage that was built, without an engine: namespaces, a read-only root, a user that is nobody.

The process is the first of its namespace, as in a container: signals that it does not handle do nothing.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from tests.images.stages import Built, devices

DROP = "--clear-groups --no-new-privs --bounding-set=-all --inh-caps=-all"
END_S = 30.0


class Container:
    """Runs a command of an image.

    files: what is mounted into it, target to source, read-only;  volumes: the same, to be written
    tmpfs: folders in memory, with their mount options
    """

    def __init__(
        self,
        image: Built,
        folder: Path,
        name: str,
        command: list[str],
        *,
        environment: dict[str, str],
        files: dict[str, Path],
        volumes: dict[str, Path] | None = None,
        tmpfs: dict[str, str] | None = None,
        user: str | None = None,
        workdir: str | None = None,
    ) -> None:
        self.name, self._user, self._workdir = name, user or image.user, workdir or image.workdir
        self._environment = image.environment | {"HOME": "/", "HOSTNAME": name} | environment
        root, own, work = (folder / f"{name}.{kind}" for kind in ("root", "own", "work"))
        for one in (root, own, work):
            one.mkdir(exist_ok=True)
        layers = "lowerdir=" + ":".join(map(str, image.folders))
        lines = [
            "set -e",
            "mount --make-rprivate /",
            f"mount -t overlay overlay -o {layers},upperdir={own},workdir={work} {root}",
            f"mount -t proc proc {root}/proc",
            devices(root),
            f"mount -t tmpfs -o mode=1777 tmpfs {root}/dev/shm",
            f"mount -t tmpfs -o mode=0755 tmpfs {root}/run",
        ]
        for target, options in ({"/tmp": "mode=1777"} | (tmpfs or {})).items():
            lines.append(f"mount -t tmpfs -o {options or 'mode=1777'} tmpfs {root}{target}")
        for target, source in files.items():
            lines += [f"[ -e {root}{target} ] || {{ mkdir -p $(dirname {root}{target}); touch {root}{target}; }}"]
            lines += [f"mount --bind {source} {root}{target}", f"mount -o remount,bind,ro {root}{target}"]
        for target, source in (volumes or {}).items():
            lines += [f"mount --bind {source} {root}{target}"]
        lines += [f"mount -o remount,ro {root}", 'exec "$@"']  # by now everything has a place to be mounted on
        inner = ["chroot", str(root), *self._as_user(), *command]
        words = ["unshare", "--mount", "--pid", "--ipc", "--uts", "--fork", "--kill-child", "sh", "-c"]
        self.log = (folder / f"{name}.log").open("w+")
        self._process = subprocess.Popen(
            [*words, "\n".join(lines), "sh", *inner],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=subprocess.STDOUT,
        )

    def _as_user(self) -> list[str]:
        uid, gid = self._user.split(":")
        told = [f"{name}={value}" for name, value in self._environment.items()]
        home = ["/usr/bin/env", "-i", "-C", self._workdir, *told]
        return ["/usr/bin/setpriv", f"--reuid={uid}", f"--regid={gid}", *DROP.split(), *home]

    @property
    def pid(self) -> int:
        """Its first process, as this machine counts."""
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        if not children:
            raise RuntimeError(f"{self.name} has ended: {self.said()}")
        return int(children[0])

    def execute(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        """A further command in it, as `docker exec` and health checks do."""
        enter = ["nsenter", f"--target={self.pid}", "--mount", "--pid", "--ipc", "--uts", "--root", "--"]
        return subprocess.run(
            [*enter, *self._as_user(), *command], capture_output=True, text=True, check=False, timeout=120
        )

    def send(self, number: signal.Signals) -> None:
        """A signal to its first process."""
        os.kill(self.pid, number)

    def stop(self) -> tuple[int, float]:
        """SIGTERM; exit code, and after how many seconds."""
        begun = time.monotonic()
        self.send(signal.SIGTERM)
        code = self._process.wait(END_S)
        return code, round(time.monotonic() - begun, 2)

    def kill(self) -> None:
        """End it, whatever it does."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self.log.close()

    def wait(self) -> int:
        """Its exit code, for a command that ends by itself."""
        return self._process.wait(120)

    def said(self) -> str:
        """What it printed."""
        return Path(self.log.name).read_text()

    def memory_mib(self) -> float:
        """What its first process holds."""
        (line,) = [one for one in Path(f"/proc/{self.pid}/status").read_text().splitlines() if "VmRSS" in one]
        return round(int(line.split()[1]) / 1024, 1)
