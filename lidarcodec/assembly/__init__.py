"""Packets to frames and back, byte for byte, for any sequence of 1206-byte payloads."""

from lidarcodec.assembly.assembler import Assembler
from lidarcodec.assembly.disassembler import packets_of

__all__ = ["Assembler", "packets_of"]
