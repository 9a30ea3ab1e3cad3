"""Milliseconds of each stage of the lossless pcodec path, one frame of 348 packets, one core.

Processor time of the one thread that does it, so that whatever else runs on the machine counts as little as it can.
The path itself is timed from packets to bytes and back. Its stages are timed inside of that same run, by putting a
stopwatch around the functions that do them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from statistics import median
from time import thread_time
from typing import Any
from unittest.mock import patch

from benchmarks.scenes import FRAMING, Scene
from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.units import FRAME_PACKETS
from lidarcodec.wire import pack, unpack

STOPWATCHES = {
    "encode mask": ("lidarcodec.entropy", "encode_mask"),
    "encode azimuth": ("lidarcodec.entropy", "encode_azimuth"),
    "encode side": ("lidarcodec.entropy", "encode_side"),
    "decode side": ("lidarcodec.entropy", "decode_side"),
    "encode intensity": ("lidarcodec.planes.sections", "encode_intensity"),
    "encode range": ("lidarcodec.codecs.frame_encoder.Independent", "_ranges"),
    "decode session": ("lidarcodec.codecs.frame_decoder.PlaneReader", "read"),
}
"""Stage: module or class, and the name under which the path calls it there."""

Times = dict[str, list[float]]


def _home(path: str) -> Any:
    try:
        return import_module(path)
    except ModuleNotFoundError:
        module, _, name = path.rpartition(".")
        return getattr(import_module(module), name)


def _timed(times: Times, stage: str, function: Callable[..., Any], *given: Any, **named: Any) -> Any:
    started = thread_time()
    result = function(*given, **named)
    times[stage].append(thread_time() - started)
    return result


@contextmanager
def _stopwatches(times: Times) -> Iterator[None]:
    with ExitStack() as stack:
        for stage, (path, name) in STOPWATCHES.items():
            home = _home(path)
            original = getattr(home, name)
            if isinstance(home, type):

                def method(self: Any, *given: Any, _stage: str = stage, _call: Any = original) -> Any:
                    return _timed(times, _stage, _call, self, *given)

                stack.enter_context(patch.object(home, name, method))
            else:
                stack.enter_context(patch.object(home, name, partial(_timed, times, stage, original)))
        yield


def _groups(scene: Scene) -> tuple[SensorModel, list[list[Packet]]]:
    """The scene's packets in groups of 348; a shorter last one is left out."""
    with open_source(scene.spec, calibration=scene.calibration) as source:
        packets = list(islice(source.packets(), scene.frames * FRAME_PACKETS))
        sensor = source.sensor
    whole = len(packets) // FRAME_PACKETS * FRAME_PACKETS
    if not whole:  # the S3 capture is shorter than a frame: repeat its beginning
        packets, whole = (packets * FRAME_PACKETS)[:FRAME_PACKETS], FRAME_PACKETS
    return sensor, [packets[at : at + FRAME_PACKETS] for at in range(0, whole, FRAME_PACKETS)]


def stage_times(scene: Scene) -> dict[str, float]:
    """Median milliseconds a frame: each stage, `whole encode` and `whole decode`, and velodyne-decoder beside them.

    Raises AssertionError if the packets do not come back as they were: a time would mean nothing then.
    """
    sensor, groups = _groups(scene)
    assembler, encoder, decoder = Assembler(sensor, FRAMING), StreamEncoder(StreamSettings()), StreamDecoder()
    times: Times = defaultdict(list)
    with _stopwatches(times):
        for group in [groups[0], *groups]:  # the first one twice: it warms up, and is not counted
            started = thread_time()
            for packet in group[:-1]:
                assembler.push(packet)
            frame = assembler.push(group[-1])
            assembled = thread_time()
            assert frame is not None
            coded = [pack(message) for message in encoder.encode(frame)]
            encoded = thread_time()
            decoded = [frame for data in coded for frame in decoder.decode(unpack(data))]
            framed = thread_time()
            back = [packet.payload for frame in decoded for packet in packets_of(frame)]
            ended = thread_time()
            assert back == [packet.payload for packet in group]
            times["assembly"].append(assembled - started)
            times["whole encode"].append(encoded - started)
            times["disassembly"].append(ended - framed)
            times["whole decode"].append(ended - encoded)
    times["velodyne-decoder"] = _velodyne_decoder(groups)
    return {stage: round(median(seconds[1:]) * 1e3, 3) for stage, seconds in sorted(times.items())}


def _velodyne_decoder(groups: list[list[Packet]]) -> list[float]:
    """Seconds that velodyne-decoder takes for the same packets to a cloud, one entry a group."""
    from velodyne_decoder import Config, Model, get_bundled_calibration
    from velodyne_decoder import StreamDecoder as CloudDecoder

    name = "HDL-64E_S2.1-sztaki.yml"
    cloud = CloudDecoder(Config(model=Model.HDL64E_S2, calibration=get_bundled_calibration(name)))
    seconds = []
    for group in [groups[0], *groups]:
        started = thread_time()
        for packet in group:
            cloud.decode(packet.stamp_ns * 1e-9, packet.payload, False)
        seconds.append(thread_time() - started)
    return seconds
