"""As much of protobuf as it takes to write a message and to describe its type (protobuf.dev, "Encoding").

>>> Fields().text(1, "map").varint(2, 300).done().hex(" ")
'0a 03 6d 61 70 10 ac 02'
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final, NamedTuple, Self

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

OPTIONAL, REPEATED = 1, 3
DOUBLE, INT64, INT32, FIXED32, STRING, MESSAGE, BYTES, ENUM = 1, 3, 5, 7, 9, 11, 12, 14
"""Types of fields as descriptor.proto numbers them."""


def varint(value: int) -> bytes:
    """A whole number of at most 64 bits; a negative one takes ten bytes."""
    value &= 0xFFFF_FFFF_FFFF_FFFF
    groups = bytearray()
    while value > 0x7F:
        groups.append(0x80 | (value & 0x7F))
        value >>= 7
    groups.append(value)
    return bytes(groups)


class Fields:
    """Fields of a message as they are added."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def _add(self, number: int, wire_type: int, data: bytes) -> Self:
        self._parts += [varint(number << 3 | wire_type), data]
        return self

    def varint(self, number: int, value: int) -> Self:
        """A field of type int32, int64, uint32, enum or bool."""
        return self._add(number, _VARINT, varint(value))

    def double(self, number: int, value: float) -> Self:
        """A field of type double."""
        return self._add(number, _FIXED64, struct.pack("<d", value))

    def fixed32(self, number: int, value: int) -> Self:
        """A field of type fixed32."""
        return self._add(number, _FIXED32, struct.pack("<I", value))

    def data(self, number: int, value: bytes) -> Self:
        """A field of type bytes, or a message within this one."""
        self._parts.append(varint(number << 3 | _BYTES) + varint(len(value)))
        self._parts.append(value)
        return self

    def text(self, number: int, value: str) -> Self:
        """A field of type string."""
        return self.data(number, value.encode())

    def done(self) -> bytes:
        """The message."""
        return b"".join(self._parts)


class Field(NamedTuple):
    """A field of a type: name, number, its own type, and the full name of that where it is a message or an enum."""

    name: str
    number: int
    type: int
    type_name: str = ""
    repeated: bool = False


class MessageType(NamedTuple):
    """A type of message; enums: name to value names, numbered from 0."""

    name: str
    fields: tuple[Field, ...]
    enums: tuple[tuple[str, tuple[str, ...]], ...] = ()


class File(NamedTuple):
    """A .proto file with one type in it."""

    name: str
    package: str
    imports: tuple[str, ...]
    message: MessageType


def descriptor_set(files: Iterable[File]) -> bytes:
    """A FileDescriptorSet, which is what MCAP and Foxglove take for the schema of a protobuf channel."""
    found = Fields()
    for file in files:
        found.data(1, _file(file))
    return found.done()


_PROTO3: Final = "proto3"


def _file(file: File) -> bytes:
    fields = Fields().text(1, file.name).text(2, file.package)
    for name in file.imports:
        fields.text(3, name)
    return fields.data(4, _message(file.message)).text(12, _PROTO3).done()


def _message(message: MessageType) -> bytes:
    fields = Fields().text(1, message.name)
    for one in message.fields:
        about = Fields().text(1, one.name).varint(3, one.number)
        about.varint(4, REPEATED if one.repeated else OPTIONAL).varint(5, one.type)
        if one.type_name:
            about.text(6, f".{one.type_name}")
        fields.data(2, about.done())
    for name, values in message.enums:
        enum = Fields().text(1, name)
        for number, value in enumerate(values):
            enum.data(2, Fields().text(1, value).varint(2, number).done())
        fields.data(4, enum.done())
    return fields.done()
