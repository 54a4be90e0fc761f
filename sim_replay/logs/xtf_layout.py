"""Learn from an XTF file header, and the packets behind it, what the log's channels are and how packets hold them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, BinaryIO, Final, NamedTuple

import msgspec
import pyxtf

from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.xtf_channels import (
    ChannelHead,
    PacketHead,
    Packing,
    Pair,
    channel_index,
    choose_pair,
    learn_packing,
    pair_notices,
)
from sim_replay.logs.xtf_fields import (
    CHANNEL_HEADER,
    NO_CHANNEL,
    PING_HEADER,
    ChannelHeader,
    channel_header,
    ping_number,
    ping_time,
)
from sim_replay.logs.xtf_header import (
    GROUND_RANGE,
    LATITUDE_LONGITUDE,
    SIDE_SCAN,
    Channel,
    channels,
    header_channel,
    name_channels,
)
from sim_replay.logs.xtf_packets import FileHeader, XtfPacket, read_packets
from sim_replay.logs.xtf_report import LogReport

SONAR: Final = 0  # packet type: side scan and sub-bottom
PROBE_PINGS: Final = 50  # looked at before the first is given, to learn what all of them share
_PROBE_PACKETS: Final = 4 * PROBE_PINGS  # of side scan, as a ping may be four; to learn how they hold channels
_PROBE_ITEMS: Final = 20 * _PROBE_PACKETS  # of any kind, among which they are looked for
_TWO_WAY: Final = 0.71  # of a one-way beam width, for beams near a Gaussian: 1 / sqrt(2)
_WIDER: Final = 1.05  # ratio of beam widths, below which the difference is rounding
_WIDEST_DEG: Final = 20.0  # that may be configured; logs that state more mean something else


class NoSideScanError(BadInputError):
    """Signal a file without side-scan channels: the caller completes the message with what the file holds instead."""


class Extent(msgspec.Struct, frozen=True, gc=False):
    """Hold where a packet holds a channel's samples: its description, offset and length, None beyond the packet."""

    channel: Channel | None
    offset: int
    n_bytes: int | None
    header: ChannelHeader


class Layout(NamedTuple):
    """Hold a file header and what it and the packets behind it show. header: a pyxtf.XTFFileHeader; data: its bytes."""

    header: Any
    data: bytes
    channels: list[Channel]
    packing: Packing
    pair: Pair

    @property
    def port_number(self) -> int:
        """Return the channel of port, -1 for none."""
        return self.pair.port.number if self.pair.port is not None else -1

    @property
    def starboard_number(self) -> int:
        """Return the channel of starboard, -1 for none."""
        return self.pair.starboard.number if self.pair.starboard is not None else -1

    @property
    def is_in_metres(self) -> bool:
        """Check whether the file header says that positions are metres."""
        return bool(self.header.NavUnits != LATITUDE_LONGITUDE)

    def says_signed(self, side: str) -> bool:
        """Check whether the file header says that samples of a side are signed."""
        channel = self.pair.port if side == "port" else self.pair.starboard
        return channel is not None and not header_channel(self.header, self.data, channel.number).UniPolar

    def without_channels(self) -> Layout:
        """Return the layout of a part of which nothing can be used."""
        return self._replace(channels=[], pair=Pair(None, None))


def extents(packing: Packing, described: Sequence[Channel], data: bytes, n_before: int) -> Iterator[Extent]:
    """Find the channels of a ping packet, as far as they fit into it.

    Parameters
    ----------
    packing
        How packets hold channels.
    described
        The channels of the file header.
    data
        The packet.
    n_before
        Channels of the ping in packets before.
    """
    if len(data) < PING_HEADER:
        yield Extent(None, 0, None, NO_CHANNEL)
        return
    offset = PING_HEADER
    for index in range(int.from_bytes(data[4:6], "little")):
        if offset + CHANNEL_HEADER > len(data):
            yield Extent(None, offset, None, NO_CHANNEL)
            return
        header = channel_header(data, offset)
        offset += CHANNEL_HEADER
        number = channel_index(packing, described, header.ChannelNumber, header.Frequency, n_before + index)
        if number >= len(described):
            yield Extent(None, offset, None, NO_CHANNEL)
            return
        channel = described[number]
        width = channel.dtype.itemsize if channel.dtype is not None else 1
        n_samples = header.NumSamples
        if n_samples == 0 and offset + channel.legacy_samples * width <= len(data):
            n_samples = channel.legacy_samples  # before rev. X26 the file header gave it for all pings
        n_bytes = n_samples * width
        if offset + n_bytes > len(data):
            yield Extent(channel, offset, None, header)
            return
        yield Extent(channel, offset, n_bytes, header)
        offset += n_bytes


def packet_head(
    packing: Packing, described: Sequence[Channel], packet: XtfPacket, before: Sequence[PacketHead]
) -> PacketHead | None:
    """Read what a packet states of its ping and channels; None for a damaged one.

    Parameters
    ----------
    packing
        How packets hold channels.
    described
        The channels of the file header.
    packet
        Of side scan.
    before
        Heads of the packets of the same ping.
    """
    data = packet.data
    for n_before in dict.fromkeys((sum(len(part.channels) for part in before), 0)):
        found = list(extents(packing, described, data, n_before))
        if found and all(extent.n_bytes is not None for extent in found):
            headers = (extent.header for extent in found)
            heads = tuple(ChannelHead(h.ChannelNumber, h.NumSamples, float(h.Frequency)) for h in headers)
            return PacketHead(ping_number(data), ping_time(data).of_day_s, heads)
    return None


def learn_layout(file: BinaryIO, data: bytes, offset: int, path: str, subsystem: int | None) -> Layout:
    """Learn channels and packing from a file header and the packets behind it; the file is left where it was.

    Raises NoSideScanError, BadInputError or UsageError.

    Parameters
    ----------
    file
        The log.
    data
        The file header.
    offset
        Where it begins.
    path
        Of the log, for messages.
    subsystem
        As configured.
    """
    place = path if offset == 0 else f"{path} (file header at byte {offset})"
    header = pyxtf.XTFFileHeader.from_buffer_copy(data)
    described = channels(header, data)
    if not any(c.kind in SIDE_SCAN for c in described):
        raise NoSideScanError(f"{place} has no side-scan channel ({name_channels(described)}).")
    heads = _first_heads(file, offset + len(data), described)
    packing = learn_packing(heads, len(described))
    pair = choose_pair(described, heads, packing, subsystem)
    for channel in (pair.port, pair.starboard):
        if channel is None:
            continue
        if channel.dtype is None:
            raise BadInputError(
                f"{place}: channel {channel.number} ({channel.name}) has a sample format that cannot be read "
                "(known: 1, 2 and 4 byte integers, IEEE float). Export the log again with integer samples."
            )
        if header_channel(header, data, channel.number).CorrectionFlags == GROUND_RANGE:
            raise BadInputError(
                f"{place}: channel {channel.number} ({channel.name}) is already corrected to ground range; slant "
                "range is needed. Export the log without slant-range correction."
            )
    return Layout(header, data, described, packing, pair)


def raise_notices(layout: Layout, sonar: SonarConfig, report: LogReport) -> None:
    """Raise the notices of a log's first file header.

    Parameters
    ----------
    layout
        Of the header.
    sonar
        As configured.
    report
        Takes the notices.
    """
    place, used = report.place(0), (layout.port_number, layout.starboard_number)
    report.extend(pair_notices(layout.pair, layout.packing, sonar.subsystem, place))
    if others := layout.pair.others:
        report.notify(
            "reader.other_channel",
            f"channels {used[0]} and {used[1]} are used; "
            f"further side-scan channels are left out and counted: {name_channels(others)}",
            place,
        )
    described = {
        c.number: header_channel(layout.header, layout.data, c.number) for c in layout.channels if c.number in used
    }
    _raise_wide_beam(max((info.HorizBeamAngle for info in described.values()), default=0.0), sonar, report, place)
    offsets = [
        f"channel {number} offset {info.OffsetX:g}, {info.OffsetY:g}, {info.OffsetZ:g} m"
        for number, info in described.items()
        if info.OffsetX or info.OffsetY or info.OffsetZ
    ]
    if layout.header.NavigationLatency:
        offsets.append(f"navigation latency {layout.header.NavigationLatency} ms")
    if offsets:
        report.notify(
            "reader.mounting_not_applied",
            f"the log states {'; '.join(offsets)}. It is not known whether positions include it: "
            "nothing is applied, set sonar.lever_arm_m if needed",
            place,
        )


def _raise_wide_beam(stated_deg: float, sonar: SonarConfig, report: LogReport, place: str) -> None:
    """Report a beam that is wider than the one used. Data sheets, and so logs, state one-way widths."""
    if sonar.kind == "sas" or not _WIDER * sonar.used_beam_width_deg < _TWO_WAY * stated_deg <= _WIDEST_DEG:
        return
    report.notify(
        "reader.beam_is_wider",
        f"the log states a beam of {stated_deg:g} degrees along the track, {_TWO_WAY * stated_deg:.2g} two-way, and "
        f"{sonar.used_beam_width_deg:g} is used: mines are missed, and clearance promises too much. Set "
        "sonar.beam_width_deg",
        place,
    )


def _first_heads(file: BinaryIO, offset: int, described: Sequence[Channel]) -> list[PacketHead]:
    """Read the heads of the first side-scan packets from a byte on; the file is left where it was."""
    at = file.seek(0, os.SEEK_CUR)
    heads: list[PacketHead] = []
    size_bytes = os.fstat(file.fileno()).st_size
    for item in islice(read_packets(file, offset, size_bytes, (SONAR,)), _PROBE_ITEMS):
        if isinstance(item, FileHeader) or len(heads) == _PROBE_PACKETS:
            break
        if isinstance(item, XtfPacket) and item.kind == SONAR:
            head = packet_head(Packing(), described, item, [])
            if head is not None:
                heads.append(head)
    file.seek(at)
    return heads
