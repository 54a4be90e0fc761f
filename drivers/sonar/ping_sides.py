"""Find which side a Ping Protocol profile looks to, and which of several frequencies is used.

Profiles carry a channel number, 0 for port and 1 for starboard as a rule, and the look angle of their transducer
against the bow, +90 degrees for starboard and -90 for port where somebody set it (Cerulean, "os_mono_profile";
SonarView goes by the angle). Heads that count from one, that all call themselves channel 0, or that have 255 for want
of a number, are in use too.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Final, Literal, NamedTuple

import numpy as np

from auv_mcm.records import Notice
from drivers.framing import StampedMessage
from drivers.sonar.ping_messages import OsMonoProfile, PingMessage

MAX_CHANNEL: Final = 3  # of two heads at two frequencies, counted from 0
NO_CHANNEL: Final = 255  # of heads that number none
_LOOK_TOLERANCE_DEG: Final = 30.0  # of +-90 degrees, within which an angle is one to a side (chosen)
_CLOSE_DEG: Final = 2.0  # an angle against north is taken only where it is as close, and the other is not (chosen)
_SETTLED: Final = 8  # profiles after which it is known which channels there are (chosen)
_OFTEN: Final = 3  # profiles of a frequency, after which it counts (chosen)
_RECENT: Final = 200  # profiles that are counted: 5 s at 20 pings a second, after which a frequency that ended is left
_SAME_FREQUENCY: Final = 1.25  # ratio: the heads of one sonar differ by less, its frequencies by more (chosen)

ToSide = Literal["port", "starboard"]


class Sided(NamedTuple):
    """Hold a profile and the side that it looks to."""

    arrived: StampedMessage[PingMessage]
    profile: OsMonoProfile
    side: ToSide


class HeadSides:
    """Give profiles their sides, in the order of arrival. Holds one profile at most.

    The look angle decides where it is one to a side; else the channel numbers in ascending order, and of profiles of
    one ping that share a channel the order. counters: ping_protocol.not_used.frequency and .channel. `notices` are for
    a person, each once.
    """

    def __init__(self, counters: Counter[str], *, by_number: bool, subsystem: int | None) -> None:
        """Start without having seen a profile.

        Parameters
        ----------
        counters
            Where what is not used is counted.
        by_number
            The look angle does not count.
        subsystem
            20 for the lowest frequency, else the highest is used.
        """
        self.notices: list[Notice] = []
        self._counters = counters
        self._by_number, self._lowest = by_number, subsystem == 20
        self._hz: deque[int] = deque(maxlen=_RECENT)
        self._heads: set[tuple[int, int]] = set()  # channel and source of those in use
        self._used_hz = 0
        self._n_placed = 0
        self._are_alike = False  # the heads share a channel other than 0
        self._held: tuple[StampedMessage[PingMessage], OsMonoProfile] | None = None
        self._last: Sided | None = None

    def add(self, arrived: StampedMessage[PingMessage], profile: OsMonoProfile) -> list[Sided]:
        """Take a profile; return those whose side is known."""
        if not self._is_in_use(profile.ping_hz):
            self._counters["ping_protocol.not_used.frequency"] += 1
            return []
        self._heads.add((profile.channel_number, arrived.message.source))
        held, self._held = self._held, None
        if held is None and not self._n_placed and profile.channel_number and self._look(profile) is None:
            self._held = arrived, profile  # whether this is the first channel, the next profile shows
            return []
        if held is not None and _shares_channel(*held, arrived, profile):
            self._are_alike = True
        waiting = [(arrived, profile)] if held is None else [held, (arrived, profile)]
        return [sided for one in waiting if (sided := self._placed(*one)) is not None]

    def finish(self) -> list[Sided]:
        """Return the profile that is held."""
        held, self._held = self._held, None
        sided = None if held is None else self._placed(*held)
        return [] if sided is None else [sided]

    def _placed(self, arrived: StampedMessage[PingMessage], profile: OsMonoProfile) -> Sided | None:
        numbered, looks = self._numbered((profile.channel_number, arrived.message.source)), self._look(profile)
        side = looks or numbered
        if side is None:
            self._counters["ping_protocol.not_used.channel"] += 1
            return None
        last = self._last
        if looks is None and last is not None and _shares_channel(last.arrived, last.profile, arrived, profile):
            side = "starboard" if last.side == "port" else "port"
            self._notify_alike(profile)
        elif looks is not None and numbered not in (None, looks) and profile.channel_number != NO_CHANNEL:
            self._notify_look(profile, looks)
        self._n_placed += 1
        self._last = Sided(arrived, profile, side)
        return self._last

    def _numbered(self, head: tuple[int, int]) -> ToSide | None:
        """Return the side of a head by its number among those in use, None for a third one."""
        heads = sorted(self._heads)
        first = heads[0][0]
        place = heads.index(head)
        if len(heads) == 1:
            place = 0 if self._are_alike or first == NO_CHANNEL else first % 2
        if place > 1:
            return None
        return "port" if place == 0 else "starboard"

    def _look(self, profile: OsMonoProfile) -> ToSide | None:
        return None if self._by_number else look_side(profile.transducer_heading_deg, profile.vehicle_heading_deg)

    def _is_in_use(self, hz: int) -> bool:
        """Check whether a profile's frequency is the one in use."""
        hz = round(hz, -3)
        self._hz.append(hz)
        often = [known for known, n in Counter(self._hz).items() if n >= _OFTEN] or [hz]
        used = min(often) if self._lowest else max(often)
        if not is_same_frequency(used, self._used_hz):
            self._used_hz = used
            self._heads.clear()
            if self._held is not None:  # of the frequency before
                self._held = None
                self._counters["ping_protocol.not_used.frequency"] += 1
        if not is_same_frequency(min(often), max(often)):
            text = frequency_text(min(often), max(often), used)
            self._notify_once("sonar_frequency_chosen", f"of several frequencies one is used: {text}")
        return is_same_frequency(hz, used)

    def _notify_alike(self, profile: OsMonoProfile) -> None:
        self._notify_once(
            "sonar_channels_alike",
            f"both heads send channel {profile.channel_number} and no look angle: the first of a ping is taken as "
            "port. Set the channels or look angles of the heads; if port and starboard look exchanged, set sides: "
            "swapped in the port's section sonar, or sonar.sides: swapped to replay a log",
        )

    def _notify_look(self, profile: OsMonoProfile, looks: ToSide) -> None:
        if self._n_placed < _SETTLED:
            return
        self._notify_once(
            "sonar_sides_disagree",
            f"channel {profile.channel_number} has a look angle of {profile.transducer_heading_deg:g} degrees: it is "
            f"taken as {looks}, while its number is that of the other side. If port and starboard look exchanged, set "
            "sides: by_number in the port's section sonar, or sonar.sides: by_number to replay a log",
        )

    def _notify_once(self, code: str, text: str) -> None:
        if all(notice.code != code for notice in self.notices):
            self.notices.append(Notice(code=code, text=text))


def look_side(transducer_deg: float, vehicle_deg: float) -> ToSide | None:
    """Return the side of a look angle, clockwise; None for one that is not to a side, as the 0 of heads not set up.

    Parameters
    ----------
    transducer_deg
        Look angle against the bow, or against north.
    vehicle_deg
        Heading of the vehicle against north, 0 where it is not known.
    """
    against_bow, against_north = _off_side(transducer_deg), _off_side(transducer_deg - vehicle_deg)
    if against_north <= _CLOSE_DEG < against_bow:
        angle_deg = transducer_deg - vehicle_deg
    elif against_bow <= _LOOK_TOLERANCE_DEG:
        angle_deg = transducer_deg
    else:
        return None
    return "starboard" if math.sin(math.radians(angle_deg)) > 0.0 else "port"


def is_same_frequency(one_hz: float, other_hz: float) -> bool:
    """Check whether two frequencies are those of one sonar's heads."""
    return max(one_hz, other_hz) <= _SAME_FREQUENCY * min(one_hz, other_hz)


def frequency_text(low_hz: float, high_hz: float, used_hz: float) -> str:
    """Describe the choice of a frequency, and how to change it."""
    other = "20 for the lower" if used_hz == high_hz else "21 for the higher"
    return (
        f"side scan comes at {1e-3 * low_hz:g} and {1e-3 * high_hz:g} kHz: {1e-3 * used_hz:g} kHz is used. Set "
        f"sonar.subsystem: {other} frequency"
    )


def _off_side(angle_deg: float) -> float:
    """Return by how many degrees an angle is off abeam, 0 to 90; 90 for one that is not finite."""
    return abs(90.0 - abs((angle_deg + 180.0) % 360.0 - 180.0)) if math.isfinite(angle_deg) else 90.0


def _shares_channel(
    before: StampedMessage[PingMessage],
    other: OsMonoProfile,
    arrived: StampedMessage[PingMessage],
    profile: OsMonoProfile,
) -> bool:
    """Check whether a profile is another head's of the same ping, and not the same one sent again."""
    return (
        profile.channel_number == other.channel_number
        and arrived.message.source == before.message.source
        and profile.ping_number == other.ping_number
        and not np.array_equal(profile.pwr_results, other.pwr_results)
    )
