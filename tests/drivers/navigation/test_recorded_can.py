"""Recorded NMEA 2000 traffic of four loggers is read whole, other decoders agree on it, and its tracks are those that
were sailed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.records import NavSample
from auv_mcm.settings.port_settings import NavUnitSettings
from drivers.navigation.corrections import offset_m
from drivers.navigation.merge import NavMerge
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.n2k_messages import MESSAGES, decode, identifier_of
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from tests.drivers.navigation.recorded_can import RecordedMessage, read_can_log

Shared = Callable[[str], Path]
# Messages and skipped lines of each log: a heading without a comment sign, and groups beyond 18 bits that a gateway
# made up.
LOGS = {
    "aava-n2k.data": (20_995, 600),
    "candumpSample1.txt": (6_026, 1),
    "candumpSample3.txt": (2_368, 0),
    "furuno-130842-figure8-fast.raw": (34_465, 0),
    "furuno-130842-wide-turn.raw": (21_190, 0),
    "sample3_PCAN-View.trc": (12_274, 0),
}


def put(bus: N2kBus, message: RecordedMessage) -> list[NavFix]:
    ns = 0 if math.isnan(message.time_s) else round(message.time_s * 1e9)
    stamp = Stamp(ns, ns)
    if not message.is_whole:
        return bus.feed(message.can_id, message.data, stamp)
    _, pgn, _, source = identifier_of(message.can_id)
    return bus.feed_message(pgn, source, message.data, stamp)


def fixes_in(path: Path) -> tuple[list[NavFix], N2kBus]:
    bus = N2kBus("can")
    return [fix for message in read_can_log(path, Counter()) for fix in put(bus, message)], bus


@pytest.mark.parametrize("name", LOGS)
def test_every_log_is_read_whole_and_without_an_error(name: str, shared_data: Shared) -> None:
    counters: Counter[str] = Counter()
    messages = list(read_can_log(shared_data(f"can/{name}"), counters))
    assert (len(messages), counters["can_log.lines_skipped"]) == LOGS[name]
    times = [message.time_s for message in messages if not math.isnan(message.time_s)]
    assert all(-0.1 <= later - earlier < 10.0 for earlier, later in pairwise(times))
    _, bus = fixes_in(shared_data(f"can/{name}"))
    assert bus.counters["n2k.messages"] > 500
    assert bus.counters["n2k.short"] == 0
    assert not [counter for counter in bus.counters if "fast_packet" in counter and not counter.endswith("messages")]


@pytest.mark.parametrize("name", LOGS)
def test_another_decoder_reads_the_same_numbers(name: str, shared_data: Shared) -> None:
    nmea2000 = pytest.importorskip("nmea2000", reason="nmea2000, canboat's tables in another decoder, is not installed")
    seen: Counter[int] = Counter()
    for message in read_can_log(shared_data(f"can/{name}"), Counter()):
        _, pgn, _, source = identifier_of(message.can_id)
        layout = MESSAGES.get(pgn)
        if layout is None or seen[pgn] >= 40 or len(message.data) < layout.n_bytes:
            continue
        seen[pgn] += 1
        mine = decode(pgn, message.data)
        assert mine is not None
        text = f"2023-11-14T22:13:20.000Z,3,{pgn},{source},255,{len(message.data)}," + ",".join(
            f"{byte:02x}" for byte in message.data
        )
        fields = nmea2000.NMEA2000Decoder().decode(text).fields
        theirs = [field.raw_value for field in fields if not field.id.startswith("reserved")]
        for value, their_value, field in zip(mine, theirs[: len(mine)], layout.fields, strict=True):
            if math.isnan(value):
                assert their_value in (None, (1 << field.n_bits) - 1, (1 << field.n_bits) - 2)
            else:
                assert their_value == pytest.approx(value, rel=1e-6, abs=1e-7)
    assert seen


def test_a_figure_of_eight_turns_one_way_and_then_the_other(shared_data: Shared) -> None:
    fixes, _ = fixes_in(shared_data("can/furuno-130842-figure8-fast.raw"))
    headings = [fix.heading_rad for fix in fixes if fix.source == "can.52" and not math.isnan(fix.heading_rad)]
    turned = [0.0]
    for before, after in pairwise(headings):
        turned.append(turned[-1] + math.remainder(after - before, 2 * math.pi))
    assert max(turned) > math.radians(150.0)
    assert turned[-1] - max(turned) < -math.radians(150.0)


def test_a_wide_turn_goes_round_once(shared_data: Shared) -> None:
    fixes, _ = fixes_in(shared_data("can/furuno-130842-wide-turn.raw"))
    headings = [fix.heading_rad for fix in fixes if fix.source == "can.52" and not math.isnan(fix.heading_rad)]
    turned = sum(math.remainder(after - before, 2 * math.pi) for before, after in pairwise(headings))
    assert abs(math.degrees(turned)) == pytest.approx(360.0, abs=60.0)


@pytest.mark.parametrize("name", ["furuno-130842-figure8-fast.raw", "furuno-130842-wide-turn.raw"])
def test_reckoning_by_a_recorded_compass_ends_where_the_other_receiver_does(name: str, shared_data: Shared) -> None:
    fixes, _ = fixes_in(shared_data(f"can/{name}"))
    start_ns = fixes[0].received.mono_ns
    receiver = [fix for fix in fixes if fix.source == "can.25" and not math.isnan(fix.latitude_deg)]
    units = {
        "can.25": NavUnitSettings(delivers=("position",)),
        "can.52": NavUnitSettings(delivers=("heading", "attitude", "speed")),
    }
    merged = NavMerge(NavMergeSettings(units=units, max_speed_mps=10.0))
    events = [
        event
        for fix in fixes
        if fix.source == "can.52" or (fix.source == "can.25" and fix.received.mono_ns - start_ns < 10e9)
        for event in merged.feed(fix)
    ] + merged.finish()
    track = [event for event in events if isinstance(event, NavSample) and not math.isnan(event.latitude_deg)]
    assert track[-1].time_s - track[0].time_s > 200.0
    end = (receiver[-1].latitude_deg, receiver[-1].longitude_deg)
    assert math.hypot(*offset_m(end, (track[-1].latitude_deg, track[-1].longitude_deg))) < 10.0
    assert merged.position_sigma_m > 10.0
