"""Small XTF logs for tests, and byte-level access to spoil them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyxtf
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.xtf import XtfLog
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.logs.xtf_writer import write_xtf
from tests.make.records import nav_of

FILE_HEADER = 1024
START_S = 1_700_000_000.0
RANGE_M = 12.0


def samples(seed: int, n_samples: int = 96, dtype: str = "uint16") -> NDArray[Any]:
    """Near to far: a bright transmission, dark water, sea floor from a quarter of the range on."""
    random = np.random.default_rng(seed)
    level = np.where(np.arange(n_samples) < n_samples // 4, 4.0, 120.0)
    level[:2] = 250.0
    return np.clip(level * random.uniform(0.6, 1.02, n_samples), 0, 255).astype(dtype)


def trace(seed: int, n_samples: int = 96, dtype: str = "uint16", range_m: float = RANGE_M) -> EchoTrace:
    spacing = range_m / n_samples
    return EchoTrace(samples=samples(seed, n_samples, dtype), first_range_m=0.5 * spacing, spacing_m=spacing)


def ping(
    number: int, *, time_s: float | None = None, n_samples: int = 96, dtype: str = "uint16", starboard: bool = True
) -> Ping:
    return Ping(
        number=number,
        time_s=START_S + 0.1 * number if time_s is None else time_s,
        port=trace(2 * number, n_samples, dtype),
        starboard=trace(2 * number + 1, n_samples, dtype) if starboard else None,
        altitude_m=3.0,
    )


def navigation(number: int, *, time_s: float | None = None) -> NavSample:
    return nav_of(
        START_S + 0.1 * number if time_s is None else time_s,
        latitude_deg=43.0 + 1e-6 * number,
        longitude_deg=5.5 - 2e-6 * number,
        heading_rad=math.radians(30.0 + 0.25 * number),
        pitch_rad=math.radians(-2.5),
        roll_rad=math.radians(1.25),
        depth_m=17.0,
        altitude_m=3.0,
    )


def mission(n_pings: int) -> Iterator[NavSample | Ping]:
    yield from navigated(ping(number) for number in range(n_pings))


def navigated(pings: Iterable[Ping]) -> Iterator[NavSample | Ping]:
    """The pings with navigation of their own each."""
    for p in pings:
        yield navigation(p.number, time_s=p.time_s)
        yield p


def written(
    path: Path, events: Iterable[NavSample | Ping] | int = 8, sample_type: SampleType = "uint16", **options: Any
) -> Path:
    """A log of these events, or of a plain mission of so many pings."""
    write_xtf(path, mission(events) if isinstance(events, int) else events, sample_type=sample_type, **options)
    return path


def packet_offsets(data: bytes) -> list[int]:
    """Where packets start in an undamaged log."""
    offsets = []
    offset = FILE_HEADER
    while offset < len(data):
        offsets.append(offset)
        offset += int.from_bytes(data[offset + 10 : offset + 14], "little")
    return offsets


def edit_headers(path: Path, change: Callable[[int, Any], None]) -> None:
    """Apply `change(index, XTFPingHeader)` to every ping header of an undamaged log."""
    data = bytearray(path.read_bytes())
    for index, offset in enumerate(packet_offsets(bytes(data))):
        change(index, pyxtf.XTFPingHeader.from_buffer(data, offset))
    path.write_bytes(data)


def edit_channels(path: Path, change: Callable[[int, int, Any], None]) -> None:
    """Apply `change(index, channel, XTFPingChanHeader)` to every channel header of an undamaged log of two equal
    channels."""
    data = bytearray(path.read_bytes())
    for index, offset in enumerate(packet_offsets(bytes(data))):
        first = pyxtf.XTFPingChanHeader.from_buffer(data, offset + 256)
        width = pyxtf.XTFFileHeader.from_buffer(data).ChanInfo[0].BytesPerSample
        second = pyxtf.XTFPingChanHeader.from_buffer(data, offset + 256 + 64 + first.NumSamples * width)
        change(index, 0, first)
        change(index, 1, second)
    path.write_bytes(data)


def edit_file_header(path: Path, change: Callable[[Any], None]) -> None:
    """Apply `change(XTFFileHeader)`."""
    data = bytearray(path.read_bytes())
    change(pyxtf.XTFFileHeader.from_buffer(data))
    path.write_bytes(data)


def read(path: Path, **sonar: Any) -> tuple[list[SourceEvent], XtfLog]:
    """All events of a log, and the log with its counters."""
    log = XtfLog(path, SonarConfig(**{"port_order": "far_to_near", **sonar}))
    return list(log), log


def pings_of(events: Iterable[SourceEvent]) -> list[Ping]:
    return [event for event in events if isinstance(event, Ping)]


def navigation_of(events: Iterable[SourceEvent]) -> list[NavSample]:
    return [event for event in events if isinstance(event, NavSample)]


def codes_of(events: Iterable[SourceEvent]) -> list[str]:
    return [event.code for event in events if isinstance(event, Notice)]


def same_trace(a: EchoTrace | None, b: EchoTrace | None) -> bool:
    """Equal samples; ranges equal within float32."""
    if a is None or b is None:
        return a is b
    return (
        a.samples.dtype == b.samples.dtype
        and np.array_equal(a.samples, b.samples)
        and math.isclose(a.spacing_m, b.spacing_m, rel_tol=2e-7)
        and math.isclose(a.first_range_m, b.first_range_m, rel_tol=1e-6)
    )


# --- channels, however packets hold them ---

FOUR = [(1, "port", 100.0), (2, "stbd", 100.0), (1, "port", 450.0), (2, "stbd", 450.0)]


class Stored(NamedTuple):
    """One channel of one ping as a recorder writes it."""

    header: bytearray
    samples: bytes

    def with_fields(self, **fields: Any) -> Stored:
        header = bytearray(self.header)
        view = pyxtf.XTFPingChanHeader.from_buffer(header)
        for name, value in fields.items():
            setattr(view, name, value)
        del view
        return Stored(header, self.samples)


class StoredPing(NamedTuple):
    """A ping's header, and its channels: port, starboard."""

    header: bytes
    sides: tuple[Stored, Stored]


def stored(path: Path) -> tuple[bytearray, list[StoredPing]]:
    """Take a plain log of two channels of 16 bit apart."""
    data = path.read_bytes()
    found = []
    for offset in packet_offsets(data):
        at, sides = offset + 256, []
        for _ in range(2):
            header = bytearray(data[at : at + 64])
            n_bytes = 2 * pyxtf.XTFPingChanHeader.from_buffer(header).NumSamples
            sides.append(Stored(header, data[at + 64 : at + 64 + n_bytes]))
            at += 64 + n_bytes
        found.append(StoredPing(data[offset : offset + 256], (sides[0], sides[1])))
    return bytearray(data[:FILE_HEADER]), found


def packet(header: bytes, channels: Sequence[Stored], **fields: Any) -> bytes:
    """Write one packet of these channels."""
    start = bytearray(header)
    view = pyxtf.XTFPingHeader.from_buffer(start)
    body = b"".join(bytes(channel.header) + channel.samples for channel in channels)
    padding = -(len(start) + len(body)) % 64
    view.NumChansToFollow, view.NumBytesThisRecord = len(channels), len(start) + len(body) + padding
    for name, value in fields.items():
        setattr(view, name, value)
    del view
    return bytes(start) + body + bytes(padding)


def describe(head: bytearray, channels: Sequence[tuple[int, str, float]]) -> None:
    """Describe channels in a file header: type, name, frequency."""
    header = pyxtf.XTFFileHeader.from_buffer(head)
    header.NumberOfSonarChannels = len(channels)
    for number, (kind, name, frequency) in enumerate(channels):
        info = header.ChanInfo[number]
        info.TypeOfChannel, info.ChannelName, info.Frequency = kind, name.encode(), frequency
        info.CorrectionFlags, info.UniPolar, info.BytesPerSample, info.SampleFormat = 1, 1, 2, 3
        info.SubChannelNumber = number
    del header, info


def low(side: Stored) -> Stored:
    """The same ping at a low frequency: an eighth of the samples, and darker."""
    thin = np.frombuffer(side.samples, "<u2")[::8] // 4
    return Stored(side.header, thin.astype("<u2").tobytes()).with_fields(NumSamples=thin.shape[0])
