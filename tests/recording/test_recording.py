"""A recording is often all that is left of a drive: it must open anywhere, and a cut one must give what it has."""

from __future__ import annotations

import io
import json
import logging

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, HeaderError, PacketError, SectionError, SettingsError, SourceError
from lidarcodec.message import Message, Section
from lidarcodec.packet import Packet
from lidarcodec.recording import MESSAGE_ENCODING, RecordingReader, RecordingWriter, read_recording, records
from lidarcodec.recording.layout import batches_of, pack_batch, unpack_batch
from lidarcodec.settings import StreamSettings
from tests.contracts import frames
from tests.sweeps import ALL, examples

TENTH = 100_000_000


def message(index: int, key: bool, size: int = 40, stamp_ns: int | None = None, stream: int = 9) -> bytes:
    """A message without meaning, of a tenth of a second."""
    stamp = 10**18 + index * TENTH if stamp_ns is None else stamp_ns
    return wire.pack(Message(3, stream, index, stamp, key, 0, 0, (Section(1, bytes([index % 256]) * size),)))


def packet(number: int) -> Packet:
    """A payload of its own for each number."""
    return Packet(number.to_bytes(4, "little") * 301 + b"\0\0", 10**18 + number * 288_000)


def drive(count: int = 30, interval: int = 7) -> list[bytes]:
    """Messages with a key message every `interval`."""
    return [message(index, index % interval == 0) for index in range(count)]


def recorded(data: list[bytes], **values: object) -> bytes:
    """A whole recording of messages."""
    file = io.BytesIO()
    with RecordingWriter(file, "truck", "roof", **values) as writer:  # type: ignore[arg-type]
        for one in data:
            writer.write(one)
    return file.getvalue()


def test_any_mcap_reader_opens_a_recording() -> None:
    data = drive()
    file = recorded(data, settings=StreamSettings(max_error_m=0.02), metadata={"source": "test"})
    reader = make_reader(io.BytesIO(file), validate_crcs=True)
    found = list(reader.iter_messages())
    assert [one.data for _, _, one in found] == data
    assert {channel.topic for _, channel, _ in found} == {"lidarcodec/v1/truck/roof/frame"}
    assert {channel.message_encoding for _, channel, _ in found} == {MESSAGE_ENCODING}
    assert [one.log_time for _, _, one in found] == [10**18 + index * TENTH for index in range(30)]
    assert [one.sequence for _, _, one in found] == list(range(30))
    about = next(iter(reader.iter_metadata())).metadata
    assert (about["vehicle"], about["sensor"], about["format"], about["source"]) == ("truck", "roof", "1.0", "test")
    assert json.loads(about["settings"])["max_error_m"] == 0.02


def test_what_was_written_comes_back() -> None:
    data = drive()
    reader = RecordingReader(io.BytesIO(recorded(data)))
    assert reader.metadata["vehicle"] == "truck"
    assert [one for _, one in reader.messages()] == data
    assert [stamp for stamp, _ in reader.messages()] == [10**18 + index * TENTH for index in range(30)]
    assert not reader.counts


@pytest.mark.drawn
def test_a_recording_cut_at_any_byte_gives_every_whole_message_before_the_cut(caplog: pytest.LogCaptureFixture) -> None:
    data = [*drive(5, 2), message(5, True, size=0), message(6, False, size=300)]
    file = recorded(data)
    ends = [file.index(one) + len(one) for one in data]
    near = {end + more for end in ends for more in range(-9, 10)}
    for cut in (cut for cut in range(len(file)) if ALL or cut % 5 == 0 or cut in near):
        caplog.clear()
        reader = RecordingReader(io.BytesIO(file[:cut])) if cut else None
        if reader is None:
            with pytest.raises(SourceError):
                RecordingReader(io.BytesIO(b""))
            continue
        came = [one for _, one in reader.messages()]
        assert came == data[: sum(end <= cut for end in ends)], cut
        finished = cut >= file.rindex(data[-1]) + len(data[-1]) and reader.counts["cut"] == 0
        assert finished or reader.counts["bytes lost"] <= max(map(len, data)) + 200
        assert len(caplog.records) == reader.counts["cut"]


def test_a_recording_that_ends_in_zeros_gives_what_is_before_them() -> None:
    """What a file system leaves after a loss of power."""
    data = drive(9)
    file = recorded(data)
    reader = RecordingReader(io.BytesIO(file[: file.index(data[5])] + bytes(100_000)))
    assert [one for _, one in reader.messages()] == data[:5]
    assert reader.counts["cut"] == 1


def test_what_lies_behind_the_end_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """`cat a.mcap b.mcap > both.mcap && rm a.mcap b.mcap` lost all of b without a word."""
    first, second = recorded(drive(9)), recorded(drive(5))
    reader = RecordingReader(io.BytesIO(first + second))
    assert [one for _, one in reader.messages()] == drive(9)
    assert (reader.counts["damaged"], reader.counts["bytes lost"]) == (1, len(second))
    assert "lidarcodec join" in caplog.text
    whole = RecordingReader(io.BytesIO(first))
    assert [one for _, one in whole.messages()] == drive(9)
    assert not whole.counts


@pytest.mark.parametrize("cut", [False, True])
def test_seeking_begins_at_a_key_message(cut: bool) -> None:
    data = drive(30, 7)
    file = recorded(data)
    if cut:  # without its index
        file = file[: file.rindex(data[-1]) + len(data[-1])]
    reader = RecordingReader(io.BytesIO(file))
    for seconds, first in ((-5.0, 0), (0.0, 0), (0.65, 0), (0.7, 7), (1.35, 7), (2.0, 14), (2.9, 28), (100.0, 28)):
        came = [one for _, one in reader.messages(10**18 + round(seconds * 10**9))]
        assert came == data[first:], seconds
        assert wire.peek(came[0]).key


def test_seeking_with_a_damaged_index_still_works() -> None:
    data = drive(20, 5)
    file = bytearray(recorded(data))
    start = int.from_bytes(file[-8 - 20 : -8 - 12], "little")
    at = file.index(bytes([8]), start)
    file[at + 9 + 16 : at + 9 + 24] = b"\xff" * 8
    came = [one for _, one in RecordingReader(io.BytesIO(bytes(file))).messages(10**18 + 12 * TENTH)]
    assert came == data[10:]


def test_messages_that_came_late_are_read_in_the_order_in_which_they_were_sent() -> None:
    """A codec that predicts decodes no frame before the one that it needs."""
    sent = drive(20)
    for late, by in ((3, 3), (10, 8), (19, 8)):
        came = sent[: late - by] + sent[late - by + 1 : late + 1] + [sent[late - by]] + sent[late + 1 :]
        assert [data for _, data in read_recording(io.BytesIO(recorded(came)))] == sent


@pytest.mark.parametrize("late", [9, 15])
def test_a_message_too_late_to_be_sorted_is_told(late: int, caplog: pytest.LogCaptureFixture) -> None:
    """Time goes back there, and a codec that predicts cannot decode it: without a word nobody would know why."""
    sent = drive(25)
    came = [*sent[:4], *sent[5 : 5 + late], sent[4], *sent[5 + late :]]
    reader = RecordingReader(io.BytesIO(recorded(came)))
    found = [wire.peek(data).frame_index for _, data in reader.messages()]
    assert sorted(found) == list(range(25))
    assert found != sorted(found)
    assert reader.counts["late messages"] >= 1
    assert "too late to be sorted" in caplog.text


def test_a_stream_that_begins_again_stays_behind_its_earlier_run() -> None:
    runs = [message(index, index == 0, stream=9) for index in range(300, 310)]
    runs += [message(index, index == 0, stream=9) for index in range(5)]
    runs += [message(index, index == 0, stream=10) for index in range(3)]
    assert [data for _, data in read_recording(io.BytesIO(recorded(runs)))] == runs


def test_raw_packets_come_back_with_their_stamps() -> None:
    sent = [packet(number) for number in range(100)]
    file = io.BytesIO()
    with RecordingWriter(file, "truck", "roof") as writer:
        for at in range(0, 100, 30):
            writer.write_packets(sent[at : at + 30])
        writer.write_packets([])
        writer.write(message(0, True))
    reader = RecordingReader(file)
    assert list(reader.packets()) == sent
    assert list(reader.packets(sent[65].stamp_ns)) == sent[60:]
    assert len(list(reader.messages())) == 1
    assert [one.number for one in reader.channels.values()] == [1, 2]


def test_a_batch_of_packets_is_checked() -> None:
    with pytest.raises(SectionError):
        pack_batch([])
    with pytest.raises(PacketError, match="the limit is 65507"):
        pack_batch([Packet(bytes(65_508), 0), packet(1)])
    with pytest.raises(PacketError, match="the limit is 33554432"):
        pack_batch([Packet(bytes(2**25 + 1), 0)])
    data = pack_batch([packet(1), packet(2)])
    for wrong in (b"", data[:-1], data + b"\0", b"\0\0\0\0", b"\xff\xff\xff\xff" + data[4:]):
        with pytest.raises(SectionError):
            unpack_batch(wrong)


def test_a_batch_has_packets_of_any_size() -> None:
    sizes = (0, 1, 48, 1206, 8448, 65_507)
    sent = [Packet(bytes([k]) * size, 10**18 + k) for k, size in enumerate(sizes)]
    assert unpack_batch(pack_batch(sent)) == sent
    mixed = [sent[0], Packet(b"gps", 10**18, position=True), *sent[1:], Packet(b"", 10**18 + 9, position=True)]
    assert unpack_batch(pack_batch(mixed)) == mixed


def test_messages_of_point_clouds_are_batches_of_their_own() -> None:
    sent = [packet(1), Packet(bytes(65_508), 10**18), Packet(bytes(100_000), 10**18 + 1), packet(2), packet(3)]
    batches = batches_of(sent)
    assert [len(batch) for batch in batches] == [1, 1, 1, 2]
    assert [one for batch in batches for one in unpack_batch(pack_batch(batch))] == sent
    assert batches_of([]) == []


def test_recordings_of_other_tools_are_read() -> None:
    """`mcap compress` and `mcap recover` write larger, compressed chunks."""
    data = drive(40, 6)
    for compression in (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE):
        for chunked in (True, False):
            file = io.BytesIO()
            writer = Writer(
                file, chunk_size=700, compression=compression, use_chunking=chunked, index_types=IndexType.ALL
            )
            writer.start()
            other = writer.register_channel("imu", "json", 0)
            channel = writer.register_channel("lidarcodec/v1/a/b/frame", MESSAGE_ENCODING, 0)
            for index, one in enumerate(data):
                writer.add_message(other, 10**18 + index * TENTH, b"{}", 0)
                writer.add_message(channel, 10**18 + index * TENTH, one, 0)
            writer.finish()
            reader = RecordingReader(file)
            assert [one for _, one in reader.messages()] == data
            assert [one for _, one in reader.messages(10**18 + 20 * TENTH)] == data[18:]
            assert not reader.counts


def test_two_sensors_in_one_file_are_told_apart_by_topic() -> None:
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start()
    for name in ("left", "right"):
        channel = writer.register_channel(f"lidarcodec/v1/truck/{name}/frame", MESSAGE_ENCODING, 0)
        writer.add_message(channel, 5, message(len(name), True), 5)
    writer.finish()
    reader = RecordingReader(file)
    assert [one for _, one in reader.messages()] == [message(4, True)]
    assert [one for _, one in reader.messages(topic="lidarcodec/v1/truck/right/frame")] == [message(5, True)]
    assert list(reader.messages(topic="lidarcodec/v1/truck/top/frame")) == []


def test_what_other_tools_put_together_is_read_whole_or_said_to_be_left_out(caplog: pytest.LogCaptureFixture) -> None:
    """`mcap merge` gives each file a channel of its own; all but the first were left out without a word."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start()
    for number, name in enumerate(("left", "left", "right")):
        channel = writer.register_channel(f"lidarcodec/v1/truck/{name}/frame", MESSAGE_ENCODING, 0, {"n": str(number)})
        writer.add_message(channel, 5 + number, message(number, True), 5)
    writer.finish()
    reader = RecordingReader(file)
    assert [one for _, one in reader.messages()] == [message(0, True), message(1, True)]
    assert reader.counts["other topics"] == 1
    assert "?topic=lidarcodec/v1/truck/right/frame reads them" in caplog.text


@pytest.mark.parametrize("damage", ["opcode", "length"])
def test_damage_in_a_chunk_without_a_checksum_is_counted(damage: str) -> None:
    data, file = drive(5), io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    channel = writer.register_channel("lidarcodec/v1/truck/roof/frame", MESSAGE_ENCODING, 0)
    for index, one in enumerate(data):
        writer.add_message(channel, index, one, index)
    writer.finish()
    whole = bytearray(file.getvalue())
    record = whole.index(data[2]) - 22 - 9
    whole[record if damage == "opcode" else record + 4] = 0 if damage == "opcode" else 1
    reader = RecordingReader(io.BytesIO(bytes(whole)))
    assert [one for _, one in reader.messages()] == data[:2]
    assert reader.counts["damaged"] == 1


def test_damage_in_the_middle_costs_that_message_only(caplog: pytest.LogCaptureFixture) -> None:
    data = drive(12)
    file = bytearray(recorded(data))
    for one in (data[3], data[8]):
        file[file.index(one) + 60] ^= 0x10
    reader = RecordingReader(io.BytesIO(bytes(file)))
    assert [one for _, one in reader.messages()] == data[:3] + data[4:8] + data[9:]
    assert reader.counts["damaged"] == 2
    assert len(caplog.records) == 1, "warned once, with the rest counted"


@pytest.mark.parametrize("kind", [*(6 ^ 1 << bit for bit in range(8)), 15])
def test_a_chunk_that_damage_makes_something_else_is_counted(kind: int) -> None:
    """What is unknown is skipped, as MCAP wants it, and the end of the data is the end: nobody was told."""
    data = drive(12)
    file = bytearray(recorded(data))
    chunks = [record.offset for record in records.records(io.BytesIO(bytes(file)), 8, len(file)) if record.opcode == 6]
    file[chunks[4]] = kind
    reader = RecordingReader(io.BytesIO(bytes(file)))
    found = [one for _, one in reader.messages()]
    assert found == (data[:4] if kind in (2, 15) else data[:4] + data[5:])
    assert reader.counts["damaged"] == 1


def test_channels_of_a_damaged_chunk_are_read_in_the_summary() -> None:
    data, file = drive(12), io.BytesIO()
    writer = Writer(file, chunk_size=300, compression=CompressionType.NONE)
    writer.start()
    channel = writer.register_channel("lidarcodec/v1/truck/roof/frame", MESSAGE_ENCODING, 0)
    for index, one in enumerate(data):
        writer.add_message(channel, index, one, index)
    writer.finish()
    whole = bytearray(file.getvalue())
    whole[whole.index(data[0]) + 60] ^= 0x10
    reader = RecordingReader(io.BytesIO(bytes(whole)))
    found = [one for _, one in reader.messages()]
    assert 0 < len(found) < 12
    assert found == data[-len(found) :]
    assert reader.counts["damaged"] == 1


@pytest.mark.drawn
def test_mutated_recordings_give_messages_or_nothing() -> None:
    rng = np.random.default_rng(3)
    logging.getLogger("lidarcodec.recording.reader").disabled = True
    try:
        file = recorded(drive(6, 3))
        for _ in range(examples(600)):
            mutant = bytearray(file)
            for _ in range(int(rng.integers(1, 6))):
                mutant[int(rng.integers(8, len(mutant)))] = int(rng.integers(256))
            reader = RecordingReader(io.BytesIO(bytes(mutant)))
            for stamp_ns in (None, 10**18 + 4 * TENTH):
                assert len(list(reader.messages(stamp_ns))) <= 6
                assert not list(reader.packets(stamp_ns))
    finally:
        logging.getLogger("lidarcodec.recording.reader").disabled = False


def test_other_files_are_refused() -> None:
    for data in (b"", b"\xa1\xb2\xc3\xd4 a pcap", b"PK\3\4"):
        with pytest.raises(SourceError, match="not a recording"):
            read_recording(io.BytesIO(data))


def test_only_messages_and_proper_names_are_recorded() -> None:
    for names in (("a/b", "roof"), ("truck", "")):
        with pytest.raises(SettingsError):
            RecordingWriter(io.BytesIO(), *names)
    writer = RecordingWriter(io.BytesIO(), "truck", "roof")
    with pytest.raises(DecodeError):
        writer.write(b"anything")
    with pytest.raises(HeaderError, match="should have"):
        writer.write(message(1, True)[:-1])


def test_a_stamp_before_1970_is_kept_in_the_message() -> None:
    data = [message(0, True, stamp_ns=-(10**9)), message(1, False, stamp_ns=5)]
    came = list(read_recording(io.BytesIO(recorded(data))))
    assert [stamp for stamp, _ in came] == [0, 5]
    assert wire.peek(came[0][1]).stamp_ns == -(10**9)


@pytest.mark.parametrize("name", table.names())
def test_frames_come_out_of_a_recording(name: str) -> None:
    encoder = table.make_encoder(StreamSettings(codec=name, key_interval=4), 5)
    sent = [frames.scene(3, index=index) for index in range(10)]
    messages = [one for frame in sent for one in encoder.encode(frame)] + encoder.flush()
    file = recorded([wire.pack(one) for one in messages])
    decoder = table.make_decoder(table.codec_id(name))
    came = [
        frame
        for _, data in read_recording(io.BytesIO(file), sent[6].stamp_ns)
        for frame in decoder.decode(wire.unpack(data))
    ]
    first = 4 if messages[0].frame_count == 1 else 0
    assert [frame.index for frame in came] == list(range(first, 10))
    exact = table.codec(name).bounded
    for frame in came:
        range_ = sent[frame.index].range
        assert ((frame.range == range_) if exact else (frame.range > 0) == (range_ > 0)).all()


def test_two_publishers_of_one_name_in_a_recording_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """It was one drive that jumps between two towns, and nobody who opened it was told."""
    restarted = [message(index % 5, index % 5 == 0, stream=1 + index // 5) for index in range(15)]
    mixed = [message(index // 2, index < 2, stream=1 + index % 2) for index in range(10)]
    for data, times in ((restarted, 0), (mixed, 8)):
        reader = RecordingReader(io.BytesIO(recorded(data)))
        assert len(list(reader.messages())) == len(data)
        assert reader.counts["mixed streams"] == times
        assert [record.message for record in caplog.records if "two publishers" in record.message][1:] == []
    assert "two publishers used the same name" in caplog.text
