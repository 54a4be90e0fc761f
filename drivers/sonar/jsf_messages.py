"""Decode and encode EdgeTech's JSF: the side-scan data message (type 80) and the commands that an AUV needs.

Layout (EdgeTech, "JSF Data File Description", 0023492 rev. M), little-endian. Every field keeps the number on the wire;
properties give them their units. A log (.jsf) is the same stream, stored.
"""

from __future__ import annotations

from datetime import date
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

SYNC: Final = 0x1601  # first two bytes of every message
HEADER: Final = Struct("<HBBHBBBBHI")
HEADER_BYTES: Final = HEADER.size
VERSION: Final = 0x0E  # of the protocol, as written
PORT, STARBOARD = 0, 1  # channel

SYSTEM_TIME, ALIVE, SIDE_SCAN, DATA_ACTIVE = 22, 41, 80, 83
PING_ENABLE, PING_GAIN, PING_TRIGGER, PING_RANGE, PING_AUTOSELECT = 120, 121, 125, 128, 133


class Command(IntEnum):
    """Name the bytes for what a message is: an order, a question, or an answer."""

    SET = 0
    GET = 1
    REPLY = 2
    ERROR = 3


class Validity:
    """Name the bits of the data message's validity: which of its fields hold a value."""

    POSITION = 1 << 0
    COURSE = 1 << 1
    SPEED = 1 << 2
    HEADING = 1 << 3
    PRESSURE = 1 << 4
    PITCH_ROLL = 1 << 5
    ALTITUDE = 1 << 6
    HEAVE = 1 << 7
    TEMPERATURE = 1 << 8
    DEPTH = 1 << 9
    SOUND_SPEED = 1 << 14


class PositionUnits(IntEnum):
    """Name the units of longitude and latitude."""

    MILLIMETRES = 1
    ARC_MINUTES_1E_4 = 2
    DECIMETRES = 3
    CENTIMETRES = 4


class DataFormat(IntEnum):
    """Name what samples are."""

    ENVELOPE = 0  # u16
    ANALYTIC = 1  # i16 real, imaginary
    RAW = 2  # i16 before the matched filter
    REAL = 3  # i16 real part of the analytic signal
    UNMATCHED_ANALYTIC = 9  # i16 real, imaginary


USED_FORMATS: Final = (DataFormat.ENVELOPE, DataFormat.ANALYTIC, DataFormat.REAL)  # of which traces are made
_MAX_FORMAT: Final = 255  # beyond it the samples are in a form of EdgeTech's own
_TWO_VALUES_PER_SAMPLE: Final = (DataFormat.ANALYTIC, DataFormat.UNMATCHED_ANALYTIC)


class JsfMessage(NamedTuple):
    """Hold a message as sent. subsystem: 20, 21, 22 are the low, high and very high side-scan."""

    message_type: int
    body: bytes
    command: int = Command.SET
    subsystem: int = 0
    channel: int = 0
    sequence: int = 0
    session: int = 0
    version: int = VERSION
    reserved: int = 0


class SideScanHeader(NamedTuple):
    """Hold the 240 bytes before the samples, in order; bytes not listed are zero.

    samples_low, start_frequency_dahz, end_frequency_dahz: low 16 bits; `msb` has four more of each.
    """

    time_s: int = 0
    start_depth_samples: int = 0
    ping_number: int = 0
    msb: int = 0
    lsb_1: int = 0
    lsb_2: int = 0
    id_code: int = 1
    validity: int = 0
    data_format: int = DataFormat.ENVELOPE
    antenna_aft_cm: int = 0
    antenna_starboard_cm: int = 0
    pipe_km: float = 0.0
    heave_m: float = 0.0
    gap_filler_lateral_m: float = 0.0
    longitude: int = 0
    latitude: int = 0
    units: int = PositionUnits.ARC_MINUTES_1E_4
    annotation: bytes = bytes(24)
    samples_low: int = 0
    interval_ns: int = 0
    adc_gain: int = 0
    transmit_level_percent: int = 0
    start_frequency_dahz: int = 0
    end_frequency_dahz: int = 0
    sweep_ms: int = 0
    pressure_mpsi: int = 0
    depth_mm: int = 0
    sample_frequency_hz: int = 0
    pulse_id: int = 0
    altitude_mm: int = 0
    sound_speed_mps: float = 0.0
    mixer_hz: float = 0.0
    year: int = 0
    day_of_year: int = 0
    hour: int = 0
    minute: int = 0
    second: int = 0
    time_basis: int = 3
    weighting: int = 0
    pulses_in_water: int = 0
    heading_cdeg: int = 0
    pitch_counts: int = 0
    roll_counts: int = 0
    trigger_source: int = 0
    mark_low: int = 0
    course_deg: int = 0
    speed_dkn: int = 0
    milliseconds_today: int = 0
    max_adc: int = 0
    software_version: bytes = bytes(6)
    packet_number: int = 0
    water_temperature_ddeg: int = 0
    layback_m: float = 0.0
    cable_out_dm: int = 0

    @property
    def n_samples(self) -> int:
        """Count the samples, from both of its fields."""
        return self.samples_low | (self.msb >> 8 & 0xF) << 16

    @property
    def sample_interval_s(self) -> float:
        """Compute the time between samples, s."""
        return 1e-9 * (self.interval_ns + (self.lsb_1 & 0xFF) / 256.0)

    @property
    def heading_deg(self) -> float:
        """Return the heading, which older sonars state from -180 to 180 degrees."""
        return 0.01 * (self.heading_cdeg if self.heading_cdeg <= 36_000 else self.heading_cdeg - 65_536) % 360.0

    @property
    def stated_sound_speed_mps(self) -> float | None:
        """Return the sound speed where the message states one that is water's."""
        is_valid = self.validity & Validity.SOUND_SPEED and 1300.0 <= self.sound_speed_mps <= 1700.0
        return self.sound_speed_mps if is_valid else None

    @property
    def start_frequency_hz(self) -> int:
        """Return the frequency at which the sweep starts, from both of its fields."""
        return 10 * (self.start_frequency_dahz | (self.msb & 0xF) << 16)

    @property
    def end_frequency_hz(self) -> int:
        """Return the frequency at which the sweep ends, from both of its fields."""
        return 10 * (self.end_frequency_dahz | (self.msb >> 4 & 0xF) << 16)

    @property
    def utc_s(self) -> float:
        """Return the time of the ping, UTC seconds since 1970; 0 where the sonar's clock was never set.

        Seconds since 1970 came with version 8 of the protocol; before it, year, day of the year and time serve.
        """
        milliseconds = 1e-3 * (self.milliseconds_today % 1000)
        if self.time_s > 0:
            return self.time_s + milliseconds
        year = self.year + (0 if self.year >= 100 or self.year <= 0 else 1900 if self.year >= 80 else 2000)
        is_date = _FIRST_YEAR <= year <= _LAST_YEAR and 1 <= self.day_of_year <= 366
        if not is_date or not (0 <= self.hour < 24 and 0 <= self.minute < 60 and 0 <= self.second <= 60):
            return 0.0
        days = date(year, 1, 1).toordinal() - _EPOCH_DAYS + self.day_of_year - 1
        return 86_400.0 * days + 3600.0 * self.hour + 60.0 * self.minute + self.second + milliseconds


DATA_HEADER: Final = Struct("<iII4x3H6xhHxxh2h4xff24xfiih24sHIHh2xHHHiiHHiff5hhhhHhh4xhH6xhh4xIH4x6s4xH4xhf4xH2x")
DATA_HEADER_BYTES: Final = DATA_HEADER.size
_FIRST_YEAR, _LAST_YEAR = 1980, 2200  # of dates: what is outside was never set, or is damage
_EPOCH_DAYS: Final = date(1970, 1, 1).toordinal()
_DATA_FORMAT: Final = Struct("<h")
_SAMPLES: Final = Struct("<H96xH")  # msb at 16, low 16 bits at 114


PRESSURE, DOPPLER = 2060, 2080
_SOUND_SPEED_IN: Final = {PRESSURE: Struct("<32xI"), DOPPLER: Struct("<56xH")}
_SOUND_SPEED_UNITS_MPS: Final = (1.0, 1e-3)  # m/s per count: the description says mm/s, and writers use m/s as well


def sound_speed_in(message: JsfMessage) -> float | None:
    """Read the sound speed, m/s, in a pressure sensor's or a Doppler log's message; None where it holds none.

    Believed by its value alone, since revisions of the description differ about the flags.
    """
    field = _SOUND_SPEED_IN.get(message.message_type)
    if field is None or len(message.body) < field.size:
        return None
    (count,) = field.unpack_from(message.body)
    possible = (unit * count for unit in _SOUND_SPEED_UNITS_MPS)
    return next((speed_mps for speed_mps in possible if 1300.0 <= speed_mps <= 1700.0), None)


class SideScanData(NamedTuple):
    """Hold one side of one ping.

    values: (n_samples,) uint16 envelope, or (n_values,) int16 for the other formats, as recorded.
    """

    header: SideScanHeader
    values: NDArray[np.uint16] | NDArray[np.int16]


def to_wire(message: JsfMessage) -> bytes:
    """Encode the message. Raises struct.error for numbers that do not fit their field."""
    head = HEADER.pack(
        SYNC,
        message.version,
        message.session,
        message.message_type,
        message.command,
        message.subsystem,
        message.channel,
        message.sequence,
        message.reserved,
        len(message.body),
    )
    return head + message.body


def encode_data(data: SideScanData, subsystem: int, channel: int, sequence: int = 0) -> bytes:
    """Encode a data message, with its number of samples from `values`."""
    n_samples = data.values.shape[0] // values_per_sample(data.header.data_format)
    header = data.header._replace(
        samples_low=n_samples & 0xFFFF, msb=data.header.msb & 0xF0FF | (n_samples >> 16 & 0xF) << 8
    )
    kind = "<u2" if header.data_format == DataFormat.ENVELOPE else "<i2"
    body = DATA_HEADER.pack(*header) + data.values.astype(kind, copy=False).tobytes()
    return to_wire(JsfMessage(SIDE_SCAN, body, subsystem=subsystem, channel=channel, sequence=sequence))


def decode_data(body: bytes) -> SideScanData | None:
    """Decode the body of a data message; None if it is shorter than it declares."""
    if len(body) < DATA_HEADER_BYTES:
        return None
    header = SideScanHeader(*DATA_HEADER.unpack_from(body))
    is_own = not 0 <= header.data_format <= _MAX_FORMAT
    n_values = 0 if is_own else header.n_samples * values_per_sample(header.data_format)
    if len(body) < DATA_HEADER_BYTES + 2 * n_values:
        return None
    kind = "<u2" if header.data_format == DataFormat.ENVELOPE else "<i2"
    return SideScanData(header, np.frombuffer(body, dtype=kind, count=n_values, offset=DATA_HEADER_BYTES))


def declared_data_bytes(buffer: bytearray, body_at: int) -> int | None:
    """Return the bytes of body that a data message declares, None for a form of EdgeTech's own.

    Its first 116 bytes of body must be there.
    """
    msb, low = _SAMPLES.unpack_from(buffer, body_at + 16)
    (data_format,) = _DATA_FORMAT.unpack_from(buffer, body_at + 34)
    if not 0 <= data_format <= _MAX_FORMAT:
        return None
    n_samples: int = low | (msb >> 8 & 0xF) << 16
    return DATA_HEADER_BYTES + 2 * values_per_sample(data_format) * n_samples


def values_per_sample(data_format: int) -> int:
    """Return how many numbers a sample has: 2 if it is complex."""
    return 2 if data_format in _TWO_VALUES_PER_SAMPLE else 1


def amplitude(data: SideScanData) -> NDArray[np.float32]:
    """Return the (n_samples,) float32 amplitude of envelope or analytic samples, value * 2^-weighting.

    Where only the real part is stored, its magnitude stands for it.
    """
    values = data.values.astype(np.float32)
    if data.header.data_format == DataFormat.ANALYTIC:
        values = np.hypot(values[0::2], values[1::2])
    elif data.header.data_format == DataFormat.REAL:
        np.abs(values, out=values)
    return np.ldexp(values, -data.header.weighting, out=values)


def set_value(message_type: int, value: int, subsystem: int) -> bytes:
    """Encode a command with one number.

    PING_RANGE in mm, PING_GAIN, PING_ENABLE 0 or 1, PING_TRIGGER, DATA_ACTIVE, PING_AUTOSELECT.
    """
    return to_wire(JsfMessage(message_type, value.to_bytes(4, "little"), Command.SET, subsystem))


_TIME: Final = Struct("<II")


def time_reply(utc_s: float) -> bytes:
    """Encode the answer to a time request, to the millisecond. utc_s: seconds since 1970."""
    milliseconds = round(1e3 * utc_s)
    return to_wire(JsfMessage(SYSTEM_TIME, _TIME.pack(milliseconds // 1000, milliseconds % 1000), Command.REPLY))


def read_time(body: bytes) -> float | None:
    """Return the seconds since 1970 of a time reply; None for other messages."""
    if len(body) < _TIME.size:
        return None
    seconds, milliseconds = _TIME.unpack_from(body)
    return float(seconds + 1e-3 * milliseconds) if milliseconds < 1000 else None
