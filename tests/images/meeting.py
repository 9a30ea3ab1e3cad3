"""The compose file's services on one loopback: router, database, server, vehicle, Prometheus.

All with the environment, the files and the users of docker/compose.yaml; names of services are loopback.
A Zenoh session in router mode stands for zenohd, and Debian's PostgreSQL and Prometheus for theirs.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import shutil
import socket
import struct
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.images.compose import FOLDER, read
from tests.images.containers import Container
from tests.images.dockerfile import DOCKERFILE, ROOT, parse
from tests.images.stages import Built

LIMIT_S = 120.0
ROUTER = "import zenoh, signal; session = zenoh.open(zenoh.Config.from_file('/etc/zenoh/router.json5')); signal.pause()"
SERVICES = read("compose.yaml")["services"]


def loopback_up() -> None:
    """A new network namespace has a loopback that is down."""
    with socket.socket() as any_socket:
        fcntl.ioctl(any_socket, 0x8914, struct.pack("16sh14x", b"lo", 1))  # SIOCSIFFLAGS, IFF_UP


def until(what: str, condition: Callable[[], Any], limit_s: float = LIMIT_S) -> Any:
    """The first true value.

    Raises RuntimeError when it never comes.
    """
    begun, last = time.monotonic(), ""
    end = begun + limit_s
    while time.monotonic() < end:
        try:
            if found := condition():
                print(f"{time.monotonic() - begun:6.1f} s until {what}", file=sys.stderr, flush=True)
                return found
        except (OSError, RuntimeError) as error:
            last = str(error)
        time.sleep(0.1)
    raise RuntimeError(f"it never happened: {what}. {last}")


def asked(path: str, token: str = "", method: str = "GET", body: Any = None) -> Any:
    """The server's answer."""
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"http://127.0.0.1:8080{path}", data, headers, method=method)
    with urllib.request.urlopen(request, timeout=60) as answer:
        data, kind = answer.read(), answer.headers["content-type"] or ""
    if kind.startswith("application/json"):
        return json.loads(data)
    return data.decode() if kind.startswith("text/") else data


class Meeting:
    """All of them; `stack` ends those that still run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.chmod(0o755)  # users of the database and of Prometheus look into it
        self.images = {one["name"]: Built.of(one) for one in json.loads((folder / "built.json").read_text())}
        self.stages = {stage.name: stage for stage in parse(DOCKERFILE.read_text())}
        self.stack = contextlib.ExitStack()
        self.secrets = folder / "secrets"
        hosts = " ".join(["localhost", *SERVICES])
        (folder / "hosts").write_text(f"127.0.0.1 {hosts}\n")

    def container(self, service: str, command: list[str] | None = None, name: str | None = None) -> Container:
        """A service of the compose file in its image, or another command of it."""
        about, image = SERVICES[service], self.images[SERVICES[service]["build"]["target"]]
        given = command or about.get("command") or self._of_image(image.name, "CMD")
        files = {"/etc/hosts": self.folder / "hosts"}
        files |= {f"/run/secrets/{secret}": self.secrets / secret for secret in about.get("secrets", [])}
        tmpfs = {one.partition(":")[0]: one.partition(":")[2] for one in about["tmpfs"]}
        volumes = {one.split(":")[1]: self._volume(image, one) for one in about.get("volumes", [])}
        environment = {key: self._plain(str(value)) for key, value in about["environment"].items()}
        made = Container(
            image, self.folder, name or service, [*self._of_image(image.name, "ENTRYPOINT"), *given],
            environment=environment, files=files, volumes=volumes, tmpfs=tmpfs,
        )  # fmt: skip
        self.stack.callback(made.kill)
        return made

    def _of_image(self, name: str, instruction: str) -> list[str]:
        while self.stages[name].last(instruction) is None:
            name = self.stages[name].base
        return self.stages[name].last(instruction).words

    @staticmethod
    def _plain(value: str) -> str:
        """`${NAME:-value}` as without an .env."""
        return value.partition(":-")[2].rstrip("}") if value.startswith("${") else value

    def _volume(self, image: Built, text: str) -> Path:
        """A named volume: it begins with the owner and mode of what it lies on, as the engine does it."""
        source, target, *_ = text.split(":")
        path = self.folder / f"volume-{source}"
        if not path.exists():
            path.mkdir()
            below = image.find(target)
            shutil.copystat(below, path)
            shutil.chown(path, below.stat().st_uid, below.stat().st_gid)
        return path

    def health(self, container: Container, image: str) -> int:
        """The exit code of its health check."""
        while self.stages[image].last("HEALTHCHECK") is None:
            image = self.stages[image].base
        check = json.loads(self.stages[image].last("HEALTHCHECK").value.partition("CMD ")[2])
        return container.execute(check).returncode

    # --- those who are not ours --------------------------------------------------------------------------------------

    def router(self) -> Container:
        """packaging/zenoh-router.json5, as the compose file's user."""
        settings = ROOT / "packaging" / "zenoh-router.json5"
        files = {"/etc/hosts": self.folder / "hosts", "/etc/zenoh/router.json5": settings}
        python = ["python", "-c", ROUTER]
        router = Container(
            self.images["vehicle"], self.folder, "router", python,
            environment={"HOME": "/tmp"}, files=files, user=SERVICES["router"]["user"], workdir="/",
        )  # fmt: skip
        self.stack.callback(router.kill)
        until("the router listens", lambda: socket.create_connection(("127.0.0.1", 7447), 1).close() or True)
        return router

    def database(self) -> subprocess.Popen[bytes]:
        """PostgreSQL with the user, the database and the password file of the compose file."""
        about = SERVICES["database"]["environment"]
        data = self.folder / "postgres"
        programs = "/usr/lib/postgresql/15/bin"
        data.mkdir()
        shutil.chown(data, "postgres", "postgres")
        shutil.copy(self.secrets / "database_password", self.folder / "pw")
        (self.folder / "pw").chmod(0o444)
        as_user: dict[str, Any] = {"user": "postgres", "group": "postgres", "extra_groups": [], "cwd": "/"}
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        words = ["-D", data, "-U", about["POSTGRES_USER"], f"--pwfile={self.folder / 'pw'}", "-N"]
        arguments = about["POSTGRES_INITDB_ARGS"].split()
        subprocess.run([f"{programs}/initdb", *words, *arguments], check=True, capture_output=True, **as_user)
        (self.folder / "pw").unlink()
        server = [f"{programs}/postgres", "-D", data, "-p", "5432", "-c", f"unix_socket_directories={data}"]
        log = self.stack.enter_context((self.folder / "database.log").open("w"))
        process = subprocess.Popen(server, stdout=log, stderr=log, **as_user)
        self.stack.callback(process.kill)
        createdb = [f"{programs}/psql", "-h", data, "-U", about["POSTGRES_USER"], "-d", "postgres", "-c"]
        words = [*createdb, f"CREATE DATABASE {about['POSTGRES_DB']}"]
        until("the database is made", lambda: subprocess.run(words, check=False, **quiet, **as_user).returncode == 0)
        return process

    @contextlib.contextmanager
    def prometheus(self) -> Iterator[None]:
        """Prometheus with the files of the compose file, as its user."""
        store = self.folder / "prometheus"
        store.mkdir()
        uid, gid = SERVICES["prometheus"]["user"].split(":")
        shutil.chown(store, int(uid), int(gid))
        script = f"""set -e
            mount --make-rprivate /
            mount --bind {self.folder / "hosts"} /etc/hosts
            mount -t tmpfs tmpfs /run && mkdir /run/secrets && cp {self.secrets / "metrics_token"} /run/secrets/
            exec setpriv --reuid={uid} --regid={gid} --clear-groups --no-new-privs \
              {shutil.which("prometheus")} --config.file={FOLDER}/prometheus/prometheus.yaml --storage.tsdb.path={store}
            """
        with (self.folder / "prometheus.log").open("w") as log:
            process = subprocess.Popen(["unshare", "--mount", "sh", "-c", script], stdout=log, stderr=log)
            try:
                yield
            finally:
                process.kill()
                process.wait()


def series(expression: str) -> list[dict[str, Any]]:
    """What Prometheus has."""
    query = urllib.parse.quote(expression)
    with urllib.request.urlopen(f"http://127.0.0.1:9090/api/v1/query?query={query}", timeout=60) as answer:
        return json.load(answer)["data"]["result"]
