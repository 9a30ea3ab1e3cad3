"""Recordings: the bytes that go over the network, in MCAP files that any MCAP reader opens.

>>> import io
>>> from lidarcodec.message import Message
>>> from lidarcodec.wire import pack
>>> data = pack(Message(codec=1, stream_id=7, frame_index=3, stamp_ns=5, key=True, width=0, packets=0, sections=()))
>>> file = io.BytesIO()
>>> with RecordingWriter(file, "truck", "roof") as writer:
...     writer.write(data)
>>> list(read_recording(file)) == [(5, data)]
True
"""

from lidarcodec.recording.layout import MESSAGE_ENCODING, PACKET_ENCODING
from lidarcodec.recording.reader import RecordingReader, read_recording
from lidarcodec.recording.rosbag import RosbagWriter
from lidarcodec.recording.rotation import RotatingRecorder
from lidarcodec.recording.writer import RecordingWriter

__all__ = [
    "MESSAGE_ENCODING",
    "PACKET_ENCODING",
    "RecordingReader",
    "RecordingWriter",
    "RosbagWriter",
    "RotatingRecorder",
    "read_recording",
]
