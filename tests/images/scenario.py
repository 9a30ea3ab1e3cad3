"""What the services of the compose file do together, from the first token to SIGTERM.

    unshare --net python -m tests.images.scenario FOLDER

Prints JSON: what was seen, in the order in which it was. Ends with an error at the first thing that must not happen.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.images.containers import Container
from tests.images.dockerfile import ROOT
from tests.images.meeting import Meeting, asked, loopback_up, series, until

STREAM = "/api/v1/streams/simulated/roof"
STATUS = "print(open('/proc/self/status').read())"
WRITING = "open('/opt/lidarcodec/written', 'w')"


def need(what: str, value: object) -> None:
    """Raises RuntimeError when it is not so."""
    if not value:
        raise RuntimeError(f"it must not be: {what}")


class Scenario:
    """One run; `found` is what was seen."""

    def __init__(self, folder: Path) -> None:
        self.meeting = Meeting(folder)
        self.found: dict[str, Any] = {}
        self.token = ""
        self.watched = shutil.which("prometheus") is not None

    def run(self) -> dict[str, Any]:
        """All of it."""
        with self.meeting.stack:
            self.secrets()
            self.meeting.router()
            database = self.meeting.database()
            self.tokens()
            server = self.server()
            with self.meeting.prometheus() if self.watched else contextlib.nullcontext():
                vehicle = self.vehicle()
                self.confined(server, "server")
                self.confined(vehicle, "vehicle")
                self.monitored(self.changed(vehicle))
            self.database_away(server, database)
            self.ended(server)
        return self.found

    def secrets(self) -> None:
        """docker/secrets.sh makes what it makes for a user."""
        script = shutil.copy(ROOT / "docker" / "secrets.sh", self.meeting.folder)
        subprocess.run(["sh", script], check=True, capture_output=True)

    def tokens(self) -> None:
        """A server without tokens refuses to begin; then there are two."""
        refused = self.meeting.container("server", name="refused")
        need("a server that everybody reaches begins without a token", refused.wait() == 2)
        made = {}
        for name, role in (("prometheus", "viewer"), ("ada", "operator")):
            one = self.meeting.container("server", ["token", "create", name, "--role", role], name=f"token-{name}")
            need(f"token create fails: {one.said()}", one.wait() == 0)
            made[name] = one.said().split()[-1]
        self.token = made["ada"]
        (self.meeting.secrets / "metrics_token").write_text(made["prometheus"] + "\n")
        (self.meeting.secrets / "metrics_token").chmod(0o444)
        self.found["without a token"] = refused.said().strip()

    def server(self) -> Container:
        """It is ready, by its health check."""
        begun = time.monotonic()
        server = self.meeting.container("server")
        until("the server is well", lambda: self.meeting.health(server, "server") == 0)
        self.found["server well after s"] = round(time.monotonic() - begun, 1)
        need("anybody is answered", _refused("/api/v1/streams"))
        return server

    def vehicle(self) -> Container:
        """Its stream is listed, and a picture of it is drawn from what it sent."""
        begun = time.monotonic()
        vehicle = self.meeting.container("vehicle")
        until("the stream is listed", lambda: self.stream()["alive"])
        self.found["stream listed after s"] = round(time.monotonic() - begun, 1)
        until("the vehicle is well", lambda: self.meeting.health(vehicle, "vehicle") == 0)
        until("a picture", lambda: len(asked(f"{STREAM}/snapshot.png", self.token)) > 0, 60)
        return vehicle

    def stream(self) -> dict[str, Any]:
        """What the API says of the stream."""
        listed = asked("/api/v1/streams", self.token)
        return next((one for one in listed if one["vehicle"] == "simulated"), {"alive": False})

    def confined(self, one: Container, name: str) -> None:
        """Nobody in particular, who may do nothing and write nowhere but where it should."""
        told = one.execute(["python", "-c", STATUS]).stdout
        lines = dict(line.split(":", 1) for line in told.splitlines() if ":" in line)
        need(f"{name} is root", lines["Uid"].split() == ["10001"] * 4)
        need(f"{name} may gain rights", lines["NoNewPrivs"].split() == ["1"])
        need(f"{name} has capabilities", int(lines["CapEff"], 16) == int(lines["CapBnd"], 16) == 0)
        written = one.execute(["python", "-c", WRITING])
        need(f"{name} writes into its image", "Read-only file system" in written.stderr)
        need(f"{name} has pip", one.execute(["python", "-m", "pip"]).returncode != 0)
        self.found[f"{name} memory MiB"] = one.memory_mib()

    def changed(self, vehicle: Container) -> Container:
        """A codec in a process of its own, a recording on the volume, and settings that a restart keeps."""
        asked(f"{STREAM}/settings", self.token, "PATCH", {"codec": "h264", "max_error_m": None})
        asked(f"{STREAM}/recording", self.token, "POST", {})
        time.sleep(3.0)
        asked(f"{STREAM}/recording", self.token, "DELETE")
        kept = asked("/api/v1/recordings", self.token)
        need("nothing was recorded", kept and kept[0]["size_bytes"] > 10_000)
        self.found["vehicle ended, code and s"] = vehicle.stop()
        need("SIGTERM ends the vehicle", self.found["vehicle ended, code and s"][0] == 0)
        until("the stream is gone", lambda: not self.stream()["alive"])
        again = self.meeting.container("vehicle", name="vehicle-again")
        until("it is alive again", lambda: self.stream()["alive"])
        until("it has its settings again", lambda: self.stream()["settings"]["codec"] == "h264")
        return again

    def monitored(self, vehicle: Container) -> None:
        """Prometheus sees it by its token; a vehicle that stands still is not well, and then an alert."""
        if self.watched:
            until("Prometheus sees the server", lambda: series('up{job="lidarcodec"} == 1'))
            until("Prometheus sees the stream", lambda: series('lidarcodec_stream_alive{vehicle="simulated"} == 1'))
        until("the vehicle is well", lambda: self.meeting.health(vehicle, "vehicle") == 0)
        vehicle.send(signal.SIGSTOP)
        begun = time.monotonic()
        until("a vehicle that stands still is not well", lambda: self.meeting.health(vehicle, "vehicle") == 1)
        self.found["standing still seen after s"] = round(time.monotonic() - begun, 1)
        vehicle.send(signal.SIGCONT)
        until("it is well again", lambda: self.meeting.health(vehicle, "vehicle") == 0)
        need("SIGTERM ends it", vehicle.stop()[0] == 0)
        if self.watched:
            gone = 'ALERTS{alertname="StreamGone", alertstate="firing"}'
            until("an alert", lambda: series(gone), 180)
            self.found["prometheus"] = "sees server and stream; StreamGone fires"

    def database_away(self, server: Container, database: subprocess.Popen[bytes]) -> None:
        """Streams are shown, the health check says what is away."""
        database.send_signal(signal.SIGINT)
        database.wait(60)
        until("a server without its database is not well", lambda: self.meeting.health(server, "server") == 1)
        need("streams are not shown", self.stream())
        told = asked("/metrics", self.token)
        need("the metric says so", 'lidarcodec_ready{part="store"} 0.0' in told)
        self.found["database away"] = "streams shown, health check 1, lidarcodec_ready 0"

    def ended(self, one: Container) -> None:
        """SIGTERM ends it in time."""
        code, seconds = one.stop()
        need(f"SIGTERM ends {one.name} with {code}", code == 0)
        self.found[f"{one.name} ended, code and s"] = (code, seconds)


def _refused(path: str) -> bool:
    try:
        asked(path)
    except OSError as error:
        return "401" in str(error)
    return False


if __name__ == "__main__":
    loopback_up()
    print(json.dumps(Scenario(Path(sys.argv[1])).run()))
