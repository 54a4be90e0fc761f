"""Decode the bytes of one port to pings and fixes. It reads no clock: live and replayed bytes give the same result."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from typing import Final, Protocol, TypeAlias

from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import NAN, EchoTrace, NavSample, Notice, Ping
from auv_mcm.settings.config import SonarConfig
from auv_mcm.settings.plugins import find_device, remedy
from auv_mcm.settings.port_settings import DEVICE_NAMES
from drivers.clocks import DeviceClock, SourceClock, UtcAnchor, wire_delay_s
from drivers.links.can_frame import CanFrame
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_protocols import CAN_PROTOCOL, text_decoder
from drivers.navigation.nmea_unit import NmeaUnit
from drivers.ports import PortSettings
from drivers.reading_watch import ReadingWatch
from drivers.sonar.sonar_decoder import SonarFrame, SonarItem, SonarReply
from drivers.sonar.sonars import sonar_named
from drivers.vehicle.dialect import VehicleMessage
from drivers.vehicle.vehicles import VehicleSettings, decoder_of

log = logging.getLogger(__name__)

Decoded: TypeAlias = Ping | NavFix | Notice
_EXTENDED: Final = 1 << 31  # bit 31 of a packed identifier, as in Linux's SocketCAN
_ID_BYTES: Final = 4  # of a packed identifier, before the data
_MAX_WORDS: Final = 200  # characters of a device's own words in a notice
_SPOKEN: Final = {"pixse": "nmea0183"}  # bursts of an inertial unit are sentences like others


def pack_can(frame: CanFrame) -> bytes:
    """Pack a CAN frame for a session: identifier, big-endian, with bit 31 set if it is extended; then the data."""
    return (frame.can_id | _EXTENDED * frame.extended).to_bytes(_ID_BYTES, "big") + frame.data


def unpack_can(data: bytes) -> CanFrame | None:
    """Unpack a frame that `pack_can` packed; return None for other bytes."""
    if len(data) < _ID_BYTES:
        return None
    can_id = int.from_bytes(data[:_ID_BYTES], "big")
    return CanFrame(can_id & ~_EXTENDED, data[_ID_BYTES:], bool(can_id & _EXTENDED))


class _Reader(Protocol):
    @property
    def counters(self) -> Counter[str]: ...

    def n_messages(self) -> int:
        """Return the counters of messages; called with every chunk while nothing can be read."""
        ...

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]: ...

    def finish(self) -> list[Decoded]: ...


def _messages_in(counters: Counter[str]) -> int:
    return sum(count for name, count in counters.items() if name.endswith(".messages"))


class PortStream:
    """Decode one port's bytes to pings and fixes.

    Never raises: a decoder that raises has a defect, which is counted and reported, and the decoder is started anew.

    counters: those of the device's decoder and clock, sonar.accepted, sonar.refused, sonar.second_side, decoder.failed.
    """

    def __init__(self, port: PortSettings, sonar: SonarConfig, utc: UtcAnchor) -> None:
        """utc: shared by all ports; followed before the bytes are fed."""
        self._port, self._sonar, self._utc = port, sonar, utc
        self._before: Counter[str] = Counter()  # of decoders that failed
        self._vehicle_before: Counter[str] = Counter()
        self._reader = self._new_reader()
        # What a bus gives are whole frames; that an adapter gives none is its link's affair.
        self._watch = None if port.is_bus else ReadingWatch(port.name, port.device, port.address.place, port.baud)

    @property
    def counters(self) -> Counter[str]:
        return self._before + self._reader.counters

    @property
    def heard(self) -> list[VehicleMessage]:
        """Return the vehicle's messages in what was fed last; empty for other devices."""
        return self._reader.heard if isinstance(self._reader, _VehicleReader) else []

    @property
    def vehicle_counters(self) -> Counter[str]:
        """Return all counters of the vehicle's decoder."""
        return self._vehicle_before + (
            self._reader.decoder.counters if isinstance(self._reader, _VehicleReader) else Counter()
        )

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]:
        """Return the events that a chunk completes, in order. stamp: when its last byte was read."""
        try:
            decoded = self._reader.feed(data, stamp)
        except Exception as error:
            decoded = self._survive(error)
        notice = None if self._watch is None else self._watch.heard(len(data), stamp.mono_ns, self._n_messages)
        return decoded if notice is None else [*decoded, notice]

    def finish(self) -> list[Decoded]:
        """Return the events that the end of a session completes."""
        try:
            return self._reader.finish()
        except Exception as error:
            return self._survive(error)

    def _n_messages(self) -> int:
        return _messages_in(self._before) + self._reader.n_messages()

    def _new_reader(self) -> _Reader:
        port = self._port
        if port.is_sonar:
            return _SonarReader(port, self._sonar, self._utc)
        if port.vehicle is not None:
            return _VehicleReader(port, port.vehicle)
        if port.device == CAN_PROTOCOL:
            return _BusReader(port.name)
        return _UnitReader(port)

    def _survive(self, error: Exception) -> list[Decoded]:
        before, vehicle_before = self.counters, self.vehicle_counters
        try:
            self._reader = self._new_reader()
        except UsageError:  # another package's maker, which worked before: the decoder at hand goes on
            log.exception("the decoder of port '%s' cannot be made again", self._port.name)
        else:
            self._before, self._vehicle_before = before, vehicle_before
        self._before["decoder.failed"] += 1
        if self._before["decoder.failed"] > 1:
            return []
        log.error("the decoder of port '%s' failed", self._port.name, exc_info=error)
        text = (
            f"the decoder of port '{self._port.name}' failed ({error!r}) and was started anew; what it was reading is "
            f"lost. {_remedy(self._port.device)} with the log and the recording."
        )
        return [Notice(code="decoder_failed", text=text, place=self._port.name)]


def slow_decoder(name: str, device: str, n_bytes: int, took_s: float) -> Notice:
    """Report a decoder that held up everything else."""
    text = (
        f"decoding {n_bytes} bytes of port '{name}' took {took_s:.1f} s, in which nothing else was read or sent: bytes "
        "of other ports may be lost, and a vehicle takes control back. Look whether this computer is overloaded; if "
        f"not: {_remedy(device)} with the log. Further ones are not reported."
    )
    return Notice(code="decoder_slow", text=text, place=name)


def _remedy(device: str) -> str:
    plugin = None if device in DEVICE_NAMES else find_device(device)
    return "This is a defect: report it" if plugin is None else remedy(plugin)


class _UnitReader:
    def __init__(self, port: PortSettings) -> None:
        self._decoder = text_decoder(_SPOKEN.get(port.device, port.device), port.name)

    @property
    def counters(self) -> Counter[str]:
        return self._decoder.counters

    def n_messages(self) -> int:
        return _messages_in(self._decoder.counters)

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]:
        return [*self._decoder.feed(data, stamp), *self._notices()]

    def finish(self) -> list[Decoded]:
        return [*self._decoder.finish(), *self._notices()]

    def _notices(self) -> list[Notice]:
        return self._decoder.take_notices() if isinstance(self._decoder, NmeaUnit) else []


class _BusReader:
    """Decode a bus; each chunk is one packed frame."""

    def __init__(self, name: str) -> None:
        self._bus = N2kBus(name)
        self._own: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        return self._bus.counters + self._own

    def n_messages(self) -> int:
        return _messages_in(self._bus.counters)

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]:
        frame = unpack_can(data)
        if frame is None or not frame.extended:
            self._own["n2k.not_extended"] += 1
            return []
        return [*self._bus.feed(frame.can_id, frame.data, stamp)]

    def finish(self) -> list[Decoded]:
        return []


class _VehicleReader:
    """Decode the vehicle's position, if it is wanted, and the units on its bus.

    A talker takes other messages from `heard`.
    """

    def __init__(self, port: PortSettings, settings: VehicleSettings) -> None:
        self._port = port
        self.decoder = decoder_of(port.device, settings, port.name)
        self.heard: list[VehicleMessage] = []

    @property
    def counters(self) -> Counter[str]:
        """Return the counters of messages and of a bus; the others are counted once, with those of the pilot."""
        messages = Counter({key: count for key, count in self.decoder.counters.items() if key.endswith(".messages")})
        return messages + self.decoder.bus_counters

    def n_messages(self) -> int:
        return _messages_in(self.decoder.counters) + _messages_in(self.decoder.bus_counters)

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]:
        self.heard = []
        item = unpack_can(data) if self._port.is_bus else data
        if item is None:
            return []
        self.heard = self.decoder.feed(item, stamp)
        return [] if self._port.unit is None else [fix for message in self.heard for fix in message.fixes]

    def finish(self) -> list[Decoded]:
        self.heard = []
        return []


class _SonarReader:
    def __init__(self, port: PortSettings, sonar: SonarConfig, utc: UtcAnchor) -> None:
        device = sonar_named(port.device)
        self._port, self._sonar = port, sonar
        # Whoever states how a head is mounted states it of its channel numbers.
        is_stated = port.sides != "as_told"
        self._decoder = device.decoder(structs.replace(sonar, sides="by_number") if is_stated else sonar)
        self._device_clock = DeviceClock(f"port '{port.name}'", wrap_s=device.counter_period_s)
        self._clock = SourceClock(self._device_clock, utc)
        self._own: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        return self._decoder.counters + self._device_clock.counters + self._own

    def n_messages(self) -> int:
        return _messages_in(self._decoder.counters)

    def feed(self, data: bytes, stamp: Stamp) -> list[Decoded]:
        return self._decoded(self._decoder.feed(data, stamp))

    def finish(self) -> list[Decoded]:
        return self._decoded(self._decoder.finish())

    def _decoded(self, items: Sequence[SonarItem]) -> list[Decoded]:
        decoded: list[Decoded] = []
        for item in items:
            if isinstance(item, SonarFrame):
                decoded += self._of_frame(item)
            elif isinstance(item, Notice):
                decoded.append(structs.replace(item, place=self._port.name))
            else:
                decoded += self._of_reply(item)
        return decoded

    def _of_reply(self, reply: SonarReply) -> list[Decoded]:
        self._own["sonar.accepted" if reply.accepted else "sonar.refused"] += 1
        if reply.accepted or self._own["sonar.refused"] > 1:
            return []
        words = f": {reply.text[:_MAX_WORDS]}" if reply.text else ""
        text = f"the sonar at port '{self._port.name}' refused command {reply.request}{words}"
        return [
            Notice(
                code="sonar_refused",
                text=f"{text}. It keeps its earlier settings. Further refusals are only counted.",
                place=self._port.name,
            )
        ]

    def _of_frame(self, frame: SonarFrame) -> list[Decoded]:
        name = self._port.name
        traces = [trace for trace in (frame.port, frame.starboard) if trace is not None]
        far_m: float = max(trace.first_range_m + trace.spacing_m * (trace.samples.shape[0] - 0.5) for trace in traces)
        echo_s = 2.0 * far_m / frame.sound_speed_mps
        delay_s = wire_delay_s(frame.n_bytes, self._port.baud) + echo_s
        time = self._clock.time(frame.device_time_s, frame.received, delay_s=delay_s, number=frame.number)
        decoded: list[Decoded] = [] if time.notice is None else [time.notice]
        if frame.navigation is not None and self._port.unit is not None:
            decoded.append(_fix(name, frame, frame.navigation, echo_s))
        sound_speed_mps = self._sonar.sound_speed_mps or frame.sound_speed_mps
        port, starboard = (_rescaled(trace, sound_speed_mps / frame.sound_speed_mps) for trace in self._sides(frame))
        decoded.append(
            Ping(
                number=frame.number,
                time_s=time.utc_ns * 1e-9,
                port=port,
                starboard=starboard,
                sound_speed_mps=sound_speed_mps,
                altitude_m=frame.altitude_m,
                place=f"port '{name}', ping {frame.number}",
                transfer=frame.transfer,
            )
        )
        return decoded

    def _sides(self, frame: SonarFrame) -> tuple[EchoTrace | None, EchoTrace | None]:
        """Return port and starboard as the head is mounted."""
        if self._port.sides == "swapped":
            return frame.starboard, frame.port
        if self._port.sides not in ("port", "starboard"):
            return frame.port, frame.starboard
        if frame.port is not None and frame.starboard is not None:
            self._own["sonar.second_side"] += 1
        only = frame.starboard if frame.port is None else frame.port
        return (only, None) if self._port.sides == "port" else (None, only)


def _rescaled(trace: EchoTrace | None, factor: float) -> EchoTrace | None:
    if trace is None or factor == 1.0:
        return trace
    return structs.replace(trace, first_range_m=factor * trace.first_range_m, spacing_m=factor * trace.spacing_m)


def _fix(source: str, frame: SonarFrame, navigation: NavSample, echo_s: float) -> NavFix:
    """Make a fix of the navigation in a sonar's message.

    It holds at the transmission; the echoes took echo_s to return.
    """
    return NavFix(
        source=source,
        received=frame.received,
        n_bytes=frame.n_bytes,
        time_utc_s=frame.device_time_s if frame.device_time_is_utc else None,
        age_s=echo_s,
        latitude_deg=navigation.latitude_deg,
        longitude_deg=navigation.longitude_deg,
        heading_rad=navigation.heading_rad,
        pitch_rad=navigation.pitch_rad,
        roll_rad=navigation.roll_rad,
        depth_m=navigation.depth_m,
        altitude_m=navigation.altitude_m if navigation.altitude_m > 0.0 else NAN,
        speed_mps=navigation.speed_mps,
    )
