"""Measure how fast messages are found in bytes, what garbage costs, and whether damage costs only what it hit.

auv-mcm bench framers [--faults N] [--pings N] [--junk BYTES] [--seed N]
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np

from auv_mcm.clock import Stamp
from auv_mcm.errors import SelfCheckError
from auv_mcm.settings.vehicle_settings import BluefinSettings, IverSettings, ReconSettings
from drivers.framing import Framer, Grammar
from drivers.links.can_frame import CanFrame
from drivers.links.slcan import SlcanParser
from drivers.links.slcan import encode as slcan_encode
from drivers.navigation import dvl_pd6, dvl_water_linked, n2k_messages, sentences
from drivers.navigation.n2k_fast_packet import MAX_MESSAGE_BYTES, FastPackets, frames_of
from drivers.navigation.n2k_messages import FAST_PACKET_GROUPS, GLOBAL, Identifier, can_id_of, identifier_of
from drivers.navigation.nmea0183 import NmeaGrammar, sentence
from drivers.sonar import imagenex, jsf_messages, ping_messages
from drivers.sonar.imagenex import IgxGrammar, IgxReturn
from drivers.sonar.jsf import JsfDecoder, JsfGrammar
from drivers.sonar.jsf_messages import JsfMessage, SideScanData, SideScanHeader
from drivers.sonar.ping_messages import AsciiText, OsMonoProfile
from drivers.sonar.ping_protocol import PingDecoder, PingGrammar
from drivers.vehicle import bluefin_sentences, can_messages, imc_codec, imc_messages, iver_sentences, recon_sentences
from drivers.vehicle.bluefin_sentences import BluefinGrammar
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.imc_wire import ImcGrammar, ImcPacket, to_wire
from drivers.vehicle.iver_sentences import IverGrammar
from drivers.vehicle.recon_sentences import ReconGrammar
from sim_replay.arguments import count
from sim_replay.fakes.worst_bytes import WORST_BYTES

FaultKind = Literal["flip", "drop", "insert", "truncate", "duplicate"]
FAULT_KINDS: Final[tuple[FaultKind, ...]] = get_args(FaultKind)

_MESSAGES_PER_STREAM: Final = 200  # of one stream
_FAULTS_PER_STREAM: Final = 50  # put into one stream
_LONGEST_FAULT_BYTES: Final = 64  # bytes of one fault
_MAX_CHUNK_BYTES: Final = 400  # bytes of one read
_CHUNK_BYTES: Final = 4096  # bytes per read where speed is measured
_DATAGRAM_BYTES: Final = 97  # of a small datagram, each read by itself; a prime, so that pieces are cut anywhere
_SMALL: Final = "{} (97 bytes a read)"
MAX_S_PER_MB: Final = 0.3
"""Processor time that a framer may take for a megabyte, whatever it is: 9 % of a core at 921600 baud with nothing to
spare.
"""

_N_SAMPLES: Final = 1200  # per ping, of a usual side-scan
_ARRIVED: Final = Stamp(0, 0)
_VEHICLE_CAN_ADDRESS: Final = 96  # on the bus


class FramedWire(NamedTuple):
    """Describe one wire format under the fault campaign.

    messages: n intact messages as bytes, no two alike. read: runs a new framer over the chunks, to the end of the
    stream, and gives an equal item for equal messages.
    """

    name: str
    messages: Callable[[np.random.Generator, int], list[bytes]]
    read: Callable[[Iterable[bytes]], list[Hashable]]


class Damaged(NamedTuple):
    """Hold a stream after faults.

    intact: which of the messages it was made of are still in it, unbroken. n_faults: by kind.
    """

    stream: bytes
    intact: list[bool]
    n_faults: dict[FaultKind, int]


class CampaignRow(NamedTuple):
    """Count the messages of all streams of one wire. n_lost: intact ones that were not read.

    n_other: read from damaged or repeated bytes. n_false: of those, messages that nobody sent.
    """

    name: str
    n_faults: int
    n_messages: int
    n_intact: int
    n_lost: int
    n_other: int
    n_false: int


def damaged(messages: list[bytes], n_faults: int, random: np.random.Generator) -> Damaged:
    """Damage the joined messages at random places, as cables and drivers do.

    Bits flip, bytes get lost, are repeated or come from nowhere (at random, or as a piece of a message), and messages
    lose their end.
    """
    stream = b"".join(messages)
    ends = np.cumsum([len(message) for message in messages])
    starts = ends - [len(message) for message in messages]
    intact = np.ones(len(messages), dtype=np.bool_)
    n_by_kind: dict[FaultKind, int] = dict.fromkeys(FAULT_KINDS, 0)
    parts: list[bytes] = []
    done = 0
    for place in np.sort(random.integers(0, len(stream), n_faults)).tolist():
        if place < done:
            continue  # what is gone already
        kind = FAULT_KINDS[random.integers(len(FAULT_KINDS))]
        n_by_kind[kind] += 1
        parts.append(stream[done:place])
        stop = min(place + int(random.integers(1, _LONGEST_FAULT_BYTES + 1)), len(stream))
        piece = np.frombuffer(stream[place:stop], np.uint8)
        if kind == "truncate":
            stop = int(ends[np.searchsorted(ends, place, side="right")])
        if kind == "insert":
            inserted = stream[stop : 2 * stop - place] if random.random() < 0.5 else random.bytes(stop - place)
            parts.append(inserted)
            stop = place
            hit = (starts < place) & (place < ends)
        elif kind == "duplicate":
            parts.append(2 * piece.tobytes())
            hit = (starts < place) & (stop < ends)  # else one of its two copies is whole
        else:
            if kind == "flip":
                masks = np.left_shift(1, random.integers(0, 8, piece.shape)).astype(np.uint8)
                masks[1:] *= random.random(piece.shape[0] - 1) < 4.0 / _LONGEST_FAULT_BYTES
                parts.append((piece ^ masks).tobytes())
            hit = (starts < stop) & (place < ends)
        intact &= ~hit
        done = stop
    parts.append(stream[done:])
    return Damaged(b"".join(parts), intact.tolist(), n_by_kind)


def cut(stream: bytes, random: np.random.Generator) -> Iterator[bytes]:
    """Cut the stream into chunks of any length."""
    start = 0
    while start < len(stream):
        stop = start + int(random.integers(1, _MAX_CHUNK_BYTES + 1))
        yield stream[start:stop]
        start = stop


def n_missing(wanted: list[Hashable], found: list[Hashable]) -> int:
    """Count those of `wanted` that do not come in `found` in this order, whatever else comes between."""
    n_lost, position = 0, 0
    for item in wanted:
        try:
            position = found.index(item, position) + 1
        except ValueError:
            n_lost += 1
    return n_lost


def campaign(wire: FramedWire, n_faults: int, seed: int) -> CampaignRow:
    """Inject a minimum number of faults into streams of the wire's messages; equal seeds inject equal faults."""
    n_done = n_messages = n_intact = n_lost = n_other = n_false = 0
    stream_seed = 0
    while n_done < n_faults:
        random = np.random.Generator(np.random.PCG64([seed, stream_seed]))
        stream_seed += 1
        messages = wire.messages(random, _MESSAGES_PER_STREAM)
        keys = wire.read(messages)
        assert len(keys) == len(messages), f"{wire.name}: not every intact message of a clean stream is read"
        result = damaged(messages, _FAULTS_PER_STREAM, random)
        found = wire.read(cut(result.stream, random))
        wanted = [key for key, whole in zip(keys, result.intact, strict=True) if whole]
        n_missed = n_missing(wanted, found)
        n_done += sum(result.n_faults.values())
        n_messages += len(messages)
        n_intact += len(wanted)
        n_lost += n_missed
        n_other += len(found) - (len(wanted) - n_missed)
        sent = set(keys)
        n_false += sum(item not in sent for item in found)
    return CampaignRow(wire.name, n_done, n_messages, n_intact, n_lost, n_other, n_false)


def read_with(
    grammar: Callable[[], Grammar[Any]], key: Callable[[Any], Hashable]
) -> Callable[[Iterable[bytes]], list[Hashable]]:
    """Make `Wire.read` of a grammar of drivers.framing. key: of a message, equal for equal messages."""

    def read(chunks: Iterable[bytes]) -> list[Hashable]:
        framer = Framer(grammar())
        found = [framed for chunk in chunks for framed in framer.feed(chunk)]
        return [key(framed.message) for framed in found + framer.finish()]

    return read


def ping_stream_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Draw n messages of Ping Protocol: profiles, and texts between them."""
    wired = []
    for number in range(n):
        if random.random() < 0.2:
            wired.append(ping_messages.encode(AsciiText(f"message {number} " + "BR" * int(random.integers(20)))))
        else:
            wired.append(ping_messages.encode(made_profile(number, int(random.integers(20, 200)), random)))
    return wired


def _jsf_messages(random: np.random.Generator, n: int) -> list[bytes]:
    wired = []
    for number in range(n):
        if random.random() < 0.2:
            body = number.to_bytes(4, "little") + random.bytes(int(random.integers(80)))
            wired.append(jsf_messages.to_wire(JsfMessage(2002, body, session=number & 0xFF)))
        else:
            wired.append(
                jsf_messages.encode_data(made_side(number, int(random.integers(20, 200)), random), 21, number & 1)
            )
    return wired


def _igx_messages(random: np.random.Generator, n: int) -> list[bytes]:
    return [imagenex.encode_return(IgxReturn(30, 3, random.integers(0, 128, 400).astype(np.uint8))) for _ in range(n)]


def _nmea_messages(random: np.random.Generator, n: int) -> list[bytes]:
    records: list[sentences.Record] = []
    for number in range(n):
        time_of_day_s = 0.1 * number
        latitude_deg, longitude_deg = random.uniform(-80.0, 80.0), random.uniform(-179.0, 179.0)
        if number % 4 == 0:
            records.append(sentences.Gga(time_of_day_s, latitude_deg, longitude_deg, 1.0, 9.0, 1.1, 12.3, 40.1))
        elif number % 4 == 1:
            records.append(
                sentences.Rmc(
                    time_of_day_s, "A", latitude_deg, longitude_deg, 2.0, random.uniform(0.0, 6.0), 19_700.0, 0.02, "A"
                )
            )
        elif number % 4 == 2:
            records.append(sentences.Zda(time_of_day_s, 19_700.0))
        else:
            records.append(sentences.Pashr(time_of_day_s, random.uniform(0.0, 6.0), 0.01, -0.02))
    return [sentence(sentences.body_of(record)) for record in records]


def _pixse_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make bursts of a PHINS, each sentence a message."""
    bursts: list[sentences.Record] = []
    while len(bursts) < n:
        number = len(bursts)
        bursts += [
            sentences.Hdt(math.radians(0.1 * number)),
            sentences.PixseAttitude(math.radians(0.1 * number), random.normal(0.0, 0.05)),
            sentences.PixsePosition(43.0 + 1e-4 * number, random.uniform(5.0, 6.0), -random.uniform(1.0, 90.0)),
            sentences.PixseSpeed(0.01 * number, random.normal(0.0, 1.0), 0.0),
            sentences.PixseTime(0.1 * number),
        ]
    return [sentence(sentences.body_of(record)) for record in bursts[:n]]


def _water_linked_messages(random: np.random.Generator, n: int) -> list[bytes]:
    records: list[dvl_water_linked.Record] = []
    for number in range(n):
        if number % 2:
            x_m, y_m, z_m = random.uniform(-90.0, 90.0, 3).tolist()
            records.append(dvl_water_linked.WaterLinkedAttitude(0.1 * number, x_m, y_m, z_m, 0.4, 0.01, -0.02, 1.0, 0))
            continue
        covariance = tuple(random.uniform(0.0, 1e-6, 9))
        validity_us = 1_700_000_000_000_000 + 125_000 * number
        reported_us = validity_us + 80_000
        forward, starboard, down = random.normal(0.0, 1.0, 3).tolist()
        records.append(
            dvl_water_linked.Velocity(
                forward, starboard, down, True, 7.5, 0.002, covariance, validity_us, reported_us, 125.0, 0
            )
        )
    return [dvl_water_linked.message_of(record) for record in records]


def _pd6_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make groups of a DVL, each line a message."""
    lines: list[dvl_pd6.Line] = []
    while len(lines) < n:
        number = len(lines)
        lines += [
            dvl_pd6.Pd6Attitude(random.normal(0.0, 0.05), random.normal(0.0, 0.05), math.radians(0.1 * number)),
            dvl_pd6.Water(1_700_000_000.0 + 0.1 * number, 35.0, 12.0, random.uniform(1.0, 90.0), 1500.0),
            dvl_pd6.ShipVelocity(1e-3 * number, random.normal(1.5, 0.1), 0.0, True),
            dvl_pd6.Bottom(float(number), random.uniform(-900.0, 900.0), 0.0, random.uniform(2.0, 20.0), 0.0),
        ]
    return [dvl_pd6.line_of(line) for line in lines[:n]]


def _imc_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make packets of a vehicle in either byte order, some of kinds that the reader does not know."""
    wired = []
    for number in range(n):
        order: imc_codec.Order = ">" if random.random() < 0.2 else "<"
        message: imc_messages.ImcMessage
        if number % 4 == 0:
            message = imc_messages.EstimatedState(*random.uniform(-1.5, 1.5, 2), *random.normal(0.0, 10.0, 18))
        elif number % 4 == 1:
            message = imc_messages.PlanControlState(3, f"survey {number}", man_id="T" * int(random.integers(20)))
        elif number % 4 == 2:
            reference = imc_messages.Reference(1, lat=random.uniform(-1.5, 1.5), lon=random.uniform(-3.0, 3.0))
            message = imc_messages.FollowRefState(0x6000, 255, reference, 2, 1)
        else:
            wired.append(
                to_wire(
                    ImcPacket(276, random.bytes(int(random.integers(200))), 0x1E, time_s=float(number), order=order)
                )
            )
            continue
        payload = imc_codec.encode(message, order)
        wired.append(
            to_wire(ImcPacket(imc_codec.number_of(type(message)), payload, 0x1E, time_s=float(number), order=order))
        )
    return wired


def _bluefin_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = bluefin_sentences.table_of(BluefinSettings())
    records: list[Any] = []
    for number in range(n):
        time_s, (angle_rad, speed_mps) = 0.1 * number, random.uniform(0.0, 1.5, 2).tolist()
        place = random.uniform(-80.0, 80.0), random.uniform(-179.0, 179.0)
        if number % 3 == 0:
            position = (*place, 1.0, 5.0, random.uniform(1.0, 90.0), 4.0 * angle_rad, 0.01, -0.02, time_s)
            records.append(bluefin_sentences.BluefinPosition(time_s, *position))
        elif number % 3 == 1:
            records.append(bluefin_sentences.BluefinVelocity(time_s, angle_rad, speed_mps, 0.0))
        else:
            records.append(bluefin_sentences.BluefinAnswer(time_s, "RMB", time_s, "2", "taken"))
    return [sentence(table.body_of(record)) for record in records]


def _iver_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = iver_sentences.table_of(IverSettings())
    records: list[Any] = []
    for number in range(n):
        angle_rad, place_deg = random.uniform(0.0, 1.5), random.uniform(-80.0, 80.0, 2).tolist()
        if number % 2:
            records.append(
                iver_sentences.IverCompass(0.004 * number, angle_rad, -angle_rad, 20.0, random.uniform(0.0, 90.0))
            )
        else:
            records.append(
                iver_sentences.IverState._make(["NAWM"[number % 4], *place_deg, 1.5, 5.0, 0.004 * number, 12.0])
            )
    return [iver_sentences.line_of(table, record) for record in records]


def _recon_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = recon_sentences.table_of(ReconSettings())
    records = []
    for number in range(n):
        place_deg = random.uniform(-80.0, 80.0, 2).tolist()
        attitude = random.uniform(-0.2, 0.2, 2).tolist()
        going = (1500.0, 1500.0, 1.5, 0.004 * number, 0.0, 0.0, 1 + 12 * (number % 2), str(number))
        records.append(recon_sentences.ReconState._make([0.5 * number, *place_deg, 12.0, 12.0, 5.0, *attitude, *going]))
    return [recon_sentences.frame(table.body_of(record)) for record in records]


def _slcan_messages(random: np.random.Generator, n: int) -> list[bytes]:
    wired = []
    for number in range(n):
        data = number.to_bytes(2, "little") + random.bytes(int(random.integers(7)))
        extended = bool(random.random() < 0.8)
        wired.append(slcan_encode(CanFrame(int(random.integers(1 << (29 if extended else 11))), data, extended)))
    return wired


def _slcan_read(chunks: Iterable[bytes]) -> list[Hashable]:
    parser = SlcanParser(Counter())
    return [frame for chunk in chunks for frame in parser.feed(chunk)]


def _fast_packet_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make messages of 43 bytes, as a GNSS position has, and more, of three units by way of an slcan adapter."""
    pgn = n2k_messages.encode(n2k_messages.GnssPosition(*[math.nan] * 14))[0]
    assert pgn in FAST_PACKET_GROUPS
    wired = []
    for number in range(n):
        data = number.to_bytes(2, "little") + random.bytes(int(random.integers(41, MAX_MESSAGE_BYTES - 1)))
        can_id = can_id_of(Identifier(3, pgn, GLOBAL, 12 + number % 3))
        wired.append(b"".join(slcan_encode(CanFrame(can_id, frame)) for frame in frames_of(data, number // 3)))
    return wired


def _fast_packet_read(chunks: Iterable[bytes]) -> list[Hashable]:
    parser, packets = SlcanParser(Counter()), FastPackets()
    found: list[Hashable] = []
    for frame in (frame for chunk in chunks for frame in parser.feed(chunk)):
        _, pgn, _, source = identifier_of(frame.can_id)
        whole = packets.add(pgn, source, frame.data) if frame.extended and pgn in FAST_PACKET_GROUPS else None
        if whole is not None:
            found.append((source, whole))
    return found


def _vehicle_can_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make reports, commands and statuses of a payload, of 11, 4 and 1 frames, by way of an slcan adapter."""
    wired = []
    for number in range(n):
        message: can_messages.Record
        if number % 3 == 0:
            place = random.uniform(-80.0, 80.0), 1.0, random.uniform(-179.0, 179.0)
            message = can_messages.ReportMessage(1, number, 7, 1, 1e9, *place, 0.5, 18.0, 0, 1, *random.random(12))
        elif number % 3 == 1:
            message = can_messages.GoToMessage(
                random.uniform(-80.0, 80.0), 1.5, random.uniform(-179.0, 179.0), 3.0, 5.0, 1, 3.0, number, 1
            )
        else:
            message = can_messages.PayloadStatus(1, 3, 1, 1, number)
        wired.append(b"".join(map(slcan_encode, can_messages.encode(message, _VEHICLE_CAN_ADDRESS, number))))
    return wired


def _vehicle_can_read(chunks: Iterable[bytes]) -> list[Hashable]:
    parser, receiver = SlcanParser(Counter()), CanReceiver("vehicle_can", "payload", _VEHICLE_CAN_ADDRESS, Counter())
    whole = (receiver.add(frame, 0.0) for chunk in chunks for frame in parser.feed(chunk))
    return [received.record for received in whole if received is not None]


WIRES: Final = (
    FramedWire("ping_protocol", ping_stream_messages, read_with(PingGrammar, tuple)),
    FramedWire("jsf", _jsf_messages, read_with(JsfGrammar, tuple)),
    FramedWire("sportscan", _igx_messages, read_with(IgxGrammar, lambda ping: ping.echo.tobytes())),
    FramedWire("nmea0183", _nmea_messages, read_with(NmeaGrammar, str)),
    FramedWire("pixse", _pixse_messages, read_with(NmeaGrammar, str)),
    FramedWire("water_linked", _water_linked_messages, read_with(dvl_water_linked.TextGrammar, str)),
    FramedWire("pd6", _pd6_messages, read_with(dvl_pd6.LineGrammar, tuple)),
    FramedWire("imc", _imc_messages, read_with(ImcGrammar, tuple)),
    FramedWire("bluefin", _bluefin_messages, read_with(BluefinGrammar, str)),
    FramedWire("iver", _iver_messages, read_with(IverGrammar, str)),
    FramedWire("recon", _recon_messages, read_with(ReconGrammar, str)),
    FramedWire("slcan", _slcan_messages, _slcan_read),
    FramedWire("fast_packet", _fast_packet_messages, _fast_packet_read),
    FramedWire("vehicle_can", _vehicle_can_messages, _vehicle_can_read),
)


def made_profile(number: int, n_results: int, random: np.random.Generator) -> OsMonoProfile:
    """Make one side of a ping of an Omniscan 450, speckle on a scale of 80 dB; channels alternate."""
    power_db = -30.0 + 10.0 * np.log10(random.standard_exponential(n_results) + 1e-6)
    results = np.clip((power_db + 90.0) / 80.0 * 65535.0, 0.0, 65535.0).astype(np.uint16)
    return OsMonoProfile(
        ping_number=number // 2,
        start_mm=0,
        length_mm=50_000,
        timestamp_ms=number // 2 * 67,
        ping_hz=450_000,
        gain_index=3,
        sound_speed_dmps=15_000,
        channel_number=number & 1,
        pulse_duration_sec=1e-4,
        analog_gain=8.0,
        max_pwr_db=-10.0,
        min_pwr_db=-90.0,
        transducer_heading_deg=0.0,
        vehicle_heading_deg=0.0,
        pwr_results=results,
    )


def made_side(number: int, n_samples: int, random: np.random.Generator) -> SideScanData:
    """Make one side of a ping of an EdgeTech sonar, speckle of amplitude; its two sides have consecutive numbers."""
    header = SideScanHeader(
        time_s=1_700_000_000 + number // 2 // 15,
        ping_number=number // 2,
        milliseconds_today=number // 2 * 67 % 1000,
        interval_ns=20_000,
        weighting=4,
        sound_speed_mps=1500.0,
        validity=jsf_messages.Validity.SOUND_SPEED,
    )
    return SideScanData(header, (3000.0 * np.sqrt(random.standard_exponential(n_samples))).astype(np.uint16))


def _seconds(step: Callable[[], object]) -> float:
    """Time this thread, s, the minimum of three runs."""
    times = []
    for _ in range(3):
        began = time.thread_time()
        step()
        times.append(time.thread_time() - began)
    return min(times)


def speed_lines(n_pings: int) -> list[str]:
    """Measure messages per second, framed alone and decoded to samples.

    Pings of 1200 samples a side in chunks of 4 KiB.
    """
    random = np.random.Generator(np.random.PCG64(1))
    ping = b"".join(ping_messages.encode(made_profile(i, _N_SAMPLES, random)) for i in range(2 * n_pings))
    jsf = b"".join(jsf_messages.encode_data(made_side(i, _N_SAMPLES, random), 21, i & 1) for i in range(2 * n_pings))
    igx = b"".join(_igx_messages(random, 2 * n_pings))

    def feed(make: Callable[[], Any], stream: bytes, *stamp: Stamp) -> Callable[[], object]:
        def run() -> None:
            taker = make()
            for start in range(0, len(stream), _CHUNK_BYTES):
                taker.feed(stream[start : start + _CHUNK_BYTES], *stamp)

        return run

    n = 2 * n_pings
    rows: dict[str, tuple[Callable[[], object], int, int]] = {
        "ping_protocol": (feed(lambda: Framer(PingGrammar()), ping), n, len(ping)),
        "ping_protocol, to linear power": (feed(PingDecoder, ping, _ARRIVED), n, len(ping)),
        "jsf": (feed(lambda: Framer(JsfGrammar()), jsf), n, len(jsf)),
        "jsf, to amplitude": (feed(JsfDecoder, jsf, _ARRIVED), n, len(jsf)),
        "sportscan": (feed(lambda: Framer(IgxGrammar()), igx), n, len(igx)),
        "sportscan, to samples": (feed(imagenex.SportScanDecoder, igx, _ARRIVED), n, len(igx)),
    }
    if find_spec("brping") is not None:
        rows["ping_protocol, brping's PingParser"] = (_brping(ping), n, len(ping))
    lines = [f"{'found in chunks of 4096 bytes':<38}{'messages/s':>12}{'MB/s':>9}{'us each':>10}"]
    seconds = {name: _seconds(step) for name, (step, _, _) in rows.items()}
    for name, (_, n_messages, n_bytes) in rows.items():
        took = seconds[name]
        lines.append(
            f"{name:<38}{n_messages / took:>12.0f}{1e-6 * n_bytes / took:>9.1f}{1e6 * took / n_messages:>10.2f}"
        )
    if "ping_protocol, brping's PingParser" in rows:
        brping = seconds["ping_protocol, brping's PingParser"]
        framed, decoded = brping / seconds["ping_protocol"], brping / seconds["ping_protocol, to linear power"]
        lines.append(
            f"brping takes {framed:.0f} times as long as framing alone, {decoded:.0f} times as long as all the way to "
            "power"
        )
    else:
        lines.append("brping is not installed: pip install bluerobotics-ping to compare")
    return lines


def _brping(stream: bytes) -> Callable[[], object]:
    make = import_module("brping").PingParser

    def run() -> None:
        parser = make()
        for byte in stream:
            parser.parse_byte(byte)

    return run


class JunkRow(NamedTuple):
    """Hold the junk that costs most on one wire, and its processor time per megabyte."""

    name: str
    junk: str
    s_per_mb: float


def _junk_of(wire: str) -> dict[str, bytes]:
    """Make pieces to be repeated, by name; those of `WORST_BYTES`, and nothing but noise and zeros."""
    noise = np.random.Generator(np.random.PCG64(2)).bytes(1 << 16)
    return {"noise": noise, "zeros": bytes(1 << 16), **WORST_BYTES[wire]}


def junk_row(wire: str, n_bytes: int) -> JunkRow:
    """Feed so many bytes of each kind of junk in chunks of 4 KiB, and a quarter in datagrams of 97 bytes.

    The fastest of three runs counts.
    """
    rows = []
    for junk, piece in _junk_of(wire).items():
        stream = piece * (n_bytes // len(piece) + 1)
        for read, chunk_bytes, n in (
            (junk, _CHUNK_BYTES, n_bytes),
            (_SMALL.format(junk), _DATAGRAM_BYTES, n_bytes // 4),
        ):
            took = _seconds(functools.partial(_fed, FEEDS[wire], stream[:n], chunk_bytes))
            rows.append(JunkRow(wire, read, 1e6 * took / n))
    return max(rows, key=lambda row: row.s_per_mb)


def junk_lines(rows: list[JunkRow]) -> list[str]:
    """Lay out a row per wire, and whether all are within the allowance."""
    lines = [f"{'junk, processor time':<16}{'s per MB':>10}  of the worst, which is"]
    lines += [f"{row.name:<16}{row.s_per_mb:>10.3f}  {row.junk}" for row in rows]
    above = [row.name for row in rows if row.s_per_mb > MAX_S_PER_MB]
    return [
        *lines,
        f"allowed are {MAX_S_PER_MB:g} s per MB: " + (f"FAILED by {', '.join(above)}" if above else "held by all"),
    ]


def _fed(make: Callable[[], Callable[[bytes], object]], stream: bytes, chunk_bytes: int) -> None:
    feed = make()
    for start in range(0, len(stream), chunk_bytes):
        feed(stream[start : start + chunk_bytes])


def _feed_of(grammar: Callable[[], Grammar[Any]]) -> Callable[[], Callable[[bytes], object]]:
    return lambda: Framer(grammar()).feed


def _feed_slcan() -> Callable[[bytes], object]:
    return SlcanParser(Counter()).feed


def _feed_fast_packets() -> Callable[[bytes], object]:
    parser, packets = SlcanParser(Counter()), FastPackets()

    def feed(data: bytes) -> None:
        for frame in parser.feed(data):
            _, pgn, _, source = identifier_of(frame.can_id)
            packets.add(pgn, source, frame.data)

    return feed


def _feed_vehicle_can() -> Callable[[bytes], object]:
    parser, receiver = SlcanParser(Counter()), CanReceiver("vehicle_can", "payload", _VEHICLE_CAN_ADDRESS, Counter())

    def feed(data: bytes) -> None:
        for frame in parser.feed(data):
            receiver.add(frame, 0.0)

    return feed


FEEDS: Final[dict[str, Callable[[], Callable[[bytes], object]]]] = {
    "ping_protocol": _feed_of(PingGrammar),
    "jsf": _feed_of(JsfGrammar),
    "sportscan": _feed_of(IgxGrammar),
    "nmea0183": _feed_of(NmeaGrammar),
    "pixse": _feed_of(NmeaGrammar),
    "water_linked": _feed_of(dvl_water_linked.TextGrammar),
    "pd6": _feed_of(dvl_pd6.LineGrammar),
    "imc": _feed_of(ImcGrammar),
    "bluefin": _feed_of(BluefinGrammar),
    "iver": _feed_of(IverGrammar),
    "recon": _feed_of(ReconGrammar),
    "slcan": _feed_slcan,
    "fast_packet": _feed_fast_packets,
    "vehicle_can": _feed_vehicle_can,
}
"""For each wire, makes a framer anew and gives what takes its bytes."""


def campaign_lines(rows: list[CampaignRow]) -> list[str]:
    """Lay out a row per wire; nothing may be lost."""
    heads = ("faults", "messages", "intact", "lost", "other", "false")
    lines = [f"{'damaged streams':<16}" + "".join(f"{head:>10}" for head in heads)]
    lines += [f"{row.name:<16}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in rows]
    lines.append(
        "lost: intact messages that were not read. other: read once more, or where only bytes were hit that do not "
        "matter,"
    )
    return [*lines, "or from damage that no checksum detects. false: of those, messages that nobody sent"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench framers`."""
    parser.add_argument("--faults", type=count, default=10_000, help="faults per wire format")
    parser.add_argument("--pings", type=count, default=200, help="pings of the speed measurement")
    parser.add_argument("--junk", type=count, default=1_000_000, help="bytes of each kind of junk")
    parser.add_argument("--seed", type=count, default=1, help="seed of the faults")


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code.

    Raises SelfCheckError if an intact message was lost or junk takes more processor time than is allowed.
    """
    print("\n".join([*speed_lines(chosen.pings), ""]))
    junk = [junk_row(wire, chosen.junk) for wire in FEEDS]
    print("\n".join([*junk_lines(junk), ""]), flush=True)
    rows = [campaign(wire, chosen.faults, chosen.seed) for wire in WIRES]
    print("\n".join(campaign_lines(rows)))
    lost, slow = [row.name for row in rows if row.n_lost], [row.name for row in junk if row.s_per_mb > MAX_S_PER_MB]
    if lost:
        raise SelfCheckError(f"intact messages were lost by {', '.join(lost)}")
    if slow:
        raise SelfCheckError(f"junk takes more processor time than is allowed in {', '.join(slow)}")
    return 0
