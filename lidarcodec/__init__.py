"""lidarcodec: a streaming, packet-level LiDAR codec. Packets in, packets out, a fraction of the bits between."""

from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

__version__ = "0.1.0"

__all__ = ["Frame", "Message", "Packet", "SensorModel", "StreamSettings", "__version__"]
