"""Dashboard and alerts, held against what a server that runs exports: an empty panel is worse than none."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import re
import shutil
import subprocess
import time
from urllib.request import urlopen

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.settings import StreamSettings
from tests.images.dockerfile import ROOT
from tests.server.live import frame, running

DOCKER = ROOT / "docker"
DASHBOARD = DOCKER / "grafana" / "dashboards" / "lidarcodec.json"
RULES = yaml.safe_load((DOCKER / "prometheus" / "alerts.yaml").read_text())
SUFFIXES = {"counter": ("_total",), "gauge": ("",), "histogram": ("_bucket", "_sum", "_count")}
OF_PROMETHEUS = {"up": {"job", "instance"}, "ALERTS": {"alertname", "alertstate"}}
LAST = tuple(
    f"lidarcodec_{one}"
    for one in (
        "stream_fps",
        "stream_target_missed",
        "stream_path_kbps",
        "frames_total",
        "latency_seconds_bucket",
        "decode_seconds_bucket",
        "viewers",
    )
)
"""What is told with the first reports and requests."""
OF_THE_TARGET = {"job", "instance", "le"}


def rules():
    return [rule for group in RULES["groups"] for rule in group["rules"]]


def panels():
    return [one for one in json.loads(DASHBOARD.read_text())["panels"] if one["type"] != "row"]


def expressions():
    """Where each stands, and what it says."""
    return [(rule["alert"], rule["expr"]) for rule in rules()] + [
        (panel["title"], target["expr"]) for panel in panels() for target in panel["targets"]
    ]


def selected(expression):
    """Each metric of an expression with the labels that are asked of it; and the labels that are grouped by."""
    bare = re.sub(r'"[^"]*"', '""', expression)
    found = [
        (name, set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", matchers)))
        for name, matchers in re.findall(r"\b((?:lidarcodec|process)_\w+|up|ALERTS)\b(?:\{([^}]*)\})?", bare)
    ]
    grouped = {label for group in re.findall(r"by \(([^)]*)\)", bare) for label in re.split(r",\s*", group)}
    return found, grouped


async def look(server):
    """Be a viewer until everything was told; what was told."""
    end = time.monotonic() + 60.0
    async with server.socket("vehicle/lidar/cloud") as viewer:
        while time.monotonic() < end:
            await frame(viewer)
            await viewer.send("ack")
            names = await asyncio.to_thread(scraped, server)
            if all(names.get(one) for one in LAST):
                break
    return names


def scraped(server):
    """Name of every series with its labels; None for one of which there is none yet."""
    with urlopen(f"{server.url}/metrics", timeout=60) as answer:
        text = answer.read().decode()
    names = {}
    for family in text_string_to_metric_families(text):
        for suffix in SUFFIXES.get(family.type, ()):
            told = [set(one.labels) for one in family.samples if one.name == family.name + suffix]
            names[family.name + suffix] = told[0] if told else None
    return names


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Name of every series of a server with a vehicle, a receiver and viewers, with its labels."""
    settings = StreamSettings(target_kbps=4000.0)
    with running(tmp_path_factory.mktemp("server")) as server, server.publisher(settings=settings):
        assert server.seen()
        with LiveStream("vehicle/lidar", transport=server.network.transport()):
            return asyncio.run(look(server))


def test_the_dashboard_is_what_its_table_makes():
    spec = importlib.util.spec_from_file_location("dashboard", ROOT / "tools" / "dashboard.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert DASHBOARD.read_text() == module.text(), "write it anew: python tools/dashboard.py " + str(
        DASHBOARD.relative_to(ROOT)
    )


@pytest.mark.sweep
def test_every_expression_asks_for_what_the_server_exports(exported):
    for where, expression in expressions():
        found, grouped = selected(expression)
        assert found, where
        for name, asked in found:
            assert name in exported or name in OF_PROMETHEUS, f"{where}: there is no {name}"
            there = OF_PROMETHEUS.get(name, exported.get(name))
            if there is not None:  # None: nothing of it happened yet, so nothing is known of its labels
                assert asked | grouped <= there | OF_THE_TARGET, f"{where}: {name} has {there}"


def test_everything_that_the_server_exports_is_shown_or_watched(exported):
    asked = " ".join(text for _, text in expressions())
    for name in exported:
        if name.startswith("lidarcodec_") and not name.endswith(("_sum", "_count", "_created")):
            assert re.search(rf"\b{name}\b", asked), f"nobody looks at {name}: tools/dashboard.py"


def test_a_mistake_in_an_expression_would_be_found(exported):
    found, grouped = selected('sum by (vehicle, sensors) (rate(lidarcodec_frame_total{vehicle=~"$vehicle"}[1m])) > 0')
    assert found == [("lidarcodec_frame_total", {"vehicle"})]
    assert found[0][0] not in exported
    assert not grouped <= exported["lidarcodec_frames_total"]


def test_legends_name_labels_that_are_there(exported):
    for panel in panels():
        for target in panel["targets"]:
            found, grouped = selected(target["expr"])
            if not grouped and all(exported.get(name, ()) is None for name, _ in found):
                continue  # nothing of it happened yet
            there = grouped or set().union(*(exported.get(name) or set() for name, _ in found))
            assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= there, panel["title"]


def test_panels_lie_beside_each_other_and_ask_the_source_that_is_there():
    dashboard = json.loads(DASHBOARD.read_text())
    provisioned = yaml.safe_load((DOCKER / "grafana/provisioning/datasources/prometheus.yaml").read_text())
    uid = provisioned["datasources"][0]["uid"]
    taken = set()
    for panel in dashboard["panels"]:
        grid = panel["gridPos"]
        cells = {(grid["x"] + x, grid["y"] + y) for x in range(grid["w"]) for y in range(grid["h"])}
        assert not cells & taken, panel["title"]
        assert grid["x"] + grid["w"] <= 24
        taken |= cells
        assert panel["datasource"]["uid"] == uid
        references = [target["refId"] for target in panel.get("targets", [])]
        assert len(set(references)) == len(references)
    identities = [panel["id"] for panel in dashboard["panels"]]
    assert len(set(identities)) == len(identities)
    assert {one["name"] for one in dashboard["templating"]["list"]} == {"vehicle", "sensor"}


def test_every_alert_says_how_bad_it_is_and_about_whom():
    names = [rule["alert"] for rule in rules()]
    assert len(set(names)) == len(names)
    assert {"StreamGone", "TargetMissed", "LatencyHigh", "FramesReplaced", "DecodeErrors", "DatabaseAway"} <= set(names)
    for rule in rules():
        assert rule["labels"]["severity"] in ("critical", "warning")
        assert rule["annotations"]["summary"]


def promtool(*words):
    if shutil.which("promtool") is None:
        pytest.skip("needs promtool (Debian: prometheus)")
    result = subprocess.run(["promtool", *map(str, words)], capture_output=True, text=True, check=False, timeout=100)
    assert result.returncode == 0, result.stdout + result.stderr


def test_prometheus_takes_its_configuration_and_its_rules():
    promtool("check", "config", "--syntax-only", DOCKER / "prometheus" / "prometheus.yaml")
    promtool("check", "rules", DOCKER / "prometheus" / "alerts.yaml")


def test_alerts_come_when_they_should_and_not_otherwise():
    promtool("test", "rules", DOCKER / "prometheus" / "alerts.test.yaml")


def test_prometheus_understands_every_panel(tmp_path):
    texts = [target["expr"].replace("$__rate_interval", "1m") for panel in panels() for target in panel["targets"]]
    made = [{"record": f"panel:{number}", "expr": text} for number, text in enumerate(texts)]
    (tmp_path / "panels.yaml").write_text(yaml.safe_dump({"groups": [{"name": "panels", "rules": made}]}))
    promtool("check", "rules", "--lint=none", tmp_path / "panels.yaml")
