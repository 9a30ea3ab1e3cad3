"""Writes the Grafana dashboard of a fleet, from the table of panels below.

    python tools/dashboard.py docker/grafana/dashboards/lidarcodec.json

tests/images/test_metrics.py holds every expression against what a running server exports, and the file against
this table.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

WIDTH = 24
"""Columns of Grafana's grid."""
OF = '{vehicle=~"$vehicle", sensor=~"$sensor"}'
WINDOW = "[$__rate_interval]"
STREAM = "{{vehicle}}/{{sensor}}"
SOURCE = {"type": "prometheus", "uid": "prometheus"}


def rate(metric: str) -> str:
    """Of a counter of the chosen streams, a second."""
    return f"rate({metric}{OF}{WINDOW})"


def quantile(q: float, metric: str) -> str:
    """Of a histogram of the chosen streams, for each."""
    return f"histogram_quantile({q}, sum by (vehicle, sensor, le) ({rate(metric + '_bucket')}))"


def target(expression: str, legend: str) -> dict[str, Any]:
    """A line of a panel."""
    return {"datasource": SOURCE, "expr": expression, "legendFormat": legend}


def both(metric: str) -> list[dict[str, Any]]:
    """Median and 99th percentile."""
    return [target(quantile(q, metric), f"{STREAM} {name}") for q, name in ((0.5, "p50"), (0.99, "p99"))]


def each(metric: str, legend: str = STREAM) -> list[dict[str, Any]]:
    """A gauge of the chosen streams."""
    return [target(f"{metric}{OF}", legend)]


def share(part: str) -> list[dict[str, Any]]:
    """Frames that were not sent, of all of them."""
    all_of_them = " + ".join(
        rate(f"lidarcodec_{one}frames_total") for one in ("", "replaced_", "no_receiver_", "left_out_")
    )
    return [target(f"{rate(f'lidarcodec_{part}_frames_total')} / ({all_of_them})", STREAM)]


def errors() -> list[dict[str, Any]]:
    """What went wrong, in the window."""
    names = ("decode_errors", "missing_references", "missing_frames", "encode_errors", "put_errors")
    names += ("lost_packets", "kernel_drops", "queue_drops", "unrecorded_frames", "unkept_frames", "publisher_restarts")
    return [target(f"increase(lidarcodec_{one}_total{OF}[$__rate_interval])", f"{STREAM} {one}") for one in names]


def stat(
    title: str, targets: list[dict[str, Any]], red_below: float | None = None, red_from: float | None = None
) -> Any:
    """A number, red below or from a limit on."""
    steps = [{"color": "red" if red_below is not None else "green", "value": None}]
    if red_below is not None:
        steps.append({"color": "green", "value": red_below})
    if red_from is not None:
        steps.append({"color": "red", "value": red_from})
    return {
        "type": "stat",
        "title": title,
        "size": (4, 4),
        "targets": targets,
        "fieldConfig": {"defaults": {"thresholds": {"mode": "absolute", "steps": steps}}, "overrides": []},
        "options": {"reduceOptions": {"calcs": ["lastNotNull"]}, "colorMode": "background", "graphMode": "none"},
    }


def graph(title: str, unit: str, targets: list[dict[str, Any]], note: str = "") -> dict[str, Any]:
    """Lines over time, from zero."""
    return {
        "type": "timeseries",
        "title": title,
        "description": note,
        "size": (8, 8),
        "targets": targets,
        "fieldConfig": {"defaults": {"unit": unit, "min": 0, "custom": {"fillOpacity": 5}}, "overrides": []},
        "options": {"legend": {"displayMode": "list", "placement": "bottom"}, "tooltip": {"mode": "multi"}},
    }


def row(title: str) -> dict[str, Any]:
    """A heading."""
    return {"type": "row", "title": title, "size": (WIDTH, 1), "collapsed": False, "panels": []}


HTTP = "lidarcodec_http_request"
PANELS = (
    stat("Streams alive", [target("sum(lidarcodec_stream_alive)", "")], red_below=1),
    stat("Streams gone", [target("count(lidarcodec_stream_alive == 0) or vector(0)", "")], red_from=1),
    stat("Database", [target('lidarcodec_ready{part="store"}', "")], red_below=1),
    stat("Network session", [target('lidarcodec_ready{part="zenoh"}', "")], red_below=1),
    stat("Viewers", [target("sum(lidarcodec_viewers) or vector(0)", "")]),
    stat("Alerts", [target('count(ALERTS{alertstate="firing"}) or vector(0)', "")], red_from=1),
    row("Streams"),
    graph("Frames sent", "hertz", each("lidarcodec_stream_fps"), "An HDL-64 turns ten times a second."),
    graph(
        "Bitrate and target", "Kbits",
        each("lidarcodec_stream_kbps", STREAM + " sent") + each("lidarcodec_stream_target_kbps", STREAM + " target"),
    ),
    graph(
        "What the path carries", "Kbits",
        each("lidarcodec_stream_path_kbps", STREAM + " at once")
        + each("lidarcodec_stream_path_sustained_kbps", STREAM + " for long"),
        "Seen only while a stream is sent.",
    ),
    graph("Target missed", "bool", each("lidarcodec_stream_target_missed"), "More is sent, or frames are left out."),
    graph("Bound of ranges", "lengthm", each("lidarcodec_stream_bound_meters"), "0 is exact."),
    graph("Returns sent", "percentunit", each("lidarcodec_stream_kept_ratio"), "Of those measured."),
    graph("Intensity", "none", each("lidarcodec_stream_intensity_levels"), "Values sent: 256 is exact, 0 none."),
    graph("Codec", "none", each("lidarcodec_stream_codec", STREAM + " {{codec}}"), "1 for the codec in force."),
    graph("Latency", "s", both("lidarcodec_latency_seconds"), "From a frame's last packet to the decoded frame."),
    graph("Encoding", "s", both("lidarcodec_encode_seconds"), "At the vehicle; a frame comes every 0.1 s."),
    graph("Decoding", "s", both("lidarcodec_decode_seconds"), "At receivers."),
    graph("Handing to the network", "s", both("lidarcodec_put_seconds")),
    graph("Replaced by newer frames", "percentunit", share("replaced"), "The path, or the processor, is too slow."),
    graph("Not encoded: nobody receives", "percentunit", share("no_receiver")),
    graph("Not encoded: the target does not carry it", "percentunit", share("left_out")),
    graph("Sent", "Bps", [target(rate("lidarcodec_bytes_total"), STREAM)]),
    graph(
        "Messages and key frames", "ops",
        [
            target(rate("lidarcodec_messages_total"), STREAM),
            target(rate("lidarcodec_key_frames_total"), f"{STREAM} key"),
        ],
    ),
    graph("Decoded by receivers", "hertz", [target(rate("lidarcodec_received_frames_total"), STREAM)]),
    graph("Errors and losses", "none", errors()),
    graph(
        "Nothing is recorded or kept", "bool",
        each("lidarcodec_stream_recording_stopped", STREAM + " recording")
        + each("lidarcodec_stream_past_stopped", STREAM + " past"),
        "Nearly always a full disk of the vehicle.",
    ),
    row("Server"),
    graph("Requests", "reqps", [target(f"sum by (status) (rate({HTTP}s_total[$__rate_interval]))", "{{status}}")]),
    graph(
        "Time of a request, p99", "s",
        [target(f"histogram_quantile(0.99, sum by (route, le) (rate({HTTP}_seconds_bucket{WINDOW})))", "{{route}}")],
    ),
    graph(
        "Tokens refused", "ops",
        [target("sum by (reason) (rate(lidarcodec_auth_failures_total[$__rate_interval]))", "{{reason}}")],
    ),
    graph("Viewers", "none", [target(f"lidarcodec_viewers{OF}", f"{STREAM} {{{{kind}}}}")]),
    graph(
        "Frames to viewers", "hertz",
        [
            target("rate(lidarcodec_viewer_sent_total[$__rate_interval])", "{{kind}} sent"),
            target("rate(lidarcodec_viewer_skipped_total[$__rate_interval])", "{{kind}} skipped"),
        ],
    ),
    graph("Bytes to viewers", "Bps", [target(f"rate(lidarcodec_viewer_sent_bytes_total{WINDOW})", "{{kind}}")]),
    graph(
        "Making a frame ready for viewers", "s",
        [target(f"lidarcodec_viewer_pack_{q}_seconds", q) for q in ("p50", "p99")],
    ),
    graph(
        "Viewers and streams turned away", "none",
        [
            target("increase(lidarcodec_viewers_refused_total[$__rate_interval])", "no room for a viewer"),
            target("increase(lidarcodec_viewers_ended_total[$__rate_interval])", "sent away: {{reason}}"),
            target("increase(lidarcodec_streams_left_out_total[$__rate_interval])", "no room for a stream"),
            target(
                "sum by (vehicle) (increase(lidarcodec_vehicle_streams_left_out_total[$__rate_interval]))",
                "of which {{vehicle}}",
            ),
            target("increase(lidarcodec_statuses_refused_total[$__rate_interval])", "statuses refused"),
            target("increase(lidarcodec_status_fields_dropped_total[$__rate_interval])", "status fields dropped"),
        ],
    ),
    graph(
        "Connections", "none",
        [
            target("lidarcodec_connections", "open"),
            target("increase(lidarcodec_connections_ended_total[$__rate_interval])", "ended: {{reason}}"),
        ],
    ),
    graph(
        "Recordings and playbacks", "none",
        [
            target("lidarcodec_recordings_running", "recordings"),
            target("lidarcodec_playbacks_running", "playbacks"),
            target("increase(lidarcodec_recordings_ended_total[$__rate_interval])", "recordings ended: {{reason}}"),
        ],
    ),
    graph(
        "Processor", "percentunit",
        [target('rate(process_cpu_seconds_total{job="lidarcodec"}[$__rate_interval])', "server")],
    ),
    graph("Memory", "bytes", [target('process_resident_memory_bytes{job="lidarcodec"}', "server")]),
    graph("Open files", "none", [target('process_open_fds{job="lidarcodec"}', "server")]),
)  # fmt: skip


def placed() -> list[dict[str, Any]]:
    """The panels on the grid, from left to right and down."""
    found, x, y, height = [], 0, 0, 0
    for number, panel in enumerate(PANELS, 1):
        wide, high = panel["size"]
        if x + wide > WIDTH:
            x, y, height = 0, y + height, 0
        grid = {"x": x, "y": y, "w": wide, "h": high}
        rest = {name: value for name, value in panel.items() if name != "size"}
        lines = [one | {"refId": chr(ord("A") + place)} for place, one in enumerate(panel.get("targets", []))]
        found.append(
            rest | {"id": number, "gridPos": grid, "datasource": SOURCE} | ({"targets": lines} if lines else {})
        )
        x, height = x + wide, max(height, high)
    return found


def variable(label: str) -> dict[str, Any]:
    """A choice of vehicles or sensors above the panels."""
    query = f"label_values(lidarcodec_stream_alive, {label})"
    return {
        "type": "query", "name": label, "label": label.capitalize(), "datasource": SOURCE, "query": query, "refresh": 2,
        "includeAll": True, "multi": True, "allValue": ".*", "sort": 1,
        "current": {"text": ["All"], "value": ["$__all"]},
    }  # fmt: skip


def dashboard() -> dict[str, Any]:
    """All of it."""
    return {
        "uid": "lidarcodec",
        "title": "lidarcodec",
        "tags": ["lidarcodec"],
        "schemaVersion": 39,
        "editable": True,
        "graphTooltip": 1,
        "refresh": "5s",
        "time": {"from": "now-15m", "to": "now"},
        "timezone": "browser",
        "templating": {"list": [variable("vehicle"), variable("sensor")]},
        "annotations": {"list": []},
        "panels": placed(),
    }


def text() -> str:
    """As it is kept: a line for each panel, so that a change of one is a change of one line."""
    whole = dashboard()
    lines = ",\n".join("  " + json.dumps(panel, separators=(", ", ": ")) for panel in whole.pop("panels"))
    rest = json.dumps(whole, indent=1)[:-2]
    return f'{rest},\n "panels": [\n{lines}\n ]\n}}\n'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(text())
