"""How a live stream begins and ends, what it says of itself, and what a fault in it does."""

from __future__ import annotations

import asyncio
import dataclasses
import threading
import time

import pytest

from lidarcodec import wire
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.stats import REMEMBERED
from lidarcodec.apps.reports import COUNTED
from lidarcodec.apps.swarm_shared import encoded
from lidarcodec.errors import SettingsError, TransportError, UnknownNameError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from tests.apps.in_memory import live, publisher
from tests.apps.streams import Broken, Loop
from tests.conftest import ROOT
from tests.sweeps import sampled
from tests.transport.test_contract import eventually

KEYS = StreamKeys()


def test_what_ends_a_source_is_raised_after_everything_was_sent(network):
    source = Broken()
    with live(network) as stream:
        car = Publisher(source, transport=network.end(), rate="max")
        with pytest.raises(RuntimeError, match="the cable was cut"):
            car.run()
        assert stream.next(2) is not None
    assert car.status()["ended"]


def test_run_ends_soon_when_interrupted(network):
    car = publisher(network)
    threading.Timer(0.3, car.interrupt).start()
    start = time.monotonic()
    car.run()
    assert time.monotonic() - start < 30


def test_the_status_and_the_report_reach_the_other_side(network):
    with publisher(network, rate=20.0) as car, live(network, receiver="office") as stream:
        assert stream.next(60)
        assert eventually(lambda: ((stream.status or {}).get("reports") or {}).get("office", {}).get("frames"))
        told = stream.status
        assert told["stream_id"] == f"{car.stream_id:016x}"
        assert told["flight"]["following"] == "office"
        assert told["settings"]["codec"] == "pcodec"
        assert told["reports"]["office"]["frames"] > 0
        assert told["reports"]["office"]["rtt_ms"] is not None


def test_names_and_settings_are_checked_before_anything_starts(network):
    for options in ({"vehicle": "a/b"}, {"sensor": ""}):
        with pytest.raises(SettingsError):
            publisher(network, **options)
    with pytest.raises(UnknownNameError):
        publisher(network, settings=StreamSettings(codec="none"))
    for options in ({"receiver": "a b"}, {"udp": "host:"}):
        with pytest.raises(SettingsError):
            live(network, **options)


def test_what_is_open_never_or_twice_says_so_instead_of_waiting_for_ever(network):
    stream, car = live(network), publisher(network)
    with pytest.raises(TransportError, match="with subscribe"):
        stream.next()
    for one in (stream, car):
        with one:
            pass
        with pytest.raises(TransportError, match="once"):
            one.__enter__()
    assert stream.next() is None


async def test_an_interruption_ends_an_asynchronous_iteration_too(network):
    with live(network) as stream:
        asyncio.get_running_loop().call_later(0.1, stream.interrupt)
        assert [frame async for frame in stream] == []


async def test_frames_come_to_a_coroutine(network):
    with publisher(network), live(network) as stream:
        count = 0
        async for frame in stream:
            assert frame.range.shape[0] == 64
            count += 1
            if count == 3:
                break


async def test_a_cancelled_wait_loses_no_frame_and_leaves_nothing(network):
    with live(network) as stream:
        waiting = asyncio.create_task(stream.next_async())
        await asyncio.sleep(0.05)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert not stream._listeners
        assert await stream.next_async(0.05) is None
        with publisher(network, 1, rate="max"):
            assert (await stream.next_async(60)).index == 0


async def test_a_coroutine_that_waits_ends_with_the_stream(network):
    with live(network) as stream:
        waiting = asyncio.create_task(stream.next_async())
        await asyncio.sleep(0.05)
        stream.close()
        assert await asyncio.wait_for(waiting, 60) is None


def test_every_field_of_status_and_report_is_documented(network):
    text = (ROOT / "docs" / "live.md").read_text()
    with publisher(network, rate=20.0) as car, live(network) as stream:
        assert stream.next(60)
        names = {*car.status(), *car.status()["flight"], *COUNTED, *stream.summary()}
        names -= {"errors", "udp", "recording"} & set(stream.summary())
    for name in names:
        assert f"`{name}`" in text or f"`{name.partition('_')[0]}_*`" in text, name


@pytest.mark.parametrize("newest", sampled([True, False], [True]))
def test_a_path_that_repeats_the_past_does_not_show_it_as_the_present(network, newest):
    """Messages of seconds ago were taken for a clock that was set, and each step back for frames that are missing."""
    end = network.end()
    inbox, again = end.inbox(KEYS.frame), end.sender(KEYS.frame, Priority.FRAMES)
    settings = StreamSettings(codec="raw", framing="packets:8")
    with publisher(network, settings=settings, rate=100.0) as car, live(network, newest=newest) as stream:
        kept, indices, repeats = [], [], 0
        while repeats < 5:
            kept.append(inbox.receive())
            indices.append(stream.next(60).index)
            if len(kept) > 2 * REMEMBERED and len(kept) % 8 == 0:
                again.put(kept[0])
                repeats += 1
        assert indices == sorted(indices)
        assert eventually(lambda: stream.stats.counts["duplicates"] > 0)
        assert stream.stats.counts["missing"] <= car.status()["frames"] + car.status()["replaced"]
        assert stream.stats.counts["clocks_apart"] == 0
    inbox.close()


@pytest.mark.parametrize("count", sampled([1, 2 * REMEMBERED], [2 * REMEMBERED]))
def test_a_frame_number_far_ahead_bars_what_follows_for_a_second_at_most(network, count):
    """Of one forged message every viewer stood still until the publisher was started again."""
    end = network.end()
    inbox, forged = end.inbox(KEYS.frame), end.sender(KEYS.frame, Priority.FRAMES)
    with (
        publisher(network, settings=StreamSettings(codec="raw", framing="packets:8"), rate=50.0),
        live(network) as stream,
    ):
        assert stream.next(60)
        true = wire.unpack(inbox.receive())
        forgeries = [wire.pack(dataclasses.replace(true, frame_index=2**62 + number)) for number in range(count)]

        def arrived() -> bool:
            for forgery in forgeries:  # a newer message may take the place of one that waits
                forged.put(forgery)
            return stream.stats.counts["jumps"] > 0

        assert eventually(arrived)
        while stream.next(60).index < 2**62:
            pass
        assert eventually(lambda: (frame := stream.next(1)) is not None and frame.index < 2**62)
        assert eventually(lambda: (frame := stream.next(1)) is not None and frame.index < 2**62)
        assert stream.stats.counts["missing"] < 100_000
    inbox.close()


def test_an_earlier_run_is_not_shown_among_frames_of_the_present_one(network):
    """A viewer that came later was shown frames of 80 s ago as the present: nobody could tell how old they were."""
    end = network.end()
    inbox, again = end.inbox(KEYS.frame), end.sender(KEYS.frame, Priority.FRAMES)
    settings = StreamSettings(codec="raw", framing="packets:8", key_interval=1)
    with publisher(network, settings=settings, rate=50.0), live(network) as stream:
        begin_ns = stream.next(60).stamp_ns
        true = wire.unpack(inbox.receive())
        earlier = dataclasses.replace(true, stream_id=true.stream_id ^ 1, stamp_ns=true.stamp_ns - 80 * 10**9)
        shown = []
        for number in range(300):
            again.put(wire.pack(dataclasses.replace(earlier, frame_index=number)))
            shown.append(stream.next(60).stamp_ns)
            if len(shown) > 30 and stream.stats.counts["stale"] > 5:
                break
        assert stream.stats.counts["stale"] > 5
        assert min(shown) >= begin_ns - 2 * 10**9
    inbox.close()


def test_a_live_view_does_not_go_back_to_a_frame_that_came_late(network):
    source, settings = Loop(5), StreamSettings(codec="raw")
    messages = [wire.pack(message) for message in encoded(source.sensor, list(source.packets()), settings)]
    sender = network.end().sender(KEYS.frame, Priority.FRAMES)
    with live(network, max_age_s=None) as stream:
        assert eventually(lambda: sender.matching)
        shown = []
        for came, number in enumerate((0, 1, 3, 2, 4)):
            sender.put(messages[number])
            assert eventually(lambda came=came: stream.stats.counts["frames"] == came + 1)
            if number != 2:
                shown.append(stream.next(60).index)
        assert shown == [0, 1, 3, 4]
        assert [stream.stats.counts[name] for name in ("stale", "out_of_order", "missing")] == [1, 1, 1]


@pytest.mark.parametrize("where", ["_frames_of", "stats", "_round_trips"], ids=["decode", "receive", "control"])
def test_a_fault_in_any_thread_ends_the_stream_aloud(network, where, caplog):
    """A stream that froze in silence would look like a publisher that has nothing to say."""
    with live(network) as stream:
        setattr(stream._receiver, where, None)  # as a fault of ours would
        with publisher(network, rate=20.0), pytest.raises((TypeError, AttributeError)):
            sum(1 for _ in stream)
    assert "the receiver stops" in caplog.text


def test_a_message_that_comes_twice_is_decoded_once(network):
    settings = StreamSettings(key_interval=10_000, codec_settings={"mask_history": True})
    end = network.end()
    inbox = end.inbox(KEYS.frame)
    with publisher(network, settings=settings, rate=20.0), live(network, newest=False) as stream:
        again = network.end().sender(KEYS.frame, Priority.FRAMES)
        indices = []
        for _ in range(6):
            again.put(inbox.receive())
            indices.append(stream.next(60).index)
        assert indices == sorted(set(indices))
        assert eventually(lambda: stream.stats.counts["duplicates"] > 0)
        assert stream.summary()["errors"] == {}
        assert stream.stats.counts["out_of_order"] == 0
    inbox.close()
