"""Recording on the vehicle: everything is kept whatever is sent, and a slow disk costs recording, never the stream."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.apps.recorder import WAITING, BackgroundRecorder, Record
from lidarcodec.assembly import packets_of
from lidarcodec.commands.unkept import check_recorded
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.recording import RecordingReader, RotatingRecorder
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec.wire import unpack
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually


def payloads_of(folder: Path) -> list[bytes]:
    """Payloads of all recordings of a folder, packets or messages, in order."""
    found = []
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as file:
            reader = RecordingReader(file)
            found += [packet.payload for packet in reader.packets()]
            decoder = StreamDecoder()
            for _, data in reader.messages():
                found += [p.payload for frame in decoder.decode(unpack(data)) for p in packets_of(frame)]
    return found


@pytest.mark.parametrize("record_as", ["packets", "lossless"])
def test_the_vehicle_keeps_every_packet_while_another_quality_is_sent(tmp_path, record_as):
    network = MemoryNetwork()
    settings = StreamSettings(max_error_m=0.1, intensity="off")
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("vehicle/lidar", transport=far, newest=False, until_end=True) as stream,
    ):
        car = Publisher(Loop(6), settings, transport=near, rate="max", record=Record(tmp_path / "kept", record_as))
        with car:
            sent = sum(1 for _ in stream)
        state = car.status()["recording"]
    assert sent == 6
    assert payloads_of(tmp_path / "kept") == Loop(6).payloads()
    assert "dropped" not in state["counts"]
    assert state["stopped"] is None


def test_it_records_without_anybody_on_the_network(tmp_path):
    with MemoryNetwork().transport() as near:
        Publisher(Loop(4), transport=near, rate=60.0, record=tmp_path).run()
    assert payloads_of(tmp_path) == Loop(4).payloads()


def test_what_was_read_last_is_kept_when_a_publisher_is_stopped(tmp_path):
    class Halts(Loop):
        """A live sensor that falls silent in the middle of a batch."""

        def packets(self):
            yield from list(Loop(1).packets())[:100]
            self._stop.wait(60)
            yield from list(Loop(1).packets())[100:101]

    with (
        MemoryNetwork().transport() as near,
        Publisher(Halts(), transport=near, rate="max", record=str(tmp_path)) as car,
    ):
        assert eventually(lambda: car.status()["packets"] == 100)
    assert payloads_of(tmp_path)[:100] == Loop(1).payloads()[:100]


def test_a_fault_costs_one_item_and_not_the_recording(tmp_path, monkeypatch):
    recorder = BackgroundRecorder(tmp_path, StreamKeys())
    write, broken = recorder._files.write_packets, [True]
    monkeypatch.setattr(
        recorder._files, "write_packets", lambda batch: 1 / 0 if broken and broken.pop() else write(batch)
    )
    batch = list(Loop(1).packets())
    recorder.start()
    recorder.packets(batch)
    recorder.packets(batch)
    recorder.close()
    assert recorder.state()["counts"]["errors"] == 1
    assert payloads_of(tmp_path) == Loop(1).payloads()


def test_a_subscriber_keeps_the_messages_as_they_came(tmp_path):
    network = MemoryNetwork()
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("vehicle/lidar", transport=far, newest=False, until_end=True, record=tmp_path) as stream,
        Publisher(Loop(5), transport=near, rate="max"),
    ):
        assert sum(1 for _ in stream) == 5
    assert payloads_of(tmp_path) == Loop(5).payloads()


def test_what_the_disk_cannot_take_is_dropped_and_counted(tmp_path):
    recorder = BackgroundRecorder(tmp_path, StreamKeys())
    source = Loop(1)
    batch = list(source.packets())[:2]
    for _ in range(WAITING + 7):  # nobody writes yet: the disk stands still
        recorder.packets(batch)
    recorder.start()
    recorder.close()
    recorder.close()
    assert recorder.state()["counts"]["dropped"] == 7
    assert len(payloads_of(tmp_path)) == 2 * WAITING


def test_what_still_waits_for_the_disk_at_the_end_is_an_error(tmp_path, monkeypatch):
    """The exit code said that all was recorded."""
    monkeypatch.setattr("lidarcodec.apps.recorder.CLOSE_LIMIT_S", 0.2)
    written, going = RotatingRecorder.write_packets, threading.Event()
    monkeypatch.setattr(RotatingRecorder, "write_packets", lambda *given: going.wait(30) and written(*given))
    recorder = BackgroundRecorder(tmp_path, StreamKeys())
    for packet in list(Loop(1).packets())[:5]:
        recorder.packets([packet])
    recorder.start()
    recorder.close()
    with pytest.raises(SourceError, match="the disk was too slow"):
        check_recorded({"car/roof": recorder.state()})
    going.set()
    recorder.close()
    check_recorded({"car/roof": recorder.state()})


def test_a_folder_that_cannot_be_written_is_reported_in_the_status_and_the_stream_goes_on(tmp_path):
    (tmp_path / "file").write_text("in the way")
    network = MemoryNetwork()
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("vehicle/lidar", transport=far, newest=False, until_end=True) as stream,
    ):
        with Publisher(Loop(4), transport=near, rate="max", record=tmp_path / "file") as car:
            assert sum(1 for _ in stream) == 4
        assert car.status()["recording"]["stopped"]
        assert car.status()["errors"] == {}


def test_limits_that_cannot_be_kept_are_refused_before_anything_starts(tmp_path):
    with MemoryNetwork().transport() as near, pytest.raises(SettingsError):
        Publisher(Loop(1), transport=near, record=Record(tmp_path, limits={"max_file_bytes": 1}))


def test_nothing_that_is_no_message_gets_into_a_recording(tmp_path, caplog):
    recorder = BackgroundRecorder(tmp_path, StreamKeys())
    recorder.start()
    for data in (b"", b"noise" * 100):
        recorder.message(data)
    recorder.close()
    assert recorder.state()["counts"]["errors"] == 2
    assert not list(tmp_path.glob("*.mcap"))
