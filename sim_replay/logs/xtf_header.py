"""Read an XTF file header: channels, sample formats, units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyxtf

from sim_replay.logs.xtf_packets import HEADER_BLOCK

PORT: Final = 1  # channel type (XTF)
STARBOARD: Final = 2  # channel type (XTF)
SIDE_SCAN: Final = (PORT, STARBOARD)
GROUND_RANGE: Final = 2  # correction flag of a channel
LATITUDE_LONGITUDE: Final = 3  # navigation unit

_CHANNEL_BYTES: Final = 128  # of a channel's description (XTF)
_IBM_FLOAT: Final = 1  # sample format (XTF)
_DTYPE_OF_FORMAT: Final = {2: "<u4", 3: "<u2", 5: "<f4", 8: "u1"}
_DTYPE_OF_WIDTH: Final = {1: "u1", 2: "<u2", 4: "<u4"}


class Channel(NamedTuple):
    """Describe one channel by the file header.

    legacy_samples: samples per ping where pings do not carry it themselves.
    """

    number: int
    kind: int
    dtype: np.dtype[Any] | None  # None: a sample format nothing is known about
    legacy_samples: int
    frequency: float
    name: str


def header_channel(header: Any, data: bytes, number: int) -> Any:
    """Return channel description `number` of a file header (pyxtf.XTFChanInfo).

    Those beyond six follow in further blocks.
    """
    if number < len(header.ChanInfo):
        return header.ChanInfo[number]
    return pyxtf.XTFChanInfo.from_buffer_copy(data, HEADER_BLOCK + _CHANNEL_BYTES * (number - len(header.ChanInfo)))


def channels(header: Any, data: bytes) -> list[Channel]:
    """Return all channels of a pyxtf.XTFFileHeader; `data` holds all its bytes.

    Where fewer than two side-scan channels are declared, those that are described behind them count too.
    """
    capacity = len(header.ChanInfo) + (len(data) - HEADER_BLOCK) // _CHANNEL_BYTES
    n_declared = min(header.channel_count(), capacity)
    found: list[Channel] = []
    for number in range(capacity):
        info = header_channel(header, data, number)
        if number >= n_declared and (
            info.TypeOfChannel not in SIDE_SCAN
            or not info.BytesPerSample
            or sum(channel.kind in SIDE_SCAN for channel in found) > 1
        ):
            break
        form = _DTYPE_OF_FORMAT.get(info.SampleFormat) or (
            _DTYPE_OF_WIDTH.get(info.BytesPerSample) if info.SampleFormat != _IBM_FLOAT else None
        )
        found.append(
            Channel(
                number,
                info.TypeOfChannel,
                np.dtype(form) if form is not None else None,
                info.Reserved,
                info.Frequency,
                info.ChannelName.decode("ascii", "replace").strip(),
            )
        )
    return found


def name_channels(some: Sequence[Channel]) -> str:
    """Name channels for a message."""
    names = {0: "sub-bottom", PORT: "port", STARBOARD: "starboard", 3: "bathymetry"}
    return (
        ", ".join(f"{c.number} {names.get(c.kind, 'unknown')} {c.name}".rstrip() for c in some) or "no channels at all"
    )


def kind_name(kind: int) -> str:
    """Return the name of a packet type."""
    try:
        return str(pyxtf.XTFHeaderType(kind).name)
    except ValueError:
        return f"type_{kind}"
