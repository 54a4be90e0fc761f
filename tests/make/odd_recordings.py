"""Draw odd recordings of one simulated line, and hold what the chain makes of them against the truth.

    python -m tests.make.odd_recordings --count 500

A recording has one drawn value of each property of its format. The objects have to be found within 1 m, to the right
side, and as much floor covered as of the sound recording; or a notice has to name a property that is odd.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config, NavigationConfig
from sim_replay.logs.open_log import open_log
from tests.make.odd_line import Result, chain, faults
from tests.make.odd_ports import port_events, write_jsf, write_svlog
from tests.make.odd_xtf import UTM_EPSG, write_xtf

_SPEEDS: Final = ("right", "zero", "half", "thrice", "tenth", "absent")
_HEADINGS: Final = ("HDT", "THS", "HDG", "HDM_RMC", "HDM", "PSAT", "PTNL", "PFEC", "OHPR", "zero", "absent")
_HEADS: Final = (
    *("plain", "angles", "exchanged_angles", "zeros", "zeros_angles", "from_one", "from_one_angles"),
    *("frequencies", "frequencies_zeros_angles"),
)
# Of each format; the first value of a property is the usual one.
PROPERTIES: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "xtf": {
        "speed": _SPEEDS,
        "heading": ("right", "zero", "ship", "absent"),
        "position": (
            *("each_ping", "each_second", "each_5_s", "scatter", "ship", "ship_ahead", "frozen"),
            *("packet_107", "packets_42_84", "serial"),
        ),
        "units": ("degrees", "degrees_said_metres", "utm"),
        "clock": ("right", "year_0", "two_digits", "uptime"),
        "channels": (
            *("plain", "zeros", "zeros_apart", "from_one", "apart", "four", "four_apart", "both_in_one"),
            "undeclared",
        ),
        "samples": ("unsigned", "signed", "signed_said_unipolar"),
        "range": ("stated", "by_duration"),
    },
    "jsf": {
        "speed": _SPEEDS,
        "heading": ("right", "zero", "absent", "sentence"),
        "position": ("header", "header_each_5_s", "sentence"),
        "clock": ("right", "version_7", "never_set"),
        "sound_speed": ("message", "pressure_sensor"),
        "sides": ("plain", "zeros", "from_one", "frequencies", "bathymetry"),
    },
    "svlog": {
        "speed": _SPEEDS,
        "heading": _HEADINGS,
        "position": ("10_hz", "each_second", "each_5_s", "scatter"),
        "sides": _HEADS,
    },
    "nmea": {
        "speed": _SPEEDS,
        "heading": _HEADINGS,
        "position": ("10_hz", "each_second", "each_5_s", "scatter"),
        "clock": ("right", "ahead_60_s", "ahead_20_min", "behind_3_min", "rollover", "two_rollovers"),
        "sides": _HEADS,
    },
}
NAMED_BY: Final[dict[str, frozenset[str]]] = {
    "speed": frozenset({"navigation.speed_off_track", "nav_reckoning_off"}),
    "heading": frozenset(
        {
            "navigation.heading_zero",
            "nav_heading_magnetic",
            "nav_heading_not_read",
            "nav_heading_not_valid",
            "navigation.heading_off_course",
            "navigation.course_scattered",
        }
    ),
    "position": frozenset(
        {
            "navigation.fixes_sparse",
            "reader.ship_position",
            "reader.sensor_position_still",
            "nav_dead_reckoning",
            "nav_position_lost",
        }
    ),
    "units": frozenset({"reader.units_by_value"}),
    "clock": frozenset({"reader.time_unknown", "reader.time_two_digits", "utc_rollover"}),
    "sound_speed": frozenset({"reader.sound_speed_assumed"}),
    "channels": frozenset({"reader.channel_numbers", "reader.frequency_chosen", "reader.both_sides_in_one_channel"}),
    "samples": frozenset({"reader.signed_samples"}),
    "range": frozenset({"reader.range_from_duration"}),
    "sides": frozenset(
        {
            *("reader.channel_numbers", "reader.frequency_chosen", "sonar_frequency_chosen"),
            *("sonar_channels_alike", "sonar_sides_disagree"),
        }
    ),
}


class Odd(NamedTuple):
    """Hold a drawn recording: its format, and a value of each property of it."""

    kind: str
    values: dict[str, str]
    seed: int

    def __str__(self) -> str:
        return f"{self.kind} {self.seed}: " + ", ".join(f"{name} {value}" for name, value in self.values.items())


def draw(seed: int) -> Odd:
    """Draw a recording; the same seed gives the same one."""
    random = np.random.default_rng(seed)
    kind = tuple(PROPERTIES)[seed % len(PROPERTIES)]
    return Odd(kind, {name: str(random.choice(values)) for name, values in PROPERTIES[kind].items()}, seed)


def events_of(odd: Odd, folder: Path) -> tuple[list[SourceEvent], Config]:
    """Write the recording and read it as a replay does; live ports are fed as live."""
    if odd.kind == "nmea":
        return list(port_events(odd.values, odd.seed)), Config()
    path = folder / f"odd.{odd.kind}"
    config = Config()
    if odd.kind == "xtf":
        write_xtf(path, odd.values, odd.seed)
        config = Config(navigation=NavigationConfig(epsg=UTM_EPSG if odd.values["units"] == "utm" else None))
    elif odd.kind == "jsf":
        write_jsf(path, odd.values)
    else:
        write_svlog(path, odd.values, odd.seed)
    log = open_log(path, config)
    log.first_time_s()
    return list(log), config


def run(odd: Odd) -> Result:
    """Write, read and process a recording."""
    with tempfile.TemporaryDirectory() as folder:
        events, config = events_of(odd, Path(folder))
        return chain(events, config)


def silent_faults(odd: Odd, result: Result) -> list[str]:
    """List what is wrong with the result, unless a notice names a property that makes it so.

    A property makes it so where the same recording without it is right; where none does alone, all of them do.
    """
    wrong = faults(result)
    if not wrong:
        return []
    unusual = {name: values[0] for name, values in PROPERTIES[odd.kind].items() if odd.values[name] != values[0]}

    def makes_it_wrong(name: str) -> bool:
        return not faults(run(odd._replace(values={**odd.values, name: unusual[name]})))

    named = [name for name in unusual if result.codes & NAMED_BY[name]]
    if any(map(makes_it_wrong, named)):
        return []
    causes = [name for name in unusual if name not in named and makes_it_wrong(name)]
    return [*wrong, f"by {', '.join(causes or unusual)}"] if causes or not named else []


def _report(seeds: range) -> Iterator[tuple[Odd, list[str], list[str]]]:
    for seed in seeds:
        odd = draw(seed)
        result = run(odd)
        yield odd, silent_faults(odd, result), faults(result)


def main(arguments: list[str] | None = None) -> int:
    """Draw so many recordings; print those that are silently wrong, and how many there were of each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="recordings")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--all", action="store_true", help="print those as well that are wrong with a notice")
    given: Any = parser.parse_args(arguments)
    tally: Counter[str] = Counter()
    for odd, silent, wrong in _report(range(given.first, given.first + given.count)):
        tally[f"{odd.kind}: {'silently wrong' if silent else 'wrong, with a notice' if wrong else 'right'}"] += 1
        if silent or (given.all and wrong):
            print(f"{odd}: {'; '.join(silent or [*wrong, 'with a notice'])}", flush=True)
    print("\n".join(f"{name}: {count}" for name, count in sorted(tally.items())))
    return any("silently" in name for name in tally)


if __name__ == "__main__":
    sys.exit(main())
