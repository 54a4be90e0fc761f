"""Write the line as JSF and svlog, and feed it as live ports, with odd properties."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.records import NavSample, Ping, SourceEvent
from auv_mcm.settings.config import parse_config
from drivers.framing import Framer
from drivers.navigation.corrections import moved
from drivers.navigation.nmea0183 import sentence
from drivers.navigation.sentences import Avr, Gga, Gpatt, Hdg, Hdm, Hdt, Hpr, Ohpr, Record, Rmc, Ths, Vtg, Zda, body_of
from drivers.port_intake import PortIntake
from drivers.ports import read_ports
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import DATA_HEADER, JsfMessage, SideScanHeader, Validity
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import OsMonoProfile, decode, encode
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.fakes.device import SONARS
from sim_replay.fakes.sonar import DeviceTime
from sim_replay.wire_logs import nmea_packet, svlog_head
from tests.make.odd_line import RANGE_M, line

UTC_S: Final = 1_790_000_000.0  # 2026-09: no rollover by itself
_MONO_S: Final = 5000.0
_WEEKS_S: Final = 1024 * 7 * 86_400.0
_SPEEDS: Final = {"right": 1.0, "zero": 0.0, "half": 0.5144, "thrice": 3.0, "tenth": 0.1}
_AHEAD_S: Final = {"ahead_60_s": 60.0, "ahead_20_min": 1200.0, "behind_3_min": -180.0}
_PERIODS_S: Final = {"each_second": 1.0, "each_5_s": 5.0}
_BACK_S: Final = {"rollover": _WEEKS_S, "two_rollovers": 2.0 * _WEEKS_S}
_VARIATION_DEG: Final = 12.0
_KNOT_MPS: Final = 1852.0 / 3600.0


def scattered(sample: NavSample, random: np.random.Generator) -> NavSample:
    """Move a position by 0.3 m on each axis or so."""
    east_m, north_m = random.normal(0.0, 0.3, 2)
    latitude, longitude = moved(sample.latitude_deg, sample.longitude_deg, float(east_m), float(north_m))
    return structs.replace(sample, latitude_deg=latitude, longitude_deg=longitude)


def line_of(record: Record) -> bytes:
    """Write a sentence."""
    return sentence(body_of(record))


def gga(sample: NavSample) -> bytes:
    """Write a sample's position."""
    return line_of(Gga(sample.time_s % 86_400.0, sample.latitude_deg, sample.longitude_deg, 4.0, 12.0, 0.7))


def hdt(sample: NavSample) -> bytes:
    """Write a sample's heading."""
    return line_of(Hdt(sample.heading_rad % math.tau))


def _sentences(sample: NavSample, values: dict[str, str], gives_position: bool) -> bytes:
    day_s, heading = sample.time_s % 86_400.0, sample.heading_rad % math.tau
    variation = math.radians(_VARIATION_DEG)
    magnetic = (heading - variation) % math.tau
    parts = [gga(sample)] if gives_position else []
    speed_mps = sample.speed_mps * _SPEEDS.get(values["speed"], math.nan)
    if values["heading"] == "HDM_RMC" and gives_position:
        days = sample.time_s // 86_400.0
        place = (sample.latitude_deg, sample.longitude_deg, math.nan, math.nan)
        parts.append(line_of(Rmc(day_s, "A", *place, days, variation, "A")))
    if values["speed"] != "absent":
        parts.append(line_of(Vtg(math.nan, speed_mps, "A")))
    headings: dict[str, Record] = {
        "HDT": Hdt(heading),
        "THS": Ths(heading, "A"),
        "HDG": Hdg(magnetic, math.nan, variation),
        "HDM_RMC": Hdm(magnetic),
        "HDM": Hdm(magnetic),
        "PSAT": Hpr(day_s, heading, 0.0, 0.0, "N"),
        "PTNL": Avr(day_s, heading, 0.0, math.nan, 1.0, 3.0),
        "PFEC": Gpatt(heading, 0.0, 0.0),
        "OHPR": Ohpr(heading, 0.0, 0.0),
        "zero": Hdt(0.0),
    }
    if values["heading"] in headings:
        parts.append(line_of(headings[values["heading"]]))
    return b"".join(parts)


def _arrivals(kind: str, values: dict[str, str], seed: int) -> Iterator[tuple[float, str, bytes]]:
    """Yield bytes of the sonar and of the navigation unit, and when they came, s since the first event."""
    text = f"""
ports:
  - {{name: sonar, link: "tcp://192.168.2.92:1", device: {kind}, sonar: {{range_m: {RANGE_M}, n_samples: 500}}}}
"""
    sonar, random = SONARS[kind](), np.random.default_rng(seed)
    for command in read_ports(parse_config(text, "odd.yaml"))[0].commands:
        sonar.heard(command, DeviceTime(0.0, UTC_S))
    events = line().events
    start_s, last_fix_s = events[0].time_s, -math.inf
    period_s = _PERIODS_S.get(values["position"], 0.0)
    for event in events:
        at_s = round(event.time_s - start_s, 3)
        if isinstance(event, NavSample):
            sample = structs.replace(event, time_s=UTC_S + at_s)
            if values["position"] == "scatter":
                sample = scattered(sample, random)
            gives_position = at_s - last_fix_s >= period_s - 1e-6
            last_fix_s = at_s if gives_position else last_fix_s
            yield at_s, "nav", _sentences(sample, values, gives_position)
            continue
        messages = sonar.ping(event, DeviceTime(77.0 + at_s, UTC_S + at_s))
        for message in _profiles(messages, values["sides"]) if kind == "ping_protocol" else messages:
            yield at_s + 2.0 * RANGE_M / event.sound_speed_mps, "sonar", message


def _profiles(messages: list[bytes], sides: str) -> Iterator[bytes]:
    """Give the profiles of a ping other channels, look angles or frequencies; port comes first."""
    framer = Framer(PingGrammar())
    profiles = [decode(framed.message) for message in messages for framed in framer.feed(message)]
    for place, profile in enumerate(profiles):
        assert isinstance(profile, OsMonoProfile)
        if "from_one" in sides:
            profile = profile._replace(channel_number=place + 1)
        elif "zeros" in sides:
            profile = profile._replace(channel_number=0)
        elif "exchanged" in sides:
            profile = profile._replace(channel_number=1 - place)
        if "angles" in sides:
            profile = profile._replace(transducer_heading_deg=(-90.0, 90.0)[place])
        if "frequencies" in sides:
            yield encode(profile._replace(ping_hz=100_000, pwr_results=profile.pwr_results[::2] // 2))
        yield encode(profile)


def write_svlog(path: Path, values: dict[str, str], seed: int) -> None:
    """Write what SonarView records."""
    first_s = next(event.time_s for event in line().events if isinstance(event, Ping)) - line().events[0].time_s
    parts = [svlog_head(UTC_S + first_s)]
    for _, port, data in _arrivals("ping_protocol", values, seed):
        if port == "sonar":
            parts.append(data)
        else:
            parts += [nmea_packet(one) for one in data.splitlines(keepends=True)]
    path.write_bytes(b"".join(parts))


def port_events(values: dict[str, str], seed: int) -> Iterator[SourceEvent]:
    """Feed live ports: a sonar, and a unit that gives UTC."""
    text = f"""
ports:
  - {{name: sonar, link: "tcp://192.168.2.92:1", device: ping_protocol, sonar: {{range_m: {RANGE_M}, n_samples: 500}}}}
  - {{name: nav, link: "tcp://192.168.2.93:2", device: nmea0183, navigation: {{gives_utc: true}}}}
"""
    intake = PortIntake(parse_config(text, "odd.yaml"))
    ahead_s, back_s = _AHEAD_S.get(values["clock"], 0.0), _BACK_S.get(values["clock"], 0.0)
    last_zda_s = -math.inf
    for at_s, port, data in sorted(_arrivals("ping_protocol", values, seed), key=lambda arrival: arrival[0]):
        stamp = Stamp(round(1e9 * (_MONO_S + at_s)), round(1e9 * (UTC_S + at_s + ahead_s)))
        if port == "nav" and at_s - last_zda_s >= 1.0:
            last_zda_s = at_s
            now_s = UTC_S + at_s - back_s
            data += line_of(Zda(now_s % 86_400.0, now_s // 86_400.0))
        yield from intake.feed(port, data, stamp)
    yield from intake.finish()


def write_jsf(path: Path, values: dict[str, str]) -> None:
    """Write what EdgeTech's topside records, with the navigation in the sonar's messages or beside them."""
    parts: list[bytes] = []
    sample = NavSample(time_s=UTC_S)
    start_s = line().events[0].time_s
    held, held_s = sample, -math.inf
    samples = {round(e.time_s - start_s, 3): e for e in line().events if isinstance(e, NavSample)}
    for at_s, port, data in _arrivals("jsf", {**values, "position": "10_hz", "heading": "absent"}, 0):
        if port == "nav":
            sample = structs.replace(samples[at_s], time_s=UTC_S + at_s)
            parts += _jsf_navigation(sample, values, at_s)
        else:
            for framed in Framer(JsfGrammar()).feed(data + bytes(16)):
                if values["position"] == "header" or at_s - held_s >= 5.0:
                    held, held_s = sample, at_s
                parts += _jsf_sides(framed.message, _jsf_ping(framed.message, sample, held, values), values)
    path.write_bytes(b"".join(parts))


def _jsf_time(time_s: float, values: dict[str, str]) -> bytes:
    if values["clock"] != "right":
        return bytes(12)
    return int(time_s).to_bytes(4, "little") + round(1e3 * (time_s % 1.0)).to_bytes(4, "little") + bytes(4)


def _jsf_navigation(sample: NavSample, values: dict[str, str], at_s: float) -> list[bytes]:
    head, parts = _jsf_time(sample.time_s, values), []
    if values["position"] == "sentence":
        parts.append(jsf_wire(JsfMessage(2002, head + gga(sample) + b"\0", subsystem=101)))
    if values["heading"] == "sentence":
        parts.append(jsf_wire(JsfMessage(2002, head + hdt(sample) + b"\0", subsystem=101)))
    if values["sound_speed"] == "pressure_sensor":
        body = head + bytes(20) + (1_500_000).to_bytes(4, "little") + bytes(40)
        parts.append(jsf_wire(JsfMessage(2060, body, subsystem=101)))
    return parts


def _jsf_sides(message: JsfMessage, filled: JsfMessage, values: dict[str, str]) -> Iterator[bytes]:
    """Write a side of a ping under another channel, beside another frequency, or behind a large message."""
    match values["sides"]:
        case "zeros":
            filled = filled._replace(channel=0)
        case "from_one":
            filled = filled._replace(channel=message.channel + 1)
        case "frequencies":
            low = SideScanHeader(*DATA_HEADER.unpack_from(filled.body))
            low = low._replace(start_frequency_dahz=10_000, end_frequency_dahz=10_000)
            yield jsf_wire(filled._replace(subsystem=20, body=DATA_HEADER.pack(*low) + filled.body[DATA_HEADER.size :]))
        case "bathymetry":
            yield jsf_wire(JsfMessage(3000, _jsf_time(0.0, values) + bytes(18_000), subsystem=40))
    yield jsf_wire(filled)


def _jsf_ping(message: JsfMessage, sample: NavSample, held: NavSample, values: dict[str, str]) -> JsfMessage:
    """Fill in what a sonar's message says of the vehicle; held: the newest position that it was given."""
    header = SideScanHeader(*DATA_HEADER.unpack_from(message.body))
    validity = header.validity
    if values["position"].startswith("header"):
        validity |= Validity.POSITION
        header = header._replace(
            longitude=round(600_000 * held.longitude_deg), latitude=round(600_000 * held.latitude_deg)
        )
    if values["heading"] in ("right", "zero"):
        validity |= Validity.HEADING
        heading_deg = math.degrees(sample.heading_rad) % 360.0 if values["heading"] == "right" else 0.0
        header = header._replace(heading_cdeg=round(100 * heading_deg) % 36_000)
    if values["speed"] != "absent":
        validity |= Validity.SPEED
        header = header._replace(speed_dkn=round(10 * sample.speed_mps * _SPEEDS[values["speed"]] / _KNOT_MPS))
    if values["sound_speed"] == "pressure_sensor":
        validity &= ~Validity.SOUND_SPEED
        header = header._replace(sound_speed_mps=0.0)
    if values["clock"] != "right":
        when = datetime.fromtimestamp(header.time_s, UTC)
        header = header._replace(time_s=0)
        if values["clock"] == "version_7":
            header = header._replace(
                year=when.year,
                day_of_year=when.timetuple().tm_yday,
                hour=when.hour,
                minute=when.minute,
                second=when.second,
            )
    body = DATA_HEADER.pack(*header._replace(validity=validity)) + message.body[DATA_HEADER.size :]
    return message._replace(body=body, version=7 if values["clock"] == "version_7" else message.version)
