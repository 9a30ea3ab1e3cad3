"""lidarcodec: a streaming, packet-level LiDAR codec. Packets in, packets out, a fraction of the bits between."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lidarcodec.errors import LidarCodecError

if TYPE_CHECKING:
    from lidarcodec.api import decode, encode, read_frames
    from lidarcodec.apps.publisher.publisher import Publisher
    from lidarcodec.apps.receiver.live_stream import LiveStream, subscribe
    from lidarcodec.apps.recorder import Record
    from lidarcodec.archive.archive import Archive, open_archive
    from lidarcodec.assembly import packets_of
    from lidarcodec.commands.outputs.writing import write_frames
    from lidarcodec.commands.verify import verify
    from lidarcodec.evaluation.metrics import bits_per_point
    from lidarcodec.filling import filled
    from lidarcodec.frame import Frame
    from lidarcodec.message import Message
    from lidarcodec.mounting import Mounting
    from lidarcodec.packet import Packet, data_packets
    from lidarcodec.pipeline import StreamDecoder, StreamEncoder
    from lidarcodec.sensor_model import SensorModel
    from lidarcodec.settings import StreamSettings
    from lidarcodec.sources import open_source
    from lidarcodec.transport import Endpoints
    from lidarcodec.wire import pack, unpack

__version__ = "1.0.0"

_HOME = {
    "Archive": "archive.archive",
    "Endpoints": "transport",
    "Frame": "frame",
    "LiveStream": "apps.receiver.live_stream",
    "Message": "message",
    "Mounting": "mounting",
    "Packet": "packet",
    "Publisher": "apps.publisher.publisher",
    "Record": "apps.recorder",
    "SensorModel": "sensor_model",
    "StreamDecoder": "pipeline",
    "StreamEncoder": "pipeline",
    "StreamSettings": "settings",
    "bits_per_point": "evaluation.metrics",
    "data_packets": "packet",
    "decode": "api",
    "encode": "api",
    "filled": "filling",
    "open_archive": "archive.archive",
    "open_source": "sources",
    "pack": "wire",
    "packets_of": "assembly",
    "read_frames": "api",
    "subscribe": "apps.receiver.live_stream",
    "unpack": "wire",
    "verify": "commands.verify",
    "write_frames": "commands.outputs.writing",
}
"""Where each public name lives; it is imported on first use, so that `import lidarcodec` costs nothing."""

__all__ = [
    "Archive",
    "Endpoints",
    "Frame",
    "LidarCodecError",
    "LiveStream",
    "Message",
    "Mounting",
    "Packet",
    "Publisher",
    "Record",
    "SensorModel",
    "StreamDecoder",
    "StreamEncoder",
    "StreamSettings",
    "__version__",
    "bits_per_point",
    "data_packets",
    "decode",
    "encode",
    "filled",
    "open_archive",
    "open_source",
    "pack",
    "packets_of",
    "read_frames",
    "subscribe",
    "unpack",
    "verify",
    "write_frames",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        from difflib import get_close_matches

        near = get_close_matches(name, __all__, 1, 0.75)
        hint = f": did you mean {near[0]}?" if near else ""
        if name == "open":
            hint = ": read_frames gives the frames of a source, open_source its packets"
        raise AttributeError(f"module 'lidarcodec' has no attribute '{name}'{hint}")
    return getattr(import_module(f"lidarcodec.{home}"), name)


def __dir__() -> list[str]:
    return __all__
