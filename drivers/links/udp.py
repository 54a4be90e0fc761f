"""Receive UDP datagrams on a local port."""

from __future__ import annotations

import errno
import socket
from collections import Counter
from typing import Final

from auv_mcm.errors import HardwareError
from drivers.links.tcp import addresses_of
from drivers.links.uri import UdpAddress

RECEIVE_BUFFER_BYTES: Final = 1 << 22  # a second of the fastest sonar, should the event loop be late
_MAX_DATAGRAM_BYTES: Final = 1 << 16  # by the 16-bit length of UDP
_MAX_PER_READ: Final = 64  # datagrams: bounds how long one read keeps the event loop


class UdpPort:
    """Carry bytes, one datagram each. Writes go to the peer; without one they are refused.

    counters: link.bytes_in, link.bytes_out, udp.datagrams, udp.refused.foreign (not from the peer), udp.send_failed.
    """

    def __init__(self, bound: socket.socket, place: str, peer: tuple[str, int], counters: Counter[str]) -> None:
        self.has_unsent = False
        self.pause_s = 0.0  # datagrams were gathered by who sent them
        self.note = ""
        self.close = bound.close
        self._socket = bound
        self._place = place
        self._peer = peer
        self._counters = counters
        self._foreign = ""

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        datagrams: list[bytes] = []
        try:
            for _ in range(_MAX_PER_READ):
                data, sender = self._socket.recvfrom(_MAX_DATAGRAM_BYTES)
                if self._is_foreign(sender[0], sender[1]):
                    self._foreign = f"{sender[0]}:{sender[1]}"
                    self._counters["udp.refused.foreign"] += 1
                    continue
                self._counters["udp.datagrams"] += 1
                self._counters["link.bytes_in"] += len(data)
                datagrams.append(data)
        except BlockingIOError:
            pass
        except OSError as error:
            raise HardwareError(
                f"{self._place}: failed ({error.strerror}). Check the network; it is opened again at once."
            ) from error
        return datagrams

    def write(self, item: bytes) -> bool:
        if not self._peer[1]:
            return False
        try:
            self._socket.sendto(item, self._peer)
        except OSError:  # no route now, or no room: as good as lost on the way
            self._counters["udp.send_failed"] += 1
            return False
        self._counters["link.bytes_out"] += len(item)
        return True

    def flush(self) -> None:
        pass

    def on_silence(self) -> str:
        foreign, self._foreign = self._foreign, ""
        if foreign:
            return f"Datagrams come from {foreign}, which is not the peer: check the peer's address."
        return "Check the cable, the device's power, and that it sends to this computer and port."

    def _is_foreign(self, host: str, port: int) -> bool:
        peer_host, peer_port = self._peer
        return bool(peer_host) and (host != peer_host or (peer_port != 0 and port != peer_port))


async def open_udp(address: UdpAddress, counters: Counter[str]) -> UdpPort:
    """Bind the local port. Raises HardwareError that says what to do."""
    place = address.place
    family, local = (await addresses_of(address.host, address.port, socket.SOCK_DGRAM, place))[0]
    peer_host = address.peer_host
    if peer_host:
        peer_host = (await addresses_of(peer_host, address.peer_port, socket.SOCK_DGRAM, f"{place}, peer", family))[0][
            1
        ][0]
    bound = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        bound.bind(local)
    except OSError as error:
        bound.close()
        raise HardwareError(_refusal(place, error)) from error
    port = UdpPort(bound, place, (peer_host, address.peer_port), counters)
    granted = bound.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # Linux reports twice what it grants
    if granted < RECEIVE_BUFFER_BYTES:
        port.note = (
            f"{place} is open with a receive buffer of {granted} bytes; to ride out a busy moment set sysctl "
            f"net.core.rmem_max={RECEIVE_BUFFER_BYTES}"
        )
    return port


def _refusal(place: str, error: OSError) -> str:
    match error.errno:
        case errno.EADDRINUSE:
            return (
                f"{place}: in use by another program. Stop that one (ss -ulpn shows which it is), or choose another "
                "port."
            )
        case errno.EADDRNOTAVAIL:
            return f"{place}: not an address of this computer. Write 0.0.0.0 to receive on all its addresses."
        case errno.EACCES:
            return f"{place}: permission denied. Choose a port above 1023."
    return f"{place}: cannot be opened ({error.strerror}). Check the network settings."
