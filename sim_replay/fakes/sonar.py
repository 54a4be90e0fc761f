"""Simulate sonars by their makers' manuals: answers to commands, and messages of a ping. No ports, no clocks."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Ping
from drivers.framing import Framer
from drivers.sonar import jsf_messages as jsf
from drivers.sonar import ping_messages as ping_protocol
from drivers.sonar.imagenex import (
    BOTH,
    COMMAND_BYTES,
    RANGES_M,
    IgxReturn,
    SwitchCommand,
    decode_command,
    encode_return,
)
from drivers.sonar.jsf import HIGH_FREQUENCY, JsfGrammar
from drivers.sonar.ping_protocol import PingGrammar

_DYNAMIC_RANGE_DB: Final = 90.0  # of a profile, below its strongest echo
_FREQUENCY_HZ: Final = 450_000  # Hz, of a usual side-scan
_COUNTER_MS: Final = 2**32  # ms after which a 32-bit counter starts over
_JSF_INTERVAL_FRACTION: Final = 256  # of a nanosecond
_U16: Final = 65535  # largest value of 16 bits


class DeviceTime(NamedTuple):
    """Hold a device's clocks. since_power_up_s: by its own counter. utc_s: by its clock, seconds since 1970."""

    since_power_up_s: float
    utc_s: float


class FakeSonar(Protocol):
    """Play a sonar as its manual describes it.

    settings: the last command, for reports; "" before.
    """

    @property
    def settings(self) -> str:
        """Describe how the sonar was set, "" if it was not."""

    def power_up(self) -> None:
        """Forget all settings."""
        ...

    def ping(self, ping: Ping, time: DeviceTime) -> list[bytes]:
        """Return messages about a transmission at `time`; none while it does not ping, or until it is polled."""
        ...

    def heard(self, data: bytes, time: DeviceTime) -> list[bytes]:
        """Return answers to the host's bytes."""
        ...


class PingProtocolSonar:
    """Simulate two heads of an Omniscan 450 on one wire; channel 0 looks to port. It is silent until enabled.

    A range or number of results other than the mission's is made from it by interpolation; beyond its end there is
    nothing.
    """

    def __init__(self) -> None:
        self.power_up()

    @property
    def settings(self) -> str:
        """Describe how the sonar was set, "" if it was not."""
        command = self._parameters
        if command is None:
            return ""
        gain = "automatic gain" if command.gain_index < 0 else f"gain {command.gain_index}"
        return (
            f"{'on' if command.enable else 'off'}, {command.length_mm / 1e3:g} m, {gain}, {command.num_results} results"
        )

    def power_up(self) -> None:
        self._framer = Framer(PingGrammar())
        self._parameters: ping_protocol.OsPingParams | None = None
        self._sound_speed_mmps = 1_500_000
        self._number = 0

    def ping(self, ping: Ping, time: DeviceTime) -> list[bytes]:
        command = self._parameters
        if command is None or not command.enable:
            return []
        number, self._number = self._number, self._number + 1
        sides = ((0, ping.port), (1, ping.starboard))
        return [self._profile(command, number, channel, trace, time) for channel, trace in sides if trace is not None]

    def heard(self, data: bytes, time: DeviceTime) -> list[bytes]:
        return [answer for framed in self._framer.feed(data) if (answer := self._answer(framed.message)) is not None]

    def _answer(self, message: ping_protocol.PingMessage) -> bytes | None:
        match ping_protocol.decode(message):
            case ping_protocol.OsPingParams() as command:
                if not (
                    1_000 <= command.length_mm <= 200_000
                    and 200 <= command.num_results <= 1200
                    and -1 <= command.gain_index <= 7
                ):
                    return ping_protocol.encode(ping_protocol.Nack(message.message_id, "out of range"))
                self._parameters = command
                return ping_protocol.encode(ping_protocol.Ack(message.message_id))
            case ping_protocol.SetSpeedOfSound() as speed:
                self._sound_speed_mmps = speed.sound_speed_mmps
                return ping_protocol.encode(ping_protocol.Ack(message.message_id))
            case ping_protocol.GeneralRequest(requested_id=ping_protocol.DEVICE_INFORMATION):
                return ping_protocol.encode(ping_protocol.DeviceInformation(7, 1, 1, 0, 0))
            case ping_protocol.GeneralRequest(requested_id=ping_protocol.PROTOCOL_VERSION):
                return ping_protocol.encode(ping_protocol.ProtocolVersion(1, 0, 0))
            case ping_protocol.GeneralRequest(requested_id=requested):
                return ping_protocol.encode(ping_protocol.Nack(requested, "not known here"))
        return None

    def _profile(
        self, command: ping_protocol.OsPingParams, number: int, channel: int, trace: EchoTrace, time: DeviceTime
    ) -> bytes:
        spacing_m = 1e-3 * command.length_mm / command.num_results
        amplitude = resampled(trace, 1e-3 * command.start_mm + 0.5 * spacing_m, spacing_m, command.num_results)
        intensity = np.square(amplitude)
        loudest_db = 10.0 * math.log10(max(float(intensity.max()), 1.0))
        floor = 10.0 ** (0.1 * (loudest_db - _DYNAMIC_RANGE_DB))
        level = 10.0 * np.log10(np.maximum(intensity, floor)) - (loudest_db - _DYNAMIC_RANGE_DB)
        profile = ping_protocol.OsMonoProfile(
            ping_number=number,
            start_mm=command.start_mm,
            length_mm=command.length_mm,
            timestamp_ms=round(1e3 * time.since_power_up_s) % _COUNTER_MS,
            ping_hz=_FREQUENCY_HZ,
            gain_index=max(command.gain_index, 0),
            sound_speed_dmps=self._sound_speed_mmps // 100,
            channel_number=channel,
            pulse_duration_sec=1e-5,
            analog_gain=1.0,
            max_pwr_db=loudest_db,
            min_pwr_db=loudest_db - _DYNAMIC_RANGE_DB,
            transducer_heading_deg=0.0,
            vehicle_heading_deg=0.0,
            pwr_results=np.rint(level * (_U16 / _DYNAMIC_RANGE_DB)).astype(np.uint16),
        )
        return ping_protocol.encode(profile)


class JsfSonar:
    """Simulate an EdgeTech side-scan of one frequency, silent until pinging is enabled. It records range and gain."""

    def __init__(self) -> None:
        self.power_up()

    @property
    def settings(self) -> str:
        """Describe how the sonar was set."""
        values = ", ".join(f"{name} {value}" for name, value in self._values.items())
        return f"{'on' if self._enabled else 'off'}, {values}" if values else ""

    def power_up(self) -> None:
        self._framer = Framer(JsfGrammar())
        self._values: dict[str, int] = {}
        self._number = 0
        self._sequence = 0

    @property
    def _enabled(self) -> bool:
        return bool(self._values.get("enable"))

    def ping(self, ping: Ping, time: DeviceTime) -> list[bytes]:
        if not self._enabled:
            return []
        number, self._number = self._number, self._number + 1
        sides = ((jsf.PORT, ping.port), (jsf.STARBOARD, ping.starboard))
        return [self._data(ping, number, channel, trace, time.utc_s) for channel, trace in sides if trace is not None]

    def heard(self, data: bytes, time: DeviceTime) -> list[bytes]:
        return [
            answer for framed in self._framer.feed(data) if (answer := self._answer(framed.message, time)) is not None
        ]

    def _answer(self, message: jsf.JsfMessage, time: DeviceTime) -> bytes | None:
        if message.message_type == jsf.SYSTEM_TIME and message.command == jsf.Command.GET:
            return jsf.time_reply(time.utc_s)
        if message.command != jsf.Command.SET:
            return None
        name = {jsf.PING_ENABLE: "enable", jsf.PING_GAIN: "gain", jsf.PING_RANGE: "range_mm"}.get(message.message_type)
        understood = name is not None and message.subsystem == HIGH_FREQUENCY and len(message.body) >= 4
        if name is not None and understood:
            self._values[name] = int.from_bytes(message.body[:4], "little")
        command = jsf.Command.REPLY if understood else jsf.Command.ERROR
        return jsf.to_wire(message._replace(command=command))

    def _data(self, ping: Ping, number: int, channel: int, trace: EchoTrace, utc_s: float) -> bytes:
        range_mm = self._values.get("range_mm", 0)
        n_samples = trace.samples.shape[0]
        if range_mm:
            n_samples = max(1, min(n_samples, round(1e-3 * range_mm / trace.spacing_m)))
        interval = round(2e9 * trace.spacing_m / ping.sound_speed_mps * _JSF_INTERVAL_FRACTION)
        milliseconds = round(1e3 * utc_s)
        altitude_known = math.isfinite(ping.altitude_m)
        header = jsf.SideScanHeader(
            time_s=milliseconds // 1000,
            milliseconds_today=milliseconds % 86_400_000,
            ping_number=number,
            start_depth_samples=max(0, round(trace.first_range_m / trace.spacing_m)),
            lsb_1=interval % _JSF_INTERVAL_FRACTION,
            interval_ns=interval // _JSF_INTERVAL_FRACTION,
            validity=jsf.Validity.SOUND_SPEED | (jsf.Validity.ALTITUDE if altitude_known else 0),
            altitude_mm=round(1e3 * ping.altitude_m) if altitude_known else 0,
            sound_speed_mps=ping.sound_speed_mps,
            start_frequency_dahz=_FREQUENCY_HZ // 10,
            end_frequency_dahz=_FREQUENCY_HZ // 10,
        )
        values = np.clip(np.rint(trace.samples[:n_samples].astype(np.float64)), 0, _U16).astype(np.uint16)
        sequence, self._sequence = self._sequence, (self._sequence + 1) % 256
        return jsf.encode_data(jsf.SideScanData(header, values), HIGH_FREQUENCY, channel, sequence)


class SportScanSonar:
    """Simulate an Imagenex SportScan.

    Each switch command returns both sides of the newest ping, 200 bytes of 0 to 127 each.

    The mean echo of the first ping is its unit of loudness: it is sent as 25 at 20 dB of gain.
    """

    def __init__(self) -> None:
        self.power_up()

    @property
    def settings(self) -> str:
        """Describe how the sonar was set, "" if it was not."""
        command = self._command
        return "" if command is None else f"{command.range_m} m, gain {command.gain_db} dB"

    def power_up(self) -> None:
        self._command: SwitchCommand | None = None
        self._ping: Ping | None = None
        self._unit = 0.0
        self._rest = b""

    def ping(self, ping: Ping, time: DeviceTime) -> list[bytes]:
        if ping.port is not None and ping.starboard is not None:
            self._ping = ping
        return []

    def heard(self, data: bytes, time: DeviceTime) -> list[bytes]:
        self._rest += data
        answers = []
        while (end := self._rest.find(b"\xfd")) >= 0:
            command = decode_command(self._rest[: end + 1][-COMMAND_BYTES:])
            self._rest = self._rest[end + 1 :]
            if command is not None and command.range_m in RANGES_M:
                self._command = command
                answers += self._answer(command)
        self._rest = self._rest[-COMMAND_BYTES:]
        return answers

    def _answer(self, command: SwitchCommand) -> list[bytes]:
        if self._ping is None or self._ping.port is None or self._ping.starboard is None:
            return []
        echo = np.empty(400)
        spacing_m = command.range_m / 200
        for start, trace in enumerate((self._ping.starboard, self._ping.port)):
            echo[start::2] = resampled(trace, 0.5 * spacing_m, spacing_m, 200)
        self._unit = self._unit or max(float(echo.mean()), 1e-9)
        counts = echo * (25.0 / self._unit * 10.0 ** ((command.gain_db - 20) / 20.0))
        return [encode_return(IgxReturn(command.range_m, BOTH, np.clip(np.rint(counts), 0, 127).astype(np.uint8)))]


def resampled(trace: EchoTrace, first_range_m: float, spacing_m: float, n_samples: int) -> NDArray[np.float64]:
    """Resample a trace at other ranges, (n_samples,) float64: linear; 0 beyond half a sample from its ends."""
    values: NDArray[Any] = trace.samples.astype(np.float64)
    at = (first_range_m - trace.first_range_m + spacing_m * np.arange(n_samples)) / trace.spacing_m
    found: NDArray[np.float64] = np.interp(at, np.arange(values.shape[0]), values)
    found[(at < -0.5) | (at > values.shape[0] - 0.5)] = 0.0
    return found
