"""What a user would lose: alerts, because one vehicle's clock is wrong, the disk is full, or the monitor was killed."""

from __future__ import annotations

import contextlib
import importlib
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader

import lidarcodec
from tests.clients.test_v2x_monitor import MONITOR, RULES, SQUARE, road, zones
from tests.command_line import environment

TENTH = 100_000_000
HOUR_S = 3600
EVENT = {"zone": "kerb", "raised": True, "stamp_ns": 5}
FULL = """
import json, resource, sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from pathlib import Path
from outputs import McapOutput
said = []
output = McapOutput(Path(sys.argv[2]), said.append)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
for number in range(40):
    output.alert({"zone": "kerb", "raised": True, "stamp_ns": number})
    output.state({"stamp_ns": number}, np.random.default_rng(number).normal(size=(200, 3)))
output.close()
print(json.dumps([said, str(output.fault)]))
"""


@pytest.fixture
def main(monkeypatch):
    """The modules of the monitor, as its program has them."""
    monkeypatch.syspath_prepend(str(MONITOR))
    before = signal.getsignal(signal.SIGINT)
    try:
        spec = importlib.util.spec_from_file_location("v2x_main", MONITOR / "__main__.py")
        found = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(found)
        yield found
    finally:
        signal.signal(signal.SIGINT, before)
        for name in ("options", "outputs", "zones"):
            sys.modules.pop(name, None)


@pytest.mark.parametrize("off_s", [HOUR_S, -HOUR_S])
def test_a_vehicle_whose_clock_is_wrong_blinds_no_other(main, capsys, off_s):
    """Where it had looked, nothing raised an alert for an hour; what stood was cleared."""
    rules = importlib.import_module("zones").Rules(stand=5)
    kerb = main.Zone("kerb", [[14, 1.5], [24, 1.5], [24, 5], [14, 5]], rules)
    monitor = main.Monitor([kerb], [])
    frame = next(iter(lidarcodec.read_frames("sim:street?seed=1&frames=1")))
    frame = replace(frame, pose=np.eye(4))
    now_ns = time.time_ns()
    monitor.take("early/lidar", replace(frame, stamp_ns=now_ns + off_s * 10**9), None)
    for number in range(6):
        monitor.take("car/lidar", replace(frame, stamp_ns=now_ns + number * TENTH), None)
    monitor.take("early/lidar", replace(frame, stamp_ns=now_ns + off_s * 10**9), None)
    out, complaints = capsys.readouterr()
    assert [json.loads(line)["raised"] for line in out.splitlines()] == [True]
    assert kerb.alert
    assert "early/lidar has a clock that is" in complaints
    assert len(complaints.splitlines()) == 1


def test_what_no_vehicle_sees_any_more_is_forgotten():
    """With no vehicle left, an alert stood for ever, and its points were shown as those of now."""
    zone = zones.Zone("z", SQUARE, RULES)
    found = [zone.see(road((3.0, 2.0), seed=number), 10**18 + number * TENTH, "a") for number in range(12)]
    assert [event.raised for event in found if event] == [True]
    assert zone.go_on(10**18 + 60 * TENTH) is None
    assert "a" in zone.things
    cleared = zone.go_on(10**18 + 150 * TENTH)
    assert cleared is not None
    assert not cleared.raised
    assert not zone.alert
    assert zone.things == {}


def test_a_full_disk_ends_the_file_and_nothing_else(tmp_path: Path):
    """The monitor ended with it, so nobody got an alert any more."""
    given = [sys.executable, "-c", FULL, str(MONITOR), str(tmp_path / "alerts.mcap")]
    result = subprocess.run(given, capture_output=True, text=True, env=environment(), timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    said, fault = json.loads(result.stdout)
    assert len(said) == 1
    assert "cannot be written any more" in said[0]
    assert "ends early" in fault


def test_a_kill_loses_no_alert_of_the_file(main, tmp_path: Path):
    """Up to 256 KiB waited in the program: minutes of alerts."""
    path = tmp_path / "alerts.mcap"
    output = importlib.import_module("outputs").McapOutput(path, print)
    output.alert(EVENT)
    data = path.read_bytes()
    output.close()
    path.write_bytes(data)
    found: list[dict] = []
    with path.open("rb") as file, contextlib.suppress(EndOfFile):  # it ends where it was killed
        messages = NonSeekingReader(file).iter_messages(log_time_order=False)
        found += (json.loads(message.data) for *_, message in messages)
    assert found == [EVENT]


def test_a_file_of_an_earlier_run_is_kept(main, tmp_path: Path):
    """Its alerts were gone with the next start of the service."""
    path = tmp_path / "alerts.mcap"
    path.write_bytes(b"alerts of yesterday")
    with pytest.raises(OSError, match="exists: choose another name"):
        importlib.import_module("outputs").McapOutput(path, print)
    assert path.read_bytes() == b"alerts of yesterday"
