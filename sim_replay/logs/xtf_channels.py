"""Find the two sides among the channels of an XTF log, however its packets number, order and spread them.

The format numbers channels from 0, in the order of the file header, and writes all channels of a ping into one packet
(Triton Imaging, "eXtended Triton Format", rev. 42). Recorders write all numbers 0, count from 1, write a packet per
channel, or several frequencies side by side. What a log does is learned from its first packets.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Literal, NamedTuple, TypeAlias

from auv_mcm.errors import UsageError
from auv_mcm.records import Notice
from sim_replay.logs.xtf_header import PORT, SIDE_SCAN, STARBOARD, Channel

Numbering: TypeAlias = Literal["by_number", "from_one", "by_order"]

SUBSYSTEMS: Final = (20, 21, 22)  # `sonar.subsystem`: low, high, very high frequency
_SAME_FREQUENCY: Final = 1.25  # ratio: the sides of a sonar differ by less, its frequencies by more (chosen)
_SAME_PING_S: Final = 0.5  # s between packets of one ping number; a number that returns later is another ping (chosen)
_OFTEN: Final = 0.2  # of a channel's packets; a rarer frequency comes of damage (chosen)
_HERTZ_FROM: Final = 10_000.0  # kHz: no side scan has more, so a larger number is in hertz
_KILOHERTZ_IN_NAME: Final = re.compile(r"(\d+(?:\.\d+)?)\s*k(?:hz)?\b", re.IGNORECASE)
_PORT_NAME: Final = re.compile(r"port|\bp\b|left|backbord", re.IGNORECASE)
_STARBOARD_NAME: Final = re.compile(r"st(ar)?b|st(ar)?bd|\bs\b|right|steuerbord", re.IGNORECASE)


class ChannelHead(NamedTuple):
    """Hold what a packet states of one channel. frequency_khz: 0 where it states none."""

    number: int
    n_samples: int
    frequency_khz: float


class PacketHead(NamedTuple):
    """Hold the ping and the channels that a packet states. time_s: of the day."""

    ping_number: int
    time_s: float
    channels: tuple[ChannelHead, ...]


class Packing(NamedTuple):
    """Hold how a log's packets hold channels.

    joins: packets of one ping are joined. by_ping_number: they share its number, else its time.
    """

    numbering: Numbering = "by_number"
    joins: bool = False
    by_ping_number: bool = True


class Pair(NamedTuple):
    """Hold the channels in use and why.

    frequencies_khz: of all there are, ascending; used_khz: of this pair, 0 where the log states none. by_packet: the
    frequency changes from packet to packet under one channel, so that packets of another are left out. others: further
    side-scan channels that the packets hold. doubt: what of types and names disagrees, for a person; empty where
    nothing does.
    """

    port: Channel | None
    starboard: Channel | None
    frequencies_khz: tuple[float, ...] = ()
    used_khz: float = 0.0
    by_packet: bool = False
    others: tuple[Channel, ...] = ()
    doubt: str = ""

    def takes(self, frequency_khz: float) -> bool:
        """Check whether a packet's channel has the frequency in use."""
        return not self.by_packet or _is_same(kilohertz(frequency_khz), self.used_khz)


def channel_index(packing: Packing, channels: Sequence[Channel], number: int, frequency_khz: float, index: int) -> int:
    """Return which channel of the file header a packet's channel is; as many as there are for none.

    Parameters
    ----------
    packing
        How the log numbers channels.
    channels
        As the file header describes them.
    number, frequency_khz
        What the packet states.
    index
        The channel's place within its ping.
    """
    n_channels = len(channels)
    match packing.numbering:
        case "by_number":
            number = number if number < n_channels else index
        case "from_one":
            number -= 1
        case "by_order":
            number = index
    if not 0 <= number < n_channels:
        return n_channels
    described = channels[number]
    if frequency_khz == described.frequency:  # as a rule
        return number
    khz = kilohertz(frequency_khz)
    if khz > 0.0 < described.frequency and not _is_same(khz, kilohertz(described.frequency)):
        # Some recorders begin to count anew for every frequency; then the frequency names the channel.
        same = [c for c in channels if c.kind == described.kind and _is_same(khz, kilohertz(c.frequency))]
        number = same[0].number if same else number
    return number


def learn_packing(heads: Sequence[PacketHead], n_channels: int) -> Packing:
    """Learn from a log's first packets how it numbers channels and spreads them over packets."""
    numbering = _numbering(heads, n_channels)
    varies = len({head.ping_number for head in heads}) > 1
    for by_ping_number in (True, False) if varies else (False,):
        packing = Packing(numbering, True, by_ping_number)
        n_joined = sum(belongs(packing, [one], two, n_channels) for one, two in pairwise(heads))
        if 4 * n_joined >= len(heads) > 1:  # half of the steps between packets of two sides; some may be lost
            return packing
    return Packing(numbering)


def belongs(packing: Packing, waiting: Sequence[PacketHead], head: PacketHead, n_channels: int) -> bool:
    """Check whether a packet holds further channels of the ping whose packets wait."""
    first = waiting[0]
    step_s = abs(head.time_s - first.time_s)
    same = head.ping_number == first.ping_number and step_s <= _SAME_PING_S if packing.by_ping_number else step_s == 0.0
    if not same:
        return False
    there = [channel.number for part in waiting for channel in part.channels]
    if packing.numbering == "by_order":
        return len(there) + len(head.channels) <= n_channels
    return not set(there) & {channel.number for channel in head.channels}


def _numbering(heads: Sequence[PacketHead], n_channels: int) -> Numbering:
    numbers = [[channel.number for channel in head.channels] for head in heads]
    flat = {number for some in numbers for number in some}
    if any(len(set(some)) < len(some) for some in numbers):
        return "by_order"
    if flat and min(flat) == 1 and max(flat) == n_channels:
        return "from_one"
    alone = n_channels > 1 and len(flat) == 1 and all(len(some) == 1 for some in numbers)
    if alone or any(number >= n_channels for number in flat):
        same = sum(
            one.ping_number == two.ping_number or one.time_s == two.time_s for one, two in pairwise(heads)
        )  # one side recorded alone has one packet per ping
        return "by_order" if not alone or 4 * same >= len(heads) > 1 else "by_number"
    return "by_number"


def choose_pair(
    channels: Sequence[Channel], heads: Sequence[PacketHead], packing: Packing, subsystem: int | None
) -> Pair:
    """Choose port and starboard: of several frequencies the highest, or the one that `sonar.subsystem` names.

    Raises UsageError for a subsystem that the log does not have.

    Parameters
    ----------
    channels
        As the file header describes them.
    heads
        The log's first packets; channels that none of them holds are not chosen. Empty: nothing is known of packets.
    packing
        How they hold channels.
    subsystem
        20 low, 21 high, 22 very high frequency, None for the highest.
    """
    seen: dict[int, Counter[float]] = {}
    for ping in _pings(heads, packing, len(channels)):
        for place, head in enumerate(ping):
            index = channel_index(packing, channels, head.number, head.frequency_khz, place)
            if head.n_samples or (index < len(channels) and channels[index].legacy_samples):
                seen.setdefault(index, Counter())[kilohertz(head.frequency_khz)] += 1
    few = _OFTEN * max((counts.total() for counts in seen.values()), default=0)
    seen = {index: counts for index, counts in seen.items() if counts.total() >= few}
    side_scan = [c for c in channels if c.kind in SIDE_SCAN and (not seen or c.number in seen)]
    side_scan = side_scan or [c for c in channels if c.kind in SIDE_SCAN]
    changing = _changing_khz([seen[c.number] for c in side_scan if c.number in seen])
    if changing:
        used_khz = changing[_place(changing, subsystem, len(changing) - 1)]
        port, starboard, doubt = _sides(side_scan)
        return Pair(port, starboard, changing, used_khz, True, (), doubt)
    groups, named = _groups(side_scan, seen)
    whole = [place for place, group in enumerate(groups) if len(group) > 1]
    place = _place(named, subsystem, (whole or [len(groups) - 1])[-1])
    port, starboard, doubt = _sides(groups[place])
    others = tuple(c for c in side_scan if c not in (port, starboard))
    return Pair(port, starboard, named, named[place], False, others, doubt)


def kilohertz(frequency: float) -> float:
    """Return a stated frequency in kHz, which some recorders state in Hz; 0 for none."""
    if not 0.0 < frequency < math.inf:
        return 0.0
    return frequency / 1000.0 if frequency > _HERTZ_FROM else frequency


def _is_same(one_khz: float, other_khz: float) -> bool:
    return max(one_khz, other_khz) <= _SAME_FREQUENCY * min(one_khz, other_khz)


def _place(frequencies_khz: Sequence[float], subsystem: int | None, highest: int) -> int:
    """Return the place of the frequency in use. Raises UsageError for a subsystem that the log does not have."""
    if subsystem is None or len(frequencies_khz) < 2:
        return highest
    place = subsystem - SUBSYSTEMS[0]
    if place >= len(frequencies_khz):
        there = " and ".join(f"{SUBSYSTEMS[0] + n} ({khz:g} kHz)" for n, khz in enumerate(frequencies_khz))
        raise UsageError(f"sonar.subsystem is {subsystem}, but the log holds side scan of {there}. Set one of them.")
    return place


def _changing_khz(seen: Sequence[Counter[float]]) -> tuple[float, ...]:
    """Return the frequencies that one channel has in turn, ascending; empty where each channel keeps its own."""
    often: set[float] = set()
    for counts in seen:
        kept = [khz for khz, n in counts.items() if khz > 0.0 and n >= _OFTEN * counts.total()]
        if kept and not _is_same(min(kept), max(kept)):
            often.update(kept)
    apart: list[float] = []
    for khz in sorted(often):
        if apart and _is_same(apart[-1], khz):
            apart.pop()
        apart.append(khz)
    return tuple(apart)


def _pings(heads: Sequence[PacketHead], packing: Packing, n_channels: int) -> list[list[ChannelHead]]:
    """Join the packets of pings as the reader does."""
    pings: list[list[PacketHead]] = []
    for head in heads:
        if packing.joins and pings and belongs(packing, pings[-1], head, n_channels):
            pings[-1].append(head)
        else:
            pings.append([head])
    return [[channel for part in parts for channel in part.channels] for parts in pings]


def _groups(
    side_scan: Sequence[Channel], seen: dict[int, Counter[float]]
) -> tuple[list[list[Channel]], tuple[float, ...]]:
    """Group channels of one frequency, ascending, by the first of header, packets and names that differs."""
    written = {c.number: _KILOHERTZ_IN_NAME.search(c.name) for c in side_scan}
    stated: list[dict[int, float]] = [
        {c.number: kilohertz(c.frequency) for c in side_scan},
        {c.number: max(seen.get(c.number, {0.0: 1})) for c in side_scan},
        {c.number: float(found[1]) if (found := written[c.number]) else 0.0 for c in side_scan},
    ]
    grouped = [(_grouped(side_scan, khz), khz) for khz in stated]
    several = [item for item in grouped if len(item[0]) > 1]
    known = [item for item in grouped if any(item[1].values())]
    groups, khz = (several or known or grouped)[0]
    return groups, tuple(max(khz[c.number] for c in group) for group in groups)


def _grouped(side_scan: Sequence[Channel], khz: dict[int, float]) -> list[list[Channel]]:
    groups: list[list[Channel]] = []
    last = 0.0
    for channel in sorted(side_scan, key=lambda c: (khz[c.number], c.number)):
        if not groups or khz[channel.number] > _SAME_FREQUENCY * last > 0.0:
            groups.append([])
        groups[-1].append(channel)
        last = khz[channel.number]
    return [sorted(group, key=lambda c: c.number) for group in groups]


def _sides(used: Sequence[Channel]) -> tuple[Channel | None, Channel | None, str]:
    """Return port, starboard, and what of types and names disagrees."""
    port = next((c for c in used if c.kind == PORT), None)
    starboard = next((c for c in used if c.kind == STARBOARD), None)
    if port is not None and starboard is not None:
        if _named(port) == STARBOARD and _named(starboard) == PORT:
            doubt = (
                f"the file header calls channel {port.number} '{port.name}' and gives it the type of port, channel "
                f"{starboard.number} '{starboard.name}' and starboard: the types are taken"
            )
            return port, starboard, doubt
        return port, starboard, ""
    if len(used) < 2:
        only = used[0]
        if _named(only) not in (0, only.kind):
            side = "port" if only.kind == PORT else "starboard"
            return port, starboard, f"the only channel is '{only.name}' with the type of {side}: the type is taken"
        return port, starboard, ""
    first, second = used[0], used[1]
    if _named(first) == STARBOARD and _named(second) == PORT:
        first, second = second, first
    side = "port" if used[0].kind == PORT else "starboard"
    named = _named(first) == PORT and _named(second) == STARBOARD
    why = "their names are taken" if named else f"channel {first.number} is taken as port, {second.number} as starboard"
    return first, second, f"channels {used[0].number} and {used[1].number} both have the type of {side}: {why}"


def _named(channel: Channel) -> int:
    """Return the side in a channel's name, as its type; 0 for none or both."""
    is_port, is_starboard = bool(_PORT_NAME.search(channel.name)), bool(_STARBOARD_NAME.search(channel.name))
    return 0 if is_port == is_starboard else PORT if is_port else STARBOARD


def pair_notices(pair: Pair, packing: Packing, subsystem: int | None, place: str) -> list[Notice]:
    """Return what a person has to know of the choice of channels.

    Parameters
    ----------
    pair
        The choice.
    packing
        How the packets hold channels.
    subsystem
        As configured: a choice that was asked for is a remark.
    place
        For the notices.
    """
    notices = []
    if len(pair.frequencies_khz) > 1:
        others = [
            f"{SUBSYSTEMS[0] + n} for {khz:g} kHz"
            for n, khz in enumerate(pair.frequencies_khz[: len(SUBSYSTEMS)])
            if khz != pair.used_khz
        ]
        there = " and ".join(f"{khz:g}" for khz in pair.frequencies_khz)
        text = (
            f"the log holds side scan at {there} kHz: {pair.used_khz:g} kHz is used. Set sonar.subsystem: "
            f"{' or '.join(others)}"
        )
        asked = subsystem is not None
        notices.append(Notice(code="reader.frequency_chosen", text=text, place=place, for_the_record=asked))
    if pair.doubt:
        text = f"{pair.doubt}. If port and starboard look exchanged, set sonar.sides: swapped"
        notices.append(Notice(code="reader.sides_disagree", text=text, place=place))
    if packing.numbering == "by_order":
        text = (
            "channel numbers in the pings repeat or are beyond the file header's; the order of channels decides which "
            "side is which. If port and starboard look exchanged, set sonar.sides: swapped"
        )
        notices.append(Notice(code="reader.channel_numbers", text=text, place=place))
    return notices
