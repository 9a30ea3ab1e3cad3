"""What somebody deletes if these fail: the only copy of frames that a recording does not hold."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest

from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.evaluation.verify import PacketsByTime
from tests.command_line import run_here
from tests.drives import simulated
from tests.packets import turning

FRAMES = 4
SOURCE = f"sim:city?frames={FRAMES}"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture, and recordings of all of it and of parts."""
    folder = tmp_path_factory.mktemp("drive")
    simulated(SOURCE, folder / "drive.pcap")
    for name, words in (
        ("whole", ()), ("begin", ("--frames", 2)), ("end", ("--skip", 1)), ("last", ("--skip", 3)),
        ("first", ("--frames", 1)),
    ):  # fmt: skip
        assert run_here("encode", folder / "drive.pcap", folder / f"{name}.mcap", *words).returncode == 0
    assert (
        run_here("join", folder / "first.mcap", folder / "last.mcap", folder / "hole.mcap", "--allow-gap").returncode
        == 0
    )
    return folder


def test_guides_show_what_is_printed(drive: Path, tmp_path: Path) -> None:
    """They showed lines of an earlier version: "0 identical" where all packets were sent with losses."""
    lossy = tmp_path / "slow.mcap"
    words = ("--codec", "auto", "--set", "target_kbps=800")
    assert run_here("encode", drive / "drive.pcap", lossy, *words).returncode == 0
    printed = run_here("verify", lossy, drive / "drive.pcap").stdout
    guide = (Path(__file__).parents[2] / "docs" / "guides" / "slow-link.md").read_text()
    shown = next(block for block in guide.split("```") if "\ncovered  " in block)
    forms = [re.sub(r"[\d,.]*\d", "N", text).splitlines() for text in (printed, shown.partition("\ncovered")[2])]
    assert [forms[0][0].removeprefix("covered"), *forms[0][1:]] == forms[1]


@pytest.mark.parametrize(
    ("name", "packets", "first", "last", "gaps"),
    [("whole", 1435, 0, 1434, 0), ("begin", 718, 0, 717, 0), ("end", 1076, 359, 1434, 0), ("hole", 717, 0, 1434, 1)],
)
def test_a_recording_that_covers_less_than_its_source_fails(
    drive: Path, name: str, packets: int, first: int, last: int, gaps: int
) -> None:
    words = ("verify", drive / f"{name}.mcap", drive / "drive.pcap")
    result = run_here(*words, "--json")
    found = json.loads(result.stdout)
    assert result.returncode == (0 if name == "whole" else 1), result.stderr
    assert (found["complete"], found["interrupted"], found["packets_identical"]) == (True, False, True)
    covered = found["coverage"]
    assert covered["whole"] is (name == "whole")
    assert covered["source_packets"] == 1435
    assert [covered[key] for key in ("packets", "first", "last", "gaps")] == [packets, first, last, gaps]
    assert (covered["frames"], covered["source_frames"]) == (round(packets / 348, 2), 4.12)
    assert covered["source_first_ns"] <= covered["first_ns"] < covered["last_ns"] <= covered["source_last_ns"]
    assert any("missing" in text for text in found["broken"]) is (name != "whole")
    allowed = run_here(*words, "--allow-part")
    assert allowed.returncode == 0
    assert (f"{packets:,} of 1,435 packets" in allowed.stdout) is (name != "whole")
    assert "BROKEN" not in allowed.stdout


def test_of_a_source_that_was_cut_off_it_is_said_that_the_recording_is_not_the_broken_one(
    drive: Path, tmp_path: Path
) -> None:
    """tcpdump was killed. All that it had written is in the recording, and `verify` said only BROKEN."""
    cut, out = tmp_path / "cut.pcap", tmp_path / "cut.mcap"
    cut.write_bytes((drive / "drive.pcap").read_bytes()[:400_500])
    assert run_here("encode", cut, out, "--set", "max_error_m=0.02").returncode == 0
    result = run_here("verify", out, cut)
    assert result.returncode == 1
    assert "the source itself is cut off or damaged, which says nothing against the recording" in result.stdout
    assert "sent with losses, as the settings allow" in result.stdout
    assert "BROKEN" not in result.stdout, "the word alone sends people to look for damage"
    assert "INCOMPLETE       the source itself" in result.stdout
    assert "kept             all that its messages promise" in result.stdout
    assert run_here("verify", out, cut, "--allow-part").returncode == 0


def test_frames_of_a_group_are_counted_once(drive: Path, tmp_path: Path) -> None:
    """Of four frames in one message `verify` said that 16 had no bound, and that 16 had whole intensities."""
    recording = tmp_path / "group.mcap"
    assert run_here("encode", drive / "drive.pcap", recording, "--codec", "jpeg-layered").returncode == 0
    found = json.loads(run_here("verify", recording, drive / "drive.pcap", "--json").stdout)
    told = json.loads(run_here("info", recording, "--json").stdout)
    assert found["sent"]["without_bound"] == sum(found["sent"]["intensity"].values()) == found["frames"]
    assert found["sent"] == {name: told["sent"][name] for name in found["sent"]}


def test_a_cut_recording_fails_even_if_a_part_is_allowed(drive: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((drive / "whole.mcap").read_bytes()[:-50_000])
    result = run_here("verify", cut, drive / "drive.pcap", "--allow-part")
    assert (result.returncode, "the end of the recording is missing" in result.stdout) == (1, True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_was_found_before_a_signal_is_told_as_a_part(drive: Path, number: signal.Signals) -> None:
    frames = list(RecordedFrames(drive / "whole.mcap"))

    def interrupted(_: RecordedFrames) -> Iterator[object]:
        for at, frame in enumerate(frames):
            if at == 2:
                os.kill(os.getpid(), number)
            yield frame

    words = ("verify", drive / "whole.mcap", drive / "drive.pcap")
    with mock.patch.object(RecordedFrames, "__iter__", interrupted):
        result = run_here(*words, "--json")
        text = run_here(*words)
    found = json.loads(result.stdout)
    assert result.returncode == text.returncode == 128 + number
    assert (found["complete"], found["interrupted"], found["frames"], found["coverage"]) == (False, True, 2, None)
    assert "only the first 2 frames" in result.stderr
    assert text.stdout.startswith("INTERRUPTED")


def test_a_signal_while_the_rest_of_the_source_is_counted_is_one_too() -> None:
    packets = PacketsByTime(turning(60))
    assert packets.take(turning(60)[0], 10) is not None
    assert packets.coverage(lambda: True) is None
    packets = PacketsByTime(turning(60))
    assert packets.take(turning(60)[5], 10) is not None
    found = packets.coverage()
    assert found is not None
    assert found[:4] == (10, 60, 5, 14)
    nothing = PacketsByTime([]).coverage()
    assert nothing is not None
    assert nothing.whole


@pytest.mark.sweep
def test_bench_that_is_stopped_prints_what_it_has_and_that_there_is_more(drive: Path, tmp_path: Path) -> None:
    calls: list[object] = []

    def interrupted(*given: object, **more: object) -> dict[str, object]:
        calls.append(given)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return bench(*given, **more)  # type: ignore[arg-type]

    with mock.patch("lidarcodec.commands.bench.command.bench", interrupted):
        result = run_here(
            "bench", drive / "drive.pcap", "--codec", "raw,zstd,pcodec", "--frames", 1, "--json", "--plot",
            tmp_path / "bench.png",
        )  # fmt: skip
    found = json.loads(result.stdout)
    assert result.returncode == 143
    assert [entry.get("codec") for entry in found] == ["raw", None]
    assert found[-1] == {"complete": False, "interrupted": True, "done": 1, "wanted": 3}
    assert "has only 1 of 3 settings" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bench.partial.png"]
