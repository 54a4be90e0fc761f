"""Write XTF side-scan logs.

What the format cannot hold is lost: one header carries navigation and ping, so navigation is as of the ping's time;
times have 10 ms resolution; angles, depth, altitude, speed (knots) and slant range are float32; positions are float64
degrees.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyxtf
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import NAN, SIDES, EchoTrace, NavSample, Ping, Side
from auv_mcm.safe_files import replacing
from sim_replay.logs.xtf_fields import KNOT_MPS
from sim_replay.logs.xtf_header import LATITUDE_LONGITUDE, PORT, STARBOARD
from sim_replay.logs.xtf_samples import SampleType

_SAMPLE_FORMAT: Final[dict[SampleType, int]] = {"uint8": 8, "uint16": 3, "float32": 5}
_CHANNEL: Final[dict[Side, int]] = {"port": PORT, "starboard": STARBOARD}
_ALIGNMENT: Final = 64  # bytes: packets are a multiple of it (XTF)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def write_xtf(
    path: str | os.PathLike[str],
    events: Iterable[NavSample | Ping],
    *,
    sample_type: SampleType = "uint16",
    port_far_to_near: bool = True,
    sides: tuple[Side, ...] = SIDES,
    frequency_khz: float = 0.0,
) -> int:
    """Write one log, a ping at a time, whole or not at all; returns the number of pings.

    A quantity that a NavSample does not give keeps its last value; one that was never given is zero for a position and
    an altitude (which readers take as unknown) and NaN else. A side that a ping lacks is left out of its packet. Raises
    UsageError where samples do not fit into `sample_type`.
    """
    channels = tuple(sides)
    navigation = NavSample(time_s=NAN)
    n_pings = 0
    with replacing(Path(path), durable=False) as file:
        file.write(bytes(_file_header(channels, sample_type, frequency_khz)))
        for event in events:
            if isinstance(event, NavSample):
                navigation = _merged(navigation, event)
            else:
                file.write(_ping_packet(event, navigation, channels, sample_type, port_far_to_near))
                n_pings += 1
    return n_pings


def _file_header(sides: tuple[Side, ...], sample_type: SampleType, frequency_khz: float) -> Any:
    header = pyxtf.XTFFileHeader()
    header.RecordingProgramName = b"auv_mcm"
    header.RecordingProgramVersion = b"1"
    header.SonarName = b"side scan"
    header.NavUnits = LATITUDE_LONGITUDE
    header.NumberOfSonarChannels = len(sides)
    for info, side in zip(header.ChanInfo, sides, strict=False):
        info.TypeOfChannel = _CHANNEL[side]
        info.SubChannelNumber = sides.index(side)
        info.CorrectionFlags = 1  # slant range
        info.UniPolar = 1
        info.BytesPerSample = np.dtype(sample_type).itemsize
        info.SampleFormat = _SAMPLE_FORMAT[sample_type]
        info.ChannelName = side.encode()
        info.Frequency = frequency_khz
    return header


def _merged(known: NavSample, new: NavSample) -> NavSample:
    values = {name: getattr(new, name) for name in NavSample.__struct_fields__}
    return NavSample(**{name: getattr(known, name) if math.isnan(value) else value for name, value in values.items()})


def _ping_packet(
    ping: Ping, nav: NavSample, sides: tuple[Side, ...], sample_type: SampleType, port_far_to_near: bool
) -> bytes:
    body = b""
    n_channels = 0
    for number, side in enumerate(sides):
        trace = ping.port if side == "port" else ping.starboard
        if trace is not None:
            body += _channel(number, trace, ping, sample_type, turned=side == "port" and port_far_to_near)
            n_channels += 1
    header = pyxtf.XTFPingHeader()
    header.NumChansToFollow = n_channels
    header.PingNumber = ping.number
    header.SoundVelocity = ping.sound_speed_mps
    _set_time(header, ping.time_s)
    header.SensorYcoordinate = 0.0 if math.isnan(nav.latitude_deg) else nav.latitude_deg
    header.SensorXcoordinate = 0.0 if math.isnan(nav.longitude_deg) else nav.longitude_deg
    header.SensorHeading = math.degrees(nav.heading_rad)
    header.SensorPitch = math.degrees(nav.pitch_rad)
    header.SensorRoll = math.degrees(nav.roll_rad)
    header.SensorDepth = nav.depth_m
    header.SensorSpeed = nav.speed_mps / KNOT_MPS
    altitude = ping.altitude_m if math.isnan(nav.altitude_m) else nav.altitude_m
    header.SensorPrimaryAltitude = 0.0 if math.isnan(altitude) else altitude
    length = len(bytes(header)) + len(body)
    padding = -length % _ALIGNMENT
    header.NumBytesThisRecord = length + padding
    return bytes(header) + body + bytes(padding)


def _channel(number: int, trace: EchoTrace, ping: Ping, sample_type: SampleType, *, turned: bool) -> bytes:
    samples = _as_type(trace.samples, sample_type, ping)
    n_samples = samples.shape[0]
    header = pyxtf.XTFPingChanHeader()
    header.ChannelNumber = number
    header.SlantRange = trace.spacing_m * n_samples
    header.TimeDuration = 2.0 * header.SlantRange / ping.sound_speed_mps
    delay_m = trace.first_range_m - 0.5 * trace.spacing_m
    header.TimeDelay = 2.0 * delay_m / ping.sound_speed_mps if abs(delay_m) > 1e-6 * trace.spacing_m else 0.0
    header.NumSamples = n_samples
    return bytes(header) + (samples[::-1] if turned else samples).tobytes()


def _as_type(samples: NDArray[Any], sample_type: SampleType, ping: Ping) -> NDArray[Any]:
    dtype = np.dtype(sample_type).newbyteorder("<")
    if samples.dtype == dtype:
        return samples
    with np.errstate(invalid="ignore", over="ignore"):
        converted = samples.astype(dtype)
    if not np.array_equal(converted, samples, equal_nan=samples.dtype.kind == "f"):
        raise UsageError(
            f"ping {ping.number}: its {samples.dtype} samples do not fit into {sample_type}. Write them as float32."
        )
    return converted


def _set_time(header: Any, time_s: float) -> None:
    hundredths = round(time_s * 100.0)
    when = _EPOCH + timedelta(seconds=hundredths // 100)
    header.Year, header.Month, header.Day = when.year, when.month, when.day
    header.Hour, header.Minute, header.Second = when.hour, when.minute, when.second
    header.HSeconds = hundredths % 100
    header.JulianDay = when.timetuple().tm_yday
