"""What a user would lose: a decoder in another language that agrees with ours, and the program he starts from."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.sensors.models.table import block_sensors
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack
from tests.codecs.test_other_sensors import FILES, opened
from tests.conftest import ROOT
from tests.server.live import running
from tests.sweeps import sampled

CLIENT = ROOT / "clients" / "typescript"


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The decoder, compiled: a folder with src, test and examples."""
    compiler = CLIENT / "node_modules" / "typescript" / "bin" / "tsc"
    if shutil.which("node") is None or not compiler.is_file():
        pytest.skip("needs node, and `npm ci` in clients/typescript once")
    out = CLIENT / "dist" / f"tests-{os.getpid()}"
    subprocess.run(["node", str(compiler), "--outDir", str(out)], cwd=CLIENT, check=True, timeout=300)
    yield out
    shutil.rmtree(out)


@pytest.mark.timeout(330)  # as long as the program in it may take, on a busy machine
@pytest.mark.sweep
def test_it_agrees_with_the_vectors_and_survives_hostile_bytes(built):
    """With an eighth of the damaged messages, `make test` runs the same when a file of the decoder has changed."""
    files = sorted(str(path) for path in (built / "test").glob("*.test.js"))
    words = ["node", "--test", *files]
    variables = os.environ | {"LIDARCODEC_EXAMPLES": "all"}
    result = subprocess.run(words, cwd=CLIENT, capture_output=True, text=True, check=False, timeout=300, env=variables)
    assert result.returncode == 0, result.stdout[-4000:]
    assert int(re.search(r"^# pass (\d+)", result.stdout, re.M)[1]) >= 15


EVERY_POINT = """
import { Decoder, imagePointsOf } from "%s/src/index.js";
import { readFileSync, writeFileSync } from "node:fs";
const decoder = await Decoder.create();
const points = imagePointsOf(decoder.decode(new Uint8Array(readFileSync("message"))), true);
writeFileSync("points", new Uint8Array(points.xyz.buffer));
"""


@pytest.mark.parametrize("capture", sampled([name for name in FILES if "767798045" not in name], ["vls128"]))
def test_every_point_of_a_capture_is_that_of_the_python_package(built, tmp_path, capture):
    sensor, packets = opened(FILES[capture])
    frame = next(iter(frames_of(packets, sensor)))
    (message,) = StreamEncoder(StreamSettings(codec="zstd"), 1).encode(frame)
    (tmp_path / "message").write_bytes(pack(message))
    (tmp_path / "run.mjs").write_text(EVERY_POINT % built.as_uri())
    subprocess.run(["node", "run.mjs"], cwd=tmp_path, check=True, timeout=60)
    cloud = frame.cloud("all")
    came = np.fromfile(tmp_path / "points", "<f4").reshape(-1, 3)
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(came[:, axis], cloud[name], rtol=0, atol=1e-4)


def test_its_models_are_those_of_the_python_package():
    text = (CLIENT / "src" / "other" / "models.ts").read_text()
    found = re.findall(r"^  (\w+): \{\n    rows: \[\n([\d,\s]+)\],\n    firing: (.*),$", text, re.M)
    models = {name: ([int(one) for one in re.findall(r"\d+", rows)], firing) for name, rows, firing in found}
    assert models.keys() == {sensor.name for sensor in block_sensors()}
    for sensor in block_sensors():
        rows, firing = models[sensor.name]
        assert rows == sensor.channel_of_row.tolist()
        if isinstance(sensor, VelodyneSensor):
            assert json.loads(firing) == [sensor.cycle_us, sensor.shot_us, sensor.together]
        else:
            assert firing == "null"


@pytest.mark.sweep
def test_the_example_prints_the_points_of_a_live_stream(built, tmp_path):
    with running(tmp_path) as server, server.publisher(settings=StreamSettings(codec="zstd")):
        assert server.seen()
        words = [f"ws://127.0.0.1:{server.port}/api/v1/streams/vehicle/lidar/frames", "2"]
        program = ["node", *_socket_option(), str(built / "examples" / "print_points.js"), *words]
        said = subprocess.run(program, cwd=CLIENT, capture_output=True, text=True, check=True, timeout=120).stdout
    assert said.startswith("vehicle/lidar\n")
    assert len(re.findall(r"^frame \d+: \d+ points, the first at ", said, re.M)) == 2


def _socket_option() -> list[str]:
    version = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True, timeout=60).stdout
    return ["--experimental-websocket"] if int(version.removeprefix("v").split(".")[0]) < 22 else []


def test_the_lock_file_names_no_registry():
    assert '"resolved"' not in (CLIENT / "package-lock.json").read_text()
