"""NMEA 2000: what is written is read back, other decoders agree, and lost or foreign frames cost no more than their own
message."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.navigation import n2k_messages as n2k
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.n2k_fast_packet import MAX_MESSAGE_BYTES, FastPackets, frames_of
from drivers.navigation.nav_decoder import NavFix
from tests.drivers.navigation.nav_damage import T0, at, is_subsequence


@st.composite
def record(draw: st.DrawFn) -> n2k.Record:
    message = draw(st.sampled_from(list(n2k.MESSAGES.values())))
    values = []
    for _, n_bits, signed, resolution in message.fields:
        high = (1 << n_bits - signed) - (3 if n_bits > 2 else 2)
        raw = draw(st.one_of(st.none(), st.integers(-(1 << n_bits - 1) if signed else 0, high)))
        values.append(NAN if raw is None else raw * resolution)
    made: n2k.Record = message.make(*values)
    return made


def can_id(pgn: int, source: int) -> int:
    return n2k.can_id_of(n2k.Identifier(3, pgn, n2k.GLOBAL, source))


def sent(bus: N2kBus, record: n2k.Record, source: int = 35, stamp: Stamp = T0) -> list[NavFix]:
    """Put a record on the bus, in as many frames as it takes."""
    pgn, data = n2k.encode(record)
    frames = frames_of(data, 3) if pgn in n2k.FAST_PACKET_GROUPS else [data]
    return [fix for frame in frames for fix in bus.feed(can_id(pgn, source), frame, stamp)]


def claim(bus: N2kBus, name: int, address: int) -> None:
    assert (
        bus.feed(
            n2k.can_id_of(n2k.Identifier(6, n2k.ADDRESS_CLAIM, n2k.GLOBAL, address)), name.to_bytes(8, "little"), T0
        )
        == []
    )


@given(record())
def test_what_is_written_is_read_back(made: n2k.Record) -> None:
    pgn, data = n2k.encode(made)
    again = n2k.decode(pgn, data)
    assert again is not None
    assert type(again) is type(made)
    assert n2k.encode(again) == (pgn, data)
    for value, expected in zip(again, made, strict=True):
        assert (
            value == expected
            or (math.isnan(value) and math.isnan(expected))
            or abs(value - expected) <= 1e-15 * abs(expected)
        )


@given(record())
def test_another_decoder_sees_the_same_numbers(made: n2k.Record) -> None:
    nmea2000 = pytest.importorskip("nmea2000", reason="nmea2000, canboat's tables in another decoder, is not installed")
    pgn, data = n2k.encode(made)
    text = f"2023-11-14T22:13:20.000Z,3,{pgn},35,255,{len(data)}," + ",".join(f"{byte:02x}" for byte in data)
    if any("date" in name or "time" in name for name, value in made._asdict().items() if value > 86_400.0):
        return  # a time beyond midnight, which that decoder refuses
    message = nmea2000.NMEA2000Decoder().decode(text)
    theirs = [field.raw_value for field in message.fields if not field.id.startswith("reserved")]
    for value, their_value, (_, n_bits, signed, resolution) in zip(
        made, theirs[: len(made)], n2k.MESSAGES[pgn].fields, strict=True
    ):
        if math.isnan(value):
            assert their_value in (None, (1 << n_bits) - 1), "a list of names may have one for 'not available'"
        elif their_value is None:
            largest = (1 << n_bits - signed) * resolution
            assert abs(value) > 0.95 * largest or pgn in (129025, 129029), (
                "it refuses angles of more than a turn, places beyond a pole"
            )
        else:
            assert their_value == pytest.approx(value, rel=1e-6, abs=1e-7)


def test_the_identifier_gives_group_and_source() -> None:
    assert n2k.identifier_of(0x09F80103) == (2, 129025, 255, 3)
    assert n2k.identifier_of(0x18EAFF09) == (6, 59904, 255, 9)
    assert n2k.identifier_of(0x1DEF0123) == (7, 126720, 1, 0x23)


@given(st.integers(0, 7), st.integers(0, 0x3FFFF), st.integers(0, 255), st.integers(0, 255))
def test_identifiers_are_read_back(priority: int, pgn: int, destination: int, source: int) -> None:
    if pgn >> 8 & 0xFF < 240:
        pgn &= 0x3FF00
    else:
        destination = n2k.GLOBAL
    identifier = n2k.Identifier(priority, pgn, destination, source)
    assert n2k.identifier_of(n2k.can_id_of(identifier)) == identifier


def test_a_recorded_position_is_read_as_other_decoders_do() -> None:
    [fix] = N2kBus("can").feed(0x09F80103, struct.pack("<ii", 481_000_000, 115_000_000), T0)
    assert fix.source == "can.3"
    assert [fix.latitude_deg, fix.longitude_deg] == pytest.approx([48.1, 11.5])


def test_a_recorded_gnss_position_is_read() -> None:
    text = "87a93ffcedc42800586711cfdb490800f41547c4d26e0380662300000000001 0fc0a5000ff7fffffff7f00".replace(" ", "")
    [fix] = N2kBus("can").feed_message(129029, 160, bytes.fromhex(text), T0)
    assert [fix.latitude_deg, fix.longitude_deg] == pytest.approx([59.7250108, 24.736677])
    assert fix.time_utc_s == pytest.approx(16_297 * 86_400 + 68_399.462, abs=1e-4)


@given(record())
def test_too_short_messages_are_refused(made: n2k.Record) -> None:
    pgn, data = n2k.encode(made)
    bus = N2kBus("can")
    assert bus.feed_message(pgn, 1, data[:-1], T0) == []
    assert bus.counters["n2k.short"] == 1


@pytest.mark.parametrize(
    ("made", "reported"),
    [
        (n2k.Heading(1.0, 1.2, NAN, NAN, 0.0), {"heading_rad": 1.2}),
        (n2k.Heading(1.0, 6.2, 0.01, 0.1, 1.0), {"heading_rad": 6.31 - 2 * math.pi}),
        (n2k.Heading(1.0, NAN, 0.01, 0.1, 1.0), {}),
        (n2k.Attitude(1.0, -0.5, 0.1, -0.2), {"heading_rad": 2 * math.pi - 0.5, "pitch_rad": 0.1, "roll_rad": -0.2}),
        (n2k.Attitude(1.0, NAN, NAN, NAN), {}),
        (n2k.Speed(1.0, 1.5, 1.25, 0.0), {"speed_mps": 1.25, "water_speed_mps": 1.5}),
        (n2k.WaterDepth(1.0, 12.5, 0.0, NAN), {"altitude_m": 12.5}),
        (n2k.WaterDepth(1.0, NAN, 0.0, NAN), {}),
        (n2k.RapidCourse(1.0, 0.0, 1.5, 2.0), {"course_rad": 1.5, "speed_mps": 2.0}),
        (n2k.RapidCourse(1.0, 1.0, 1.5, 2.0), {"speed_mps": 2.0}),
        (n2k.RapidPosition(NAN, 11.0), {}),
        (n2k.SystemTime(1.0, 0.0, 19_675.0, 80_000.25), {"time_utc_s": 1_700_000_000.25}),
    ],
)
def test_messages_give_fields(made: n2k.Record, reported: dict[str, float]) -> None:
    [fix] = sent(N2kBus("can"), made)
    names = ("time_utc_s", *NavFix.__struct_fields__[7:])
    found = {
        name: getattr(fix, name)
        for name in names
        if isinstance(getattr(fix, name), float) and not math.isnan(getattr(fix, name))
    }
    assert found == pytest.approx(reported, rel=1e-9)
    assert fix.valid == bool(reported)


def test_a_magnetic_heading_needs_a_variation() -> None:
    bus = N2kBus("can")
    magnetic = n2k.Heading(NAN, 1.0, NAN, NAN, 1.0)
    assert sent(bus, magnetic) == []
    assert bus.counters["n2k.heading_magnetic"] == 1
    assert sent(bus, n2k.MagneticVariation(NAN, 8.0, NAN, -0.05)) == []
    [fix] = sent(bus, magnetic)
    assert fix.heading_rad == pytest.approx(0.95)
    [fix] = sent(bus, magnetic, source=36)
    assert fix.heading_rad == pytest.approx(0.95), "variation is of the place, whichever unit sends it"
    sent(bus, n2k.MagneticVariation(NAN, 8.0, NAN, 0.02), source=36)
    assert [sent(bus, magnetic, source=unit)[0].heading_rad for unit in (35, 36)] == pytest.approx([0.95, 1.02])
    sent(bus, n2k.MagneticVariation(NAN, 8.0, NAN, NAN))
    assert sent(bus, magnetic)[0].heading_rad == pytest.approx(1.02)


def test_a_unit_that_sends_a_heading_is_not_heard_again_through_its_yaw() -> None:
    bus = N2kBus("can")
    sent(bus, n2k.Heading(NAN, 1.0, NAN, NAN, 0.0))
    [fix] = sent(bus, n2k.Attitude(NAN, -0.3, 0.1, 0.2))
    assert math.isnan(fix.heading_rad)


@pytest.mark.parametrize("reference", [1.0, 2.0, NAN])
def test_a_heading_that_is_not_known_to_be_true_is_not_taken_from_the_yaw_instead(reference: float) -> None:
    """A compass sends the same angle in both, and PGN 127257 does not state the north it is from."""
    bus = N2kBus("can")
    assert sent(bus, n2k.Heading(NAN, 2.3154, NAN, NAN, reference)) == []
    [fix] = sent(bus, n2k.Attitude(NAN, 2.3154, -0.2054, 0.1279))
    assert math.isnan(fix.heading_rad)
    assert (fix.pitch_rad, fix.roll_rad) == pytest.approx((-0.2054, 0.1279))


@pytest.mark.parametrize("method", [0.0, 7.0, 8.0, NAN])
def test_a_receiver_without_a_fix_gives_no_place_in_its_other_messages_either(method: float) -> None:
    bus = N2kBus("can")
    place = n2k.RapidPosition(48.0, 11.0)
    assert sent(bus, place)[0].valid
    gnss = n2k.GnssPosition(1.0, 19_675.0, 1.0, 48.0, 11.0, 0.0, 0.0, method, 0.0, 8.0, 1.0, 1.0, 40.0, 0.0)
    assert not sent(bus, gnss)[0].valid
    [fix] = sent(bus, place)
    assert not fix.valid
    assert math.isnan(fix.latitude_deg)
    sent(bus, gnss._replace(method=1.0))
    assert sent(bus, place)[0].valid


def test_messages_of_one_sid_carry_the_stamp_of_the_first() -> None:
    bus = N2kBus("can")
    heading, attitude, depth = (
        n2k.Heading(7.0, 1.0, NAN, NAN, 0.0),
        n2k.Attitude(7.0, NAN, 0.1, 0.2),
        n2k.WaterDepth(7.0, 5.0, 0.0, NAN),
    )
    group: tuple[n2k.Record, ...] = heading, attitude, depth
    stamps = [sent(bus, made, stamp=at(place * 0.004))[0].received for place, made in enumerate(group)]
    assert stamps == [at(0.0)] * 3
    assert sent(bus, heading, stamp=at(0.012))[0].received == at(0.012), "a unit that does not count its sids"
    assert sent(bus, attitude, stamp=at(0.064))[0].received == at(0.064), "long after"
    assert sent(bus, depth._replace(sid=8.0), stamp=at(0.204))[0].received == at(0.204)
    assert sent(bus, depth, source=9, stamp=at(0.205))[0].received == at(0.205), "another unit's sid"
    without: tuple[n2k.Record, ...] = heading._replace(sid=NAN), attitude._replace(sid=NAN)
    unnumbered = [sent(bus, made, stamp=at(1.0 + i))[0].received for i, made in enumerate(without)]
    assert unnumbered == [at(1.0), at(2.0)]


def test_a_unit_keeps_its_name_when_it_claims_another_address() -> None:
    bus = N2kBus("can")
    heading = n2k.Heading(NAN, 1.0, NAN, NAN, 0.0)
    assert sent(bus, heading, 35)[0].source == "can.35"
    claim(bus, 0xC0788200E7E0B312, 35)
    assert sent(bus, heading, 35)[0].source == "can.35"
    claim(bus, 0xC0788200E7E0B312, 40)
    assert sent(bus, heading, 40)[0].source == "can.35"
    claim(bus, 0x1234, 35)
    assert sent(bus, heading, 35)[0].source == "can.0000000000001234", "the name is taken"
    claim(bus, 0x1234, 254)
    assert bus.units == {"can.35": 0xC0788200E7E0B312}


@given(st.binary(min_size=1, max_size=MAX_MESSAGE_BYTES), st.integers(0, 7))
def test_fast_packets_are_put_together_again(data: bytes, sequence: int) -> None:
    packets = FastPackets()
    frames = frames_of(data, sequence)
    assert all(len(frame) == 8 for frame in frames)
    assert [packets.add(129029, 3, frame) for frame in frames] == [None] * (len(frames) - 1) + [data]


@given(data=st.data())
def test_intact_fast_packets_survive_lost_repeated_and_foreign_frames(data: st.DataObject) -> None:
    """Several talkers at once, each in order; of some messages frames are lost, swapped or damaged."""
    lanes: list[list[tuple[int, bytes]]] = []
    wanted: dict[int, list[bytes]] = {}
    sent: set[bytes] = set()
    is_damaged = False
    for source in range(data.draw(st.integers(1, 4))):
        lane: list[tuple[int, bytes]] = []
        wanted[source] = []
        for sequence in range(data.draw(st.integers(1, 5))):
            message = data.draw(st.binary(min_size=9, max_size=60))
            frames = frames_of(message, sequence)
            sent.add(message)
            kind = data.draw(st.sampled_from(["intact", "lost", "repeated", "swapped", "damaged"]))
            is_damaged = is_damaged or kind == "damaged"
            place = data.draw(st.integers(0, len(frames) - 1))
            if kind == "lost":
                del frames[place]
            elif kind == "repeated":
                frames.insert(place, frames[place])
            elif kind == "swapped":
                frames[0], frames[-1] = frames[-1], frames[0]
            elif kind == "damaged":
                frames[place] = data.draw(st.binary(max_size=8))
            else:
                wanted[source].append(message)
            lane += [(source, frame) for frame in frames]
        lanes.append(lane)
    packets = FastPackets()
    found: dict[int, list[bytes]] = {source: [] for source in wanted}
    while any(lanes):
        source, frame = data.draw(st.sampled_from([lane for lane in lanes if lane])).pop(0)
        whole = packets.add(129029, source, frame)
        if whole is not None:
            found[source].append(whole)
    for source, messages in wanted.items():
        assert is_subsequence(messages, found[source])
        assert is_damaged or sent.issuperset(found[source])


@given(st.lists(st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8)), max_size=60))
def test_no_frames_raise(frames: list[tuple[int, bytes]]) -> None:
    bus = N2kBus("can")
    for identifier, data in frames:
        bus.feed(identifier, data, T0)
        bus.feed(can_id(129029, identifier & 0xFF), data, T0)
        for pgn in n2k.MESSAGES:
            bus.feed(can_id(pgn, 1), data, T0)
    assert len(sent(bus, n2k.WaterDepth(7.0, 5.0, 0.0, NAN))) == 1


def test_a_unit_that_could_claim_no_address_at_first_is_named_by_the_one_it_gets() -> None:
    bus = N2kBus("bus")
    claim(bus, 0x1234, 254)
    claim(bus, 0x1234, 35)
    assert bus.units == {"bus.35": 0x1234}


def test_memory_stays_bounded_whatever_is_claimed_or_begun() -> None:
    bus = N2kBus("can")
    packets = FastPackets()
    for number in range(3000):
        bus.feed(can_id(n2k.ADDRESS_CLAIM, number % 250), number.to_bytes(8, "little"), T0)
        packets.add(number, number % 250, frames_of(bytes(60), number)[0])
    assert len(bus.units) <= 250
    assert len(bus._labels) <= 512
    assert len(packets._open) <= 64


def test_an_error_of_the_sender_is_no_number() -> None:
    assert n2k.decode(129025, struct.pack("<ii", 0x7FFFFFFE, 0x7FFFFFFF)) == pytest.approx((NAN, NAN), nan_ok=True)
    depth = n2k.decode(128267, struct.pack("<BIhB", 1, 0xFFFFFFFE, -300, 0xFE))
    assert depth == pytest.approx((1.0, NAN, -0.3, NAN), nan_ok=True)


def test_numbers_without_room_are_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        n2k.encode(n2k.WaterDepth(1.0, -1.0, 0.0, NAN))
    with pytest.raises(ValueError, match="does not fit"):
        n2k.encode(n2k.RapidPosition(214.7483646, 0.0))
