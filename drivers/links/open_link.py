"""Make links that are ready to run from addresses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Callable
from functools import partial

from auv_mcm.clock import Clock, Stamp
from auv_mcm.errors import UsageError
from drivers.links.can_bus import open_can_bus
from drivers.links.can_frame import CanFrame
from drivers.links.link import Link, OnState, Wire
from drivers.links.pulse import open_pulse
from drivers.links.serial_port import open_serial
from drivers.links.slcan import open_slcan
from drivers.links.tcp import open_tcp
from drivers.links.udp import open_udp
from drivers.links.uri import CanAddress, LinkAddress, PulseAddress, SerialAddress, SlcanAddress, TcpAddress, UdpAddress


def byte_link(
    address: LinkAddress, on_bytes: Callable[[bytes, Stamp], None], on_state: OnState, clock: Clock
) -> Link[bytes]:
    """Make a link that carries bytes: chunks of a stream, whole UDP datagrams, or the edges of a pulse.

    Raises UsageError for the address of a CAN bus.
    """
    open_port: Callable[[Counter[str]], Awaitable[Wire[bytes]]]
    match address:
        case SerialAddress():
            open_port = partial(open_serial, address.path, address.baud)
        case TcpAddress():
            open_port = partial(open_tcp, address.host, address.port)
        case UdpAddress():
            open_port = partial(open_udp, address)
        case PulseAddress():
            open_port = partial(open_pulse, address.path, address.place, clock)
        case SlcanAddress() | CanAddress():
            raise UsageError(
                f"{address.place} is a CAN bus, but this device speaks in bytes: give it a serial, tcp or udp link"
            )
    device = address.path if isinstance(address, SerialAddress | PulseAddress) else None
    return Link(address.place, open_port, on_bytes, on_state, clock, address.silent_s, device)


def can_link(
    address: LinkAddress, on_frame: Callable[[CanFrame, Stamp], None], on_state: OnState, clock: Clock
) -> Link[CanFrame]:
    """Make a link that carries CAN frames. Raises UsageError for the address of a wire that does not."""
    open_port: Callable[[Counter[str]], Awaitable[Wire[CanFrame]]]
    match address:
        case SlcanAddress():
            open_port = partial(open_slcan, address.path, address.baud, address.bitrate)
        case CanAddress():
            open_port = partial(open_can_bus, address.interface, address.channel, address.place)
        case SerialAddress() | TcpAddress() | UdpAddress() | PulseAddress():
            raise UsageError(
                f"{address.place} is not a CAN bus, but this device is on one: give it an slcan or socketcan link"
            )
    device = address.path if isinstance(address, SlcanAddress) else None
    return Link(address.place, open_port, on_frame, on_state, clock, address.silent_s, device)
