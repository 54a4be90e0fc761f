"""Parse where a device is connected: one URI per wire in the configuration, checked to the last character.

`place` of an address is its name in messages.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias, TypeVar
from urllib.parse import parse_qsl, unquote, urlsplit

from auv_mcm.errors import UsageError

# Those that Linux has a name for; any other is far more often a slip of the pen than a device.
BAUD_RATES: Final = (
    *(50, 75, 110, 134, 150, 200, 300, 600, 1200, 1800, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400),
    *(460800, 500000, 576000, 921600, 1000000, 1152000, 1500000, 2000000, 2500000, 3000000, 3500000, 4000000),
)
CAN_BITRATES: Final = (10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000, 1000000)  # S0 to S8 of slcan
SILENT_S: Final = 5.0
_MAX_SILENT_S: Final = 3600.0

EXAMPLES: Final = (
    "serial:///dev/ttyUSB0?baud=921600",
    "tcp://192.168.2.92:51200",
    "udp://0.0.0.0:5000?peer=192.168.2.92:51200",
    "slcan:///dev/ttyACM0?bitrate=250000",
    "socketcan://can0",
    "can-virtual://bench",
    "pps:///dev/pps0",
)


class SerialAddress(NamedTuple):
    """Address a serial port, 8 data bits, no parity, 1 stop bit."""

    path: str
    baud: int
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"serial://{self.path}"


class TcpAddress(NamedTuple):
    """Address a server to connect to."""

    host: str
    port: int
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"tcp://{self.host}:{self.port}"


class UdpAddress(NamedTuple):
    """Address a local interface and port (0: any) to receive on.

    peer_host: datagrams from others are refused, "" for none; peer_port: the same for its port, and where writes go, 0
    if not given.
    """

    host: str
    port: int
    peer_host: str = ""
    peer_port: int = 0
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"udp://{self.host}:{self.port}"


class SlcanAddress(NamedTuple):
    """Address a CAN adapter that speaks slcan at a serial port.

    bitrate: of the CAN bus; baud: of the port, without meaning on USB.
    """

    path: str
    bitrate: int
    baud: int = 115200
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"slcan://{self.path}"


class CanAddress(NamedTuple):
    """Address a CAN bus that python-can opens: interface "socketcan" or "virtual"."""

    interface: str
    channel: str
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"{'can-virtual' if self.interface == 'virtual' else self.interface}://{self.channel}"


class PulseAddress(NamedTuple):
    """Address a pulse per second that the kernel stamps."""

    path: str
    silent_s: float = SILENT_S

    @property
    def place(self) -> str:
        return f"pps://{self.path}"


LinkAddress: TypeAlias = SerialAddress | TcpAddress | UdpAddress | SlcanAddress | CanAddress | PulseAddress
T = TypeVar("T")


def parse_link_uri(text: str, key: str) -> LinkAddress:
    """Parse a URI; every scheme takes silent_s, the seconds without data after which a link counts as silent.

    key: where the text stands in the configuration, for messages. Raises UsageError for anything that is not understood
    to the end.
    """
    return _Uri(text, key).address()


class _Uri:
    """Parse one URI to an address; options that nothing requested are refused."""

    def __init__(self, text: str, key: str) -> None:
        self._text, self._key = text, key
        if not text:
            raise self._error("it is empty", f"write e.g. {EXAMPLES[0]}")
        if re.search(r"[\x00-\x20\x7f\\#]", text):
            raise self._error(
                "spaces, backslashes, '#' and control characters have no place in it", f"write e.g. {EXAMPLES[0]}"
            )
        try:
            parts = urlsplit(text)
            options = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError as error:
            raise self._error(f"not a URI ({error})", f"write e.g. {EXAMPLES[0]}") from error
        self._scheme, self._netloc, self._path = parts.scheme, parts.netloc, unquote(parts.path)
        self._options = dict(options)
        if len(self._options) < len(options):
            raise self._error("an option is given twice", "keep one")

    def address(self) -> LinkAddress:
        makers: dict[str, Callable[[], LinkAddress]] = {
            "serial": self._serial,
            "tcp": self._tcp,
            "udp": self._udp,
            "slcan": self._slcan,
            "socketcan": lambda: CanAddress("socketcan", self._channel(), self._silent_s()),
            "can-virtual": lambda: CanAddress("virtual", self._channel(), self._silent_s()),
            "pps": lambda: PulseAddress(self._device(), self._silent_s()),
        }
        if self._scheme not in makers:
            what = f"unknown kind of link '{self._scheme}'" if self._scheme else "the kind of link is missing"
            raise self._error(what, f"known: {', '.join(EXAMPLES)}")
        self._known: list[str] = []
        address = makers[self._scheme]()
        unknown = [name for name in self._options if name not in self._known]
        if unknown:
            raise self._error(
                f"'{unknown[0]}' is not an option of {self._scheme}", f"known options: {', '.join(self._known)}"
            )
        return address

    def _serial(self) -> SerialAddress:
        return SerialAddress(self._device(), self._rate("baud", BAUD_RATES), self._silent_s())

    def _slcan(self) -> SlcanAddress:
        return SlcanAddress(
            self._device(),
            self._rate("bitrate", CAN_BITRATES),
            self._rate("baud", BAUD_RATES, default=115200),
            self._silent_s(),
        )

    def _tcp(self) -> TcpAddress:
        self._refuse_path()
        host, port = self._host_port(self._netloc, "192.168.2.92:51200")
        if not port:
            raise self._error("the port is missing", "write e.g. tcp://192.168.2.92:51200")
        return TcpAddress(host, port, self._silent_s())

    def _udp(self) -> UdpAddress:
        self._refuse_path()
        host, port = self._host_port(self._netloc, "0.0.0.0:5000")
        peer = self._option("peer")
        peer_host, peer_port = ("", 0) if peer is None else self._host_port(peer, "192.168.2.92:51200")
        if not (port or peer_port):
            raise self._error(
                "without a port it cannot receive", "write e.g. udp://0.0.0.0:5000, or name a peer with its port"
            )
        return UdpAddress(host, port, peer_host, peer_port, self._silent_s())

    def _device(self) -> str:
        if self._netloc:
            raise self._error(
                f"'{self._netloc}' is read as a host", f"a path has three slashes: {self._scheme}:///dev/ttyUSB0"
            )
        if not re.fullmatch(r"/[^\x00-\x1f\x7f]*[^\x00-\x1f\x7f/]", self._path):
            raise self._error("the device is missing", f"name one, e.g. {self._scheme}:///dev/ttyUSB0")
        return self._path

    def _channel(self) -> str:
        self._refuse_path()
        if not re.fullmatch(r"[A-Za-z0-9_.-]{1,15}", self._netloc):
            raise self._error(
                f"'{self._netloc}' is not the name of a CAN interface", f"write e.g. {self._scheme}://can0"
            )
        return self._netloc

    def _host_port(self, text: str, example: str) -> tuple[str, int]:
        """Return the host, and its port or 0."""
        advice = f"write e.g. {example}"
        try:
            parts = urlsplit(f"//{text}")
            host, port = parts.hostname or "", parts.port
        except ValueError as error:
            raise self._error(f"'{text}' is not an address ({error})", advice) from error
        if "@" in text or "/" in text or not re.fullmatch(r"[a-z0-9:._-]{1,253}", host):
            raise self._error(f"'{text}' is not an address", advice)
        return host, port or 0

    def _refuse_path(self) -> None:
        if self._path:
            raise self._error(f"'{self._path}' has no meaning here", f"end {self._scheme}://{self._netloc} there")

    def _rate(self, name: str, rates: tuple[int, ...], default: int | None = None) -> int:
        text = self._option(name)
        if text is None:
            if default is None:
                raise self._error(
                    f"{name} is missing", f"add ?{name}={rates[len(rates) // 2]} or whatever the device is set to"
                )
            return default
        if not re.fullmatch(r"[0-9]{1,9}", text):
            raise self._error(f"{name}='{text}' is not a whole number", f"write e.g. {name}={rates[len(rates) // 2]}")
        if int(text) not in rates:
            near = sorted(sorted(rates, key=lambda rate: abs(rate - int(text)))[:3])
            raise self._error(f"{name}={text} is not a standard rate", f"near it are {', '.join(map(str, near))}")
        return int(text)

    def _silent_s(self) -> float:
        text = self._option("silent_s")
        if text is None:
            return SILENT_S
        if not re.fullmatch(r"[0-9]{1,6}(\.[0-9]{1,6})?", text) or not 0.0 < float(text) <= _MAX_SILENT_S:
            raise self._error(
                f"silent_s='{text}' is not a time",
                f"write seconds above 0 and up to {_MAX_SILENT_S:g}, e.g. silent_s=5",
            )
        return float(text)

    def _option(self, name: str) -> str | None:
        self._known.append(name)
        return self._options.get(name)

    def _error(self, what: str, advice: str) -> UsageError:
        return UsageError(f"{self._key} '{self._text}': {what}; {advice}")
