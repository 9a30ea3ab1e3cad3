"""A UDP socket with a large receive buffer, kernel time stamps and kernel drop counts.

The default buffer of Linux holds 92 HDL-64 packets, 26 ms, which is too small beside one busy Python thread. 8 MiB hold
more than a second. A privileged process may exceed the system's limit (net.core.rmem_max).
"""

from __future__ import annotations

import logging
import socket
import struct
from array import array
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

from lidarcodec.errors import SourceError

logger = logging.getLogger(__name__)

BUFFER_BYTES: Final = 8 << 20
LEAST_BYTES: Final = 1 << 20
"""A smaller buffer gives a warning: a quarter of a second of an HDL-64."""
KERNEL_BYTES: Final = 2304
"""Bytes that the kernel counts for one packet of 1206 bytes."""
PACKETS_PER_SECOND: Final = 3472
SO_RCVBUFFORCE: Final = 33
SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
_SO_ATTACH_FILTER: Final = 26
_SO_DETACH_FILTER: Final = 27
_SO_MEMINFO: Final = 55
_MEMINFO: Final = struct.Struct("@9I")
"""`SK_MEMINFO_*` of linux/sock_diag.h: the first number is the waiting bytes, the second the size of the buffer, the
last the dropped datagrams."""
_LOAD_HALF, _LOAD_WORD, _IS_EQUAL, _RETURN = 0x28, 0x20, 0x15, 0x06
_PROTOCOL: Final = 0xFFFFF000
_NETWORK_HEADER: Final = 0xFFF00000
_EVERYTHING: Final = 0xFFFFFFFF
"""Classic BPF, linux/filter.h: instructions, and offsets of a datagram's protocol and IP header."""


def open_socket(
    host: str, port: int, *, interface: str | None = None, share: bool = False, least_bytes: int = LEAST_BYTES
) -> socket.socket:
    """A bound, tuned, non-blocking socket; a member of the group if the host is a multicast address.

    interface: the one on which the group is joined, its address (IPv4) or name (IPv6)
    share:     let other programs of this machine listen on the same port (always so for multicast)
    least_bytes: a smaller buffer gives a warning
    Raises SourceError if the address cannot be listened on.
    """
    place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    family, address = _resolve(host, port)
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        group = ip_address(address[0].partition("%")[0])
        if share or group.is_multicast:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        if group.is_multicast:
            _join(sock, group, interface)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
            sock.setsockopt(socket.SOL_SOCKET, option, 1)
        size = _grow(sock)
        if size < least_bytes:
            logger.warning(
                "the receive buffer of udp://%s holds only %d ms of an HDL-64E: raise net.core.rmem_max from %d to %d",
                place,
                size // KERNEL_BYTES * 1000 // PACKETS_PER_SECOND,
                size // 2,
                BUFFER_BYTES,
            )
        sock.setblocking(False)
    except OSError as error:
        sock.close()
        raise SourceError(f"cannot listen on udp://{place}: {error.strerror or error}{_advice(error)}") from None
    return sock


def take_only_from(sock: socket.socket, address: bytes | None) -> None:
    """Set a filter: the kernel drops packets of other senders before they are queued, and counts them as dropped.

    address: 4 or 16 bytes; None: remove the filter. Packets already queued stay.
    Raises OSError.
    """
    if address is None:
        sock.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
        return
    protocol, begin = (0x0800, 12) if len(address) == 4 else (0x86DD, 8)  # EtherType, offset of the sender
    checks = [(_LOAD_HALF, _PROTOCOL, protocol)]
    for at in range(0, len(address), 4):
        checks.append((_LOAD_WORD, _NETWORK_HEADER + begin + at, int.from_bytes(address[at : at + 4], "big")))
    program = b""
    for number, (load, place, value) in enumerate(checks):
        to_refusal = 2 * (len(checks) - number) - 1  # instructions to jump over
        program += struct.pack("@HBBI", load, 0, 0, place) + struct.pack("@HBBI", _IS_EQUAL, 0, to_refusal, value)
    program += struct.pack("@HBBI", _RETURN, 0, 0, _EVERYTHING) + struct.pack("@HBBI", _RETURN, 0, 0, 0)
    kept = array("Q", program)
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", len(kept), kept.buffer_info()[0]))


def dropped(sock: socket.socket) -> tuple[int, bool] | None:
    """Number of datagrams that the kernel dropped so far, modulo 2**32, and whether its buffer is half full.

    None: this kernel does not say (before Linux 4.12).
    Only the reader empties the buffer: if it is less than half full, nothing was dropped for lack of room since the
    last read.
    """
    try:
        found = _MEMINFO.unpack(sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))
    except (OSError, struct.error):
        return None
    return found[8], found[0] > found[1] // 2


def _resolve(host: str, port: int) -> tuple[int, tuple[str, int] | tuple[str, int, int, int]]:
    try:
        found = socket.getaddrinfo(host or "0.0.0.0", port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise SourceError(f"cannot listen on udp://{host}:{port}: no such host ({error})") from None
    family, _, _, _, address = found[0]
    return family, address  # type: ignore[return-value]


def _join(sock: socket.socket, group: IPv4Address | IPv6Address, interface: str | None) -> None:
    if group.version == 4:
        local = socket.inet_aton(interface or "0.0.0.0")  # any interface
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group.packed + local)
    else:
        index = socket.if_nametoindex(interface) if interface else 0
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group.packed + struct.pack("@I", index))


def _grow(sock: socket.socket) -> int:
    """Request the full buffer; returns the bytes granted (the kernel reports twice the requested size)."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    size = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if size < BUFFER_BYTES:
        try:
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER_BYTES)
        except PermissionError:
            return size
        size = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return size


def _advice(error: OSError) -> str:
    import errno

    if error.errno == errno.EADDRINUSE:
        return " by another program (add ?share=1 to listen beside it)"
    if error.errno == errno.EADDRNOTAVAIL:
        return "; 0.0.0.0 listens on all addresses of this machine"
    return ""
