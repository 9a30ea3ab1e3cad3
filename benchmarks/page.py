"""What the page costs the browser: main thread, pictures, memory, and how soon the first picture is there.

python -m benchmarks.page [--source sim:city] [--seconds 30] [--memory-minutes 5] [--compare] [--streams 4]
       [--window 1280x720]

Vehicle and server as processes, the page in a headless Chromium that draws in software (SwiftShader), because there is
no graphics card here: pictures a second and their age are those of a processor that draws, and say nothing of a laptop.
The main thread's work is the same on both. Times of a task are taken twice: on the clock, where a busy machine counts,
and as processor time of the thread, where it does not.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx

from benchmarks.scenes import FRAMING
from lidarcodec.transport.endpoints import free_port

FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-dev-shm-usage", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--enable-precise-memory-info", "--js-flags=--expose-gc",
]  # fmt: skip
CATEGORIES = "toplevel,devtools.timeline"
SCRIPT = {"FunctionCall", "EvaluateScript", "FireAnimationFrame", "TimerFire", "EventDispatch", "RunMicrotasks"}
"""Events of the trace in which script runs; only the outermost of nested ones count."""
LONG_MS = 50.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim:city?packets=34800000")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--memory-minutes", type=float, default=0.0)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--streams", type=int, default=1, help="streams of the vehicle in one picture, with a box")
    parser.add_argument("--window", default="1280x720")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium")
    if program is None:
        raise SystemExit("needs chromium")
    wide, high = (int(part) for part in options.window.split("x"))
    with _system(options.source, options.streams) as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        page = browser.new_page(viewport={"width": wide, "height": high})
        begun = time.monotonic()
        page.goto(url)
        first_s = _until(lambda: "points" in page.title()) - begun
        if options.compare:
            page.get_by_label("Compare").check()
        if options.streams > 1:
            _together(page, options.streams)
        page.wait_for_timeout(5000)
        session = page.context.new_cdp_session(page)
        print(f"first picture         {first_s:.2f} s after the page was asked for")
        still = measure(page, session, options.seconds)
        report("nobody touches it", still)
        page.locator("canvas.lidar-canvas").focus()
        page.keyboard.down("ArrowLeft")
        report("the camera turns", measure(page, session, options.seconds))
        page.keyboard.up("ArrowLeft")
        if options.memory_minutes > 0:
            memory(page, session, 60 * options.memory_minutes)
        browser.close()


def measure(page: Any, session: Any, seconds: float) -> dict[str, Any]:
    """Frames, pictures and tasks of some seconds."""
    events: list[dict[str, Any]] = []
    done: list[bool] = []
    session.on("Tracing.dataCollected", lambda part: events.extend(part["value"]))
    session.on("Tracing.tracingComplete", lambda _: done.append(True))
    session.send(
        "Tracing.start", {"transferMode": "ReportEvents", "traceConfig": {"includedCategories": CATEGORIES.split(",")}}
    )
    shown, ages = _watch(page, seconds)
    session.send("Tracing.end")
    _until(lambda: bool(done) or page.wait_for_timeout(50))
    thread = next(
        (one["pid"], one["tid"])
        for one in events
        if one["name"] == "thread_name" and one["args"].get("name") == "CrRendererMain"
    )
    own = [one for one in events if (one["pid"], one["tid"]) == thread and one.get("ph") == "X"]
    tasks = [one for one in own if one["name"] in ("RunTask", "ThreadControllerImpl::RunTask")]
    script = _outermost([one for one in own if one["name"] in SCRIPT])
    own_script = [one for one in script if _of_the_view(one)]
    return {
        "view_cpu_ms": sum(one.get("tdur", 0) for one in own_script) / 1000,
        "frames": shown["frames"],
        "clouds": shown["clouds"],
        "seconds": seconds,
        "drawn": shown["pictures"],
        "ages": ages,
        "script_ms": sum(one["dur"] for one in script) / 1000,
        "script_cpu_ms": sum(one.get("tdur", 0) for one in script) / 1000,
        "task_cpu_ms": sum(one.get("tdur", 0) for one in _outermost(tasks)) / 1000,
        "tasks": sorted(one["dur"] / 1000 for one in tasks),
        "tasks_cpu": sorted(one.get("tdur", 0) / 1000 for one in tasks),
    }


def _of_the_view(event: dict[str, Any]) -> bool:
    """Whether script ran for a picture, or for a message of a socket; all else comes so often a second by itself."""
    name = str(event["args"].get("data", {}).get("functionName", ""))
    return event["name"] == "FireAnimationFrame" or name.endswith("onmessage")


def report(what: str, found: dict[str, Any]) -> None:
    """A few lines."""
    frames = max(found["frames"], 1)
    long = sum(one > LONG_MS for one in found["tasks"])
    long_cpu = sum(one > LONG_MS for one in found["tasks_cpu"])
    age = f"{statistics.median(found['ages']):.0f} ms" if found["ages"] else "-"
    view = found["view_cpu_ms"] / max(found["clouds"], 1)
    rest = (found["script_cpu_ms"] - found["view_cpu_ms"]) / found["seconds"]
    tasks = found["task_cpu_ms"] / found["seconds"] / 10
    longest = f"{found['tasks_cpu'][-1]:.1f} ms of processor, {found['tasks'][-1]:.1f} ms on the clock"
    lines = [
        f"clouds              {found['clouds']} in {found['seconds']:.0f} s, {frames} of the chosen stream; "
        f"age when shown, median: {age}",
        f"pictures            {found['drawn'] / found['seconds']:.1f} a second, drawn in software",
        f"script              {view + rest / 10:.2f} ms of processor a cloud at 10 Hz: {view:.2f} for its picture,",
        f"                    and a tenth of {rest:.1f} a second for the rest of the page",
        f"main thread         {tasks:.1f} % busy: script, layout and all else",
        f"longest task        {longest}",
        f"tasks over 50 ms    {long_cpu} by processor time, {long} by the clock",
    ]
    print(what, *lines, sep="\n  ", flush=True)


def memory(page: Any, session: Any, seconds: float) -> None:
    """Heap after a collection, array buffers with it, and textures, every half minute."""
    print("memory\n  minute, MB: heap after a collection, textures, resident in page and graphics process")
    end = time.monotonic() + seconds
    begun = time.monotonic()
    while True:
        session.send("HeapProfiler.collectGarbage")
        heap = session.send("Runtime.getHeapUsage")
        backing = heap.get("backingStorageSize", 0)
        print(
            f"  {(time.monotonic() - begun) / 60:.1f}  {(heap['usedSize'] + backing) / 1e6:.2f}"
            f"  {_told(page)['gpu'] / 1e6:.2f}"
            f"  {_resident_mb('renderer'):.0f} + {_resident_mb('gpu-process'):.0f}",
            flush=True,
        )
        if time.monotonic() >= end:
            return
        page.wait_for_timeout(min(30_000, 1000 * max(end - time.monotonic(), 0.1)))


def _told(page: Any) -> dict[str, float]:
    """What the view says of itself, four times a second."""
    return dict(json.loads(page.locator("canvas.lidar-canvas").get_attribute("data-told")))


def _watch(page: Any, seconds: float) -> tuple[dict[str, int], list[float]]:
    """Frames of the chosen stream, clouds of all, pictures, and ages: looked at from outside, four times a second."""
    first = now = _told(page)
    ages, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        page.wait_for_timeout(250)
        now = _told(page)
        if now["age"] is not None:
            ages.append(now["age"])
    shown = {name: int(now[name] - first[name]) for name in ("frames", "clouds", "pictures")}
    return shown, ages


def _outermost(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    end = -1.0
    for one in sorted(events, key=lambda event: (event["ts"], -event["dur"])):
        if one["ts"] >= end:
            found.append(one)
            end = one["ts"] + one["dur"]
    return found


def _resident_mb(kind: str) -> float:
    """Resident memory of the largest Chromium process of a kind, on this machine."""
    found = [0.0]
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if f"--type={kind}" in path.read_bytes().decode(errors="replace"):
                status = (path.parent / "status").read_text()
                found.append(int(status.split("VmRSS:")[1].split()[0]) / 1024)
    return max(found)


def _until(holds: Any, limit_s: float = 120.0) -> float:
    end = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > end:
            raise SystemExit("it took too long")
        time.sleep(0.01)
    return time.monotonic()


def _together(page: Any, streams: int) -> None:
    """Show all streams of the vehicle in one picture, each in its colour, with a box that counts."""
    page.locator("summary", has_text="Streams").click()
    for number in range(1, streams):
        page.get_by_label(f"vehicle/lidar{number}").check()
    page.get_by_label("Colour").select_option("stream")
    page.locator("summary", has_text="Box").click()
    page.get_by_label("Draw only what is in the box").check()
    legend = page.locator(".lidar-streams")
    _until(lambda: page.wait_for_timeout(100) or len(re.findall(r"  [1-9][0-9,]{3,}", legend.inner_text())) == streams)


@contextlib.contextmanager
def _system(source: str, streams: int = 1) -> Iterator[str]:
    """A server and a vehicle with so many sensors, which sit apart; the address of the page."""
    here = dict(os.environ, LIDARCODEC_LOOPBACK_PORT=str(free_port()))
    port = free_port()
    command = [sys.executable, "-m", "lidarcodec.cli"]
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as ends:
        server = [*command, "serve", "--port", str(port), "--database-url", f"sqlite:///{folder}/server.db"]
        vehicle = [*command, "publish", source, "--original", "--set", f"framing={FRAMING}"]
        if source.startswith("sim:"):
            vehicle += ["--poses", "source"]
        others = [
            [*vehicle, "--sensor", f"lidar{number}", "--mount", f"{number},0,0,0,0,{90 * number % 360}"]
            for number in range(1, streams)
        ]
        for words in (server, vehicle, *others):
            process = subprocess.Popen(words, env=here, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            ends.callback(process.wait)
            ends.callback(process.send_signal, signal.SIGTERM)
        url = f"http://127.0.0.1:{port}"
        _until(lambda: _alive(url, streams))
        yield url


def _alive(url: str, streams: int) -> bool:
    try:
        return sum(one["alive"] for one in httpx.get(f"{url}/api/v1/streams", timeout=5).json()) >= streams
    except httpx.HTTPError:
        return False


if __name__ == "__main__":
    main()
