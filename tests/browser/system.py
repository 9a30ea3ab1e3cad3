"""A server and vehicles as real processes, for tests that look at them with a browser."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from tests import asking, forks
from tests.command_line import COMMAND, environment, run_here
from tests.drives import simulated
from tests.sweeps import ALL
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

LIMIT_S = 60.0
"""Longest wait for anything; a busy machine takes its time."""
RATE_HZ = 2 if ALL else 1
"""Of a vehicle: enough to be live, and what simulates, decodes and draws it leaves time for the rest."""

DRIVE_FRAMES = 30
"""Of the drive that a vehicle goes through again and again."""


class System:
    """`lidarcodec serve` on ports of its own, and the vehicles that are started for it.

    meeting: the port of loopback where vehicles of another system are; by default nobody is there
    archive: the folder of its archive; by default it has none
    """

    def __init__(self, folder: Path, meeting: int | None = None, archive: Path | None = None) -> None:
        self.folder, self.meeting = folder, meeting or free_port()
        self._archive = [] if archive is None else ["--archive", str(archive)]
        self._variables = environment(LIDARCODEC_LOOPBACK_PORT=str(self.meeting), XDG_STATE_HOME=str(folder))
        self._database = f"sqlite:///{folder / 'server.db'}"
        self._port = free_port()
        self._vehicles: dict[str, subprocess.Popen[bytes]] = {}
        self._server: subprocess.Popen[bytes] | None = None
        self.url = f"http://127.0.0.1:{self._port}"

    def serve(self) -> None:
        """Start the server, and wait until it answers."""
        stores = ["--database-url", self._database, "--recordings", str(self.folder / "recordings")]
        self._server = self._start("serve", "--port", str(self._port), *stores, *self._archive)
        assert eventually(self._answers, LIMIT_S), "the server does not answer"

    def stop_server(self) -> None:
        """End the server as a signal would."""
        assert self._server is not None
        _end(self._server)

    def start_vehicle(self, name: str = "car-7", source: str = "sim:city", *, keep: bool = False) -> None:
        """Start a vehicle that drives through a town and gives its originals, if it does not drive already.

        keep: it keeps what it sees
        """
        if name not in self._vehicles:
            source, *loop = self._drive(source) if source == "sim:city" else [source]
            more = ["--keep", "64MB", "--keep-dir", str(self.folder / f"{name}-kept")] if keep else []
            rate = ["--rate", str(RATE_HZ)]
            self._vehicles[name] = self._start("publish", source, *loop, "--vehicle", name, *rate, "--original", *more)

    def _drive(self, source: str) -> list[str]:
        """A file of a drive, and to begin again at its end: to simulate is half of a vehicle's work."""
        path = self.folder / "drive.pcap"
        if not path.exists():
            simulated(f"{source}?frames={DRIVE_FRAMES}", path)
        return [str(path), "--loop"]

    def start_sensors(self, name: str, sensors: str) -> None:
        """Start a vehicle with several sensors, if it does not drive already. sensors: YAML, a line each"""
        if name not in self._vehicles:
            path = self.folder / f"{name}.yaml"
            path.write_text(f"vehicle: {name}\nsensors:\n{sensors}")
            self._vehicles[name] = self._start("publish", "--config", str(path))

    def kill_vehicle(self, name: str = "car-7") -> None:
        """End a vehicle as a power cut would."""
        process = self._vehicles.pop(name)
        process.kill()
        process.wait(LIMIT_S)

    def end_vehicle(self, name: str) -> None:
        """End a vehicle as a signal would, and wait until the server has seen it go."""
        _end(self._vehicles.pop(name))
        assert eventually(
            lambda: not any(one["alive"] for one in self.get("streams") if one["vehicle"] == name), LIMIT_S
        )

    def token(self, name: str, role: str) -> str:
        """A new token, which the server knows by now: it looks for new ones once a second."""
        said = run_here("token", "create", name, "--role", role, "--database-url", self._database)
        assert said.returncode == 0, said.stderr
        made = said.stdout.strip()
        assert eventually(lambda: self._knows(made) == name, LIMIT_S), "the server does not take the token"
        return made

    def revoke(self, name: str) -> None:
        """Make the token of that name worthless."""
        said = run_here("token", "revoke", name, "--database-url", self._database)
        assert said.returncode == 0, said.stderr

    def get(self, path: str, token: str | None = None) -> Any:
        """What the API answers to a GET below /api/v1/."""
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        return asking.get(f"{self.url}/api/v1/{path}", headers=headers, timeout=30).raise_for_status().json()

    def change(self, path: str, **values: Any) -> None:
        """Change something below /api/v1/."""
        asking.patch(f"{self.url}/api/v1/{path}", json=values, timeout=30).raise_for_status()

    def close(self) -> None:
        """End everything."""
        for process in (*self._vehicles.values(), self._server):
            if process is not None:
                _end(process)

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        with (self.folder / "processes.log").open("ab") as log:
            return forks.Process(
                [*COMMAND, *words], env=self._variables, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def _knows(self, token: str) -> str | None:
        """Whom the server takes somebody with this token for. Before it knows of any token, for an address like all."""
        headers = {"Authorization": f"Bearer {token}"}
        answer = asking.get(f"{self.url}/api/v1/session", headers=headers, timeout=30)
        return answer.json()["name"] if answer.status_code == 200 else None

    def _answers(self) -> bool:
        try:
            return asking.get(f"{self.url}/healthz", timeout=60).status_code == 200
        except httpx.HTTPError:
            return False


@contextmanager
def system(folder: Path, meeting: int | None = None, archive: Path | None = None) -> Iterator[System]:
    """A server that runs; it and its vehicles end with the block. meeting, archive: as for System"""
    made = System(folder, meeting, archive)
    try:
        made.serve()
        yield made
    finally:
        made.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(60)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
